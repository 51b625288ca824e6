// Path moments by steps of equal length, as taken by ray marchers that do not look for voxel faces:
// the convergence study holds exact segments against them. Each ray is cut into as few equal steps
// as are no longer than `step` metres, and the voxel that holds the middle of a step stands for all
// of it.
//
// Option: MOMENTS.

__kernel void steps(int items, __global const real *restrict delta, __constant frame *cube, int width,
                    int height, int log2x, int log2y, int log2z,
                    __global const wide *reach, __global const wide *end,
                    __global const wide *restrict time, __global const wide *restrict enter,
                    __global const wide *restrict leave, __global const real *restrict stretch,
                    __global const int *restrict picked, int count, real step,
                    __global real *restrict moments)
{
    const int first = get_global_id(0) * LANES, padded = items * LANES;
    real x0[LANES], y0[LANES], z0[LANES], dx[LANES], dy[LANES], dz[LANES],
         size[LANES], metres[LANES];
    whole number[LANES];
    for (int lane = 0; lane < LANES; ++lane) {
        const int ray = RAY(min(first + lane, count - 1));
        const point d = follow_direction(cube, width, height, ray, reach[ray]);
        x0[lane] = (real)cube->origin.x;
        y0[lane] = (real)cube->origin.y;
        z0[lane] = (real)cube->origin.z;
        dx[lane] = (real)d.x;
        dy[lane] = (real)d.y;
        dz[lane] = (real)d.z;
        metres[lane] = stretch[ray];
        number[lane] = (whole)ceil((real)end[ray] * metres[lane] / step);
        size[lane] = number[lane] > 0 ? (real)end[ray] / number[lane] : 0;
    }
    const reals ox = LOAD(x0), oy = LOAD(y0), oz = LOAD(z0), ux = LOAD(dx), uy = LOAD(dy),
                uz = LOAD(dz), ds = LOAD(size);
    const wholes all = LOAD(number);
    const whole nx = (whole)1 << log2x, ny = (whole)1 << log2y, nz = (whole)1 << log2z;
    reals m[MOMENTS];
    for (int k = 0; k < MOMENTS; ++k) m[k] = 0;
    for (wholes i = 0; ANY(i < all); i += (whole)1) {
        const reals s = (TO_REALS(i) + (real)0.5) * ds;
        const wholes x = TO_WHOLES(floor(ox + s * ux)) & (nx - 1),
                     y = TO_WHOLES(floor(oy + s * uy)) & (ny - 1),
                     z = TO_WHOLES(floor(oz + s * uz)) & (nz - 1);
        const wholes voxel = x + (y << log2x) + (z << (log2x + log2y));
        const reals d = GATHER(delta, voxel);
        reals power = i < all ? ds : (reals)0;
        for (int k = 0; k < MOMENTS; ++k) {
            power *= d;
            m[k] += power;
        }
    }
    const reals scale = LOAD(metres);
    for (int k = 0; k < MOMENTS; ++k) STORE(m[k] * scale, moments + (size_t)k * padded + first);
}
