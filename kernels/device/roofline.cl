// The most that the device can do, which `thzcl bench` holds its stages against: each kernel does
// one thing only.

typedef VECTOR(uint) uints;

// Memory bandwidth: every byte is read once and written once.
__kernel void copy(__global const float *restrict from, __global float *restrict to)
{
    const size_t at = (size_t)get_global_id(0) * LANES;
    STORE(LOAD(from + at), to + at);
}

// The reads of a trace without its arithmetic, by the same instruction: `count` voxels for every
// ray, from a cube of 2^log2_voxels. `cell` holds the voxel's number in its uppermost bits, so that
// it wraps at the cube's end by itself. With a factor of 1 the rays go straight, `abreast`
// neighbours through the same voxels, as those of a camera do; with the factor of a random number
// generator they go anywhere.
__kernel void gather(__global const real *restrict cube, int log2_voxels, int abreast, uint factor,
                     uint step, int count, __global real *restrict out)
{
    const int first = get_global_id(0) * LANES, below = 32 - log2_voxels;
    uints cell = VECTOR(as_uint)((first + LANE_NUMBERS) / abreast) << (uint)below;
    reals sum = 0;
    for (int i = 0; i < count; ++i) {
        const uints voxel = cell >> (uint)below;
        sum += GATHER(cube, voxel);
        cell = cell * factor + step;
    }
    STORE(sum, out + first);
}
