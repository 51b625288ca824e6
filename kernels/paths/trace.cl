// Path moments M_k = integral of delta^k ds in metres, k = 1 ... MOMENTS, with
// delta = rho / rho_mean - 1. In isothermal air the optical depth at every frequency is a sum over
// them and the path length, so one trace serves all frequencies.
//
// `count` rays are followed; their moments are stored in their order, padded to whole packets.
//
// Options: MOMENTS; CUTOFF where a ray can pass the cut-off depth; MOTION, OUTGOING and CLIPPED as
// in march.cl. After each CUTOFF voxels, a multiple of TOGETHER, the smallest depth over the scene's
// frequencies is compared with `cutoff`; `guard` holds its coefficients per metre. Around a bounded
// cube delta is 0, so that nothing is added there.

// Whether any ray goes on is asked after this many voxels: where none does, voxels have no length.
#define TOGETHER 4

__kernel void trace(int items, __global const real *restrict delta, __constant frame *cube, int width,
                    int height, int log2x, int log2y, int log2z,
                    __global const wide *reach, __global const wide *end,
                    __global const wide *restrict time, __global const wide *restrict enter,
                    __global const wide *restrict leave, __global const real *restrict stretch,
                    __global const int *restrict picked, int count,
                    __global real *restrict path_length, __global int *restrict surface,
                    __global real *restrict moments, __global int *restrict segments,
                    __constant real *guard, real cutoff)
{
    const int packet = get_global_id(0), first = packet * LANES,
              padded = items * LANES;
    march ray = march_start(cube, width, height, log2x, log2y, log2z, reach, end, time, enter, leave,
                            stretch, picked, count, first);
    reals m[MOMENTS];
    UNROLLED
    for (int k = 0; k < MOMENTS; ++k) m[k] = 0;
    wholes crossed = 0;
#ifdef CUTOFF
    wholes ended = 0;
    int steps = 0;
#endif
    while (ANY(ray.here < ray.end)) {
        UNROLLED
        for (int voxels = 0; voxels < TOGETHER; ++voxels) {
            const reals there = march_exit(&ray), length = there - ray.here;
            const wholes voxel = march_voxel(&ray);
            const reals d = GATHER(delta, voxel);
            reals power = length;
            UNROLLED
            for (int k = 0; k < MOMENTS; ++k) {
                power *= d;
                m[k] += power;
            }
            crossed += length > 0 ? (wholes)1 : (wholes)0;
            march_cross(&ray, there);
        }
#ifdef CUTOFF
        steps += TOGETHER;
        if (steps % CUTOFF == 0) {
            reals depth = guard[0] * ray.here;
            UNROLLED
            for (int k = 0; k < MOMENTS; ++k) depth += guard[k + 1] * m[k];
            const wholes over = (depth * ray.metres > cutoff) & (ray.here < ray.end);
            ray.end = over ? ray.here : ray.end;
            ended = over ? over : ended;
        }
#endif
    }
    UNROLLED
    for (int k = 0; k < MOMENTS; ++k)
        STORE(m[k] * ray.metres, moments + (size_t)k * padded + first);
#ifdef CUTOFF
    march_record_ends(&ray, ended, picked, count, first, path_length, surface);
#endif
    segments[packet] = march_count(crossed, first, count);
}
