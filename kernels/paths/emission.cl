// Where the air's temperature fluctuates, so does what the path emits, and path moments no longer
// suffice: depth and radiance are carried from the camera outwards, at FREQUENCIES frequencies at
// once. Emission is exact per voxel at any depth: a voxel adds (1 - exp(-K ds)) of its own Planck
// radiance, taken as difference from the mean air's.
//
// Options: FREQUENCIES; HUMIDITY_POWERS, TEMPERATURE_POWERS and PLANCK_POWERS, numbers of
// coefficients; COUNTS, how many temperature powers matter with each humidity power; THIN where no
// voxel is deeper than 1/8; CUTOFF as in trace.cl; MOTION, OUTGOING and CLIPPED as in march.cl;
// BLENDED, COSINES and what goes with it as in source.cl; VEIL where the part `veil` of the
// absorption, 1/m, takes light without emitting as the air does.

// The depths of this many voxels are added up plainly, before a compensated sum (Kahan 1965) takes
// them in: plain float32 alone goes astray by 3e-6 over ten thousand voxels.
#ifdef CUTOFF
#define TOGETHER CUTOFF   // the depth is compared with the cut-off as often
#else
#define TOGETHER 16
#endif

// A polynomial of `count` coefficients, at most `most`. The loop's length must be a plain number
// when the compiler unrolls it, which it does before it unrolls the loops around.
#define POLYNOMIAL(sum, c, count, most, x) \
    UNROLLED \
    for (int j = (most) - 1; j >= 0; --j) \
        sum = j >= (count) ? sum : j == (count) - 1 ? (reals)((c)[j]) : sum * (x) + (c)[j];

// Adds `latest` to the compensated sum of `depth` and `rest`, and sets it to 0.
static inline void take_in(reals *depth, reals *rest, reals *latest)
{
    UNROLLED
    for (int f = 0; f < FREQUENCIES; ++f) {
        const reals term = latest[f] - rest[f], sum = depth[f] + term;
        rest[f] = (sum - depth[f]) - term;
        depth[f] = sum;
        latest[f] = 0;
    }
}

// `coefficients` (FREQUENCIES, HUMIDITY_POWERS, TEMPERATURE_POWERS) are per metre; `planck`
// (FREQUENCIES, PLANCK_POWERS) is B(T) - B(T_mean) in powers of T - T_mean; `emitted` (surface,
// FREQUENCIES) and what follows it, as in source.cl, are relative to B(T_mean). Writes optical
// depth and radiance above the mean air's, both (FREQUENCIES, ray).
__kernel void emission(int items, __global const real *restrict delta, __global const real *restrict offset,
                       __constant frame *cube, int width, int height, int log2x, int log2y,
                       int log2z, __global const wide *reach, __global const wide *end,
                       __global const wide *restrict time, __global const wide *restrict enter,
                       __global const wide *restrict leave, __global const real *restrict stretch,
                       __global const real *restrict layers, real lowest,
                       real highest, real level,
                       __global const wide *restrict rise, __global const int *restrict picked,
                       int count,
                       __global real *restrict path_length, __global int *restrict surface,
                       __constant real *coefficients, __constant real *planck,
                       __constant real *veil, SOURCE_PARAMETERS, real cutoff,
                       __global int *restrict segments,
                       __global real *restrict depth_out, __global real *restrict contrast_out)
{
    const int packet = get_global_id(0), first_ray = packet * LANES,
              padded = items * LANES;
    march ray = march_start(cube, width, height, log2x, log2y, log2z, reach, end, time, enter,
                            leave, stretch, picked, count, first_ray);
    const int counts[] = {COUNTS};
    reals depth[FREQUENCIES], rest[FREQUENCIES], latest[FREQUENCIES], contrast[FREQUENCIES],
          transmission[FREQUENCIES];
    UNROLLED
    for (int f = 0; f < FREQUENCIES; ++f) {
        depth[f] = rest[f] = latest[f] = contrast[f] = 0;
        transmission[f] = 1;
    }
#ifdef CLIPPED
    // Before and behind a bounded cube there is mean air, which adds depth and emits nothing more.
    real last[LANES];
    for (int lane = 0; lane < LANES; ++lane)
        last[lane] = (real)end[RAY(SMALLER(first_ray + lane, count - 1))];
    const reals before = ray.here * ray.metres, behind = (LOAD(last) - ray.end) * ray.metres;
    UNROLLED
    for (int f = 0; f < FREQUENCIES; ++f) {
        depth[f] = before * coefficients[f * HUMIDITY_POWERS * TEMPERATURE_POWERS];
        transmission[f] = EXP(-depth[f]);
    }
#endif
#ifdef LAYERS
    real climbs[LANES];
    for (int lane = 0; lane < LANES; ++lane)
        climbs[lane] = (real)rise[RAY(SMALLER(first_ray + lane, count - 1))];
    const reals climb = LOAD(climbs);
#endif
    wholes crossed = 0;
    int steps = 0;
#ifdef CUTOFF
    wholes ended = 0;
#endif
    while (ANY(ray.here < ray.end)) {
        const reals there = march_exit(&ray), length = (there - ray.here) * ray.metres;
        const wholes voxel = march_voxel(&ray);
#ifdef ONE_TEMPERATURE
        reals d = GATHER(delta, voxel), t = 0;
#else
        reals d = GATHER(delta, voxel), t = GATHER(offset, voxel);
#endif
#ifdef LAYERS
        reals moister, warmer;
        const reals middle = level + climb * ((ray.here + there) * (real)0.5);
        layer_at(middle, layers, lowest, highest, &moister, &warmer);
        d += moister + d * moister;
        t += warmer;
#endif
        UNROLLED
        for (int f = 0; f < FREQUENCIES; ++f) {
            __constant const real *c = coefficients + f * HUMIDITY_POWERS * TEMPERATURE_POWERS;
            reals absorption = 0;
            UNROLLED
            for (int k = HUMIDITY_POWERS - 1; k >= 0; --k) {
                reals row = 0;
                POLYNOMIAL(row, c + k * TEMPERATURE_POWERS, counts[k], TEMPERATURE_POWERS, t)
                absorption = k == HUMIDITY_POWERS - 1 ? row : absorption * d + row;
            }
            const reals tau = length * (absorption > 0 ? absorption : (reals)0);
            reals lost;
#ifdef THIN
            const reals passed = attenuate_thin(tau, &lost);
#else
            const reals passed = attenuate(tau, &lost);
#endif
            reals warmth = 0;
            POLYNOMIAL(warmth, planck + f * PLANCK_POWERS, PLANCK_POWERS, PLANCK_POWERS, t)
#ifdef VEIL
            const reals own = absorption - veil[f];
            warmth *= own > 0 ? own / absorption : (reals)0;
#endif
            contrast[f] += transmission[f] * lost * warmth;
            transmission[f] *= passed;
            latest[f] += tau;
        }
        crossed += length > 0 ? (wholes)1 : (wholes)0;
        march_cross(&ray, there);
        if (++steps % TOGETHER == 0) {
            take_in(depth, rest, latest);
#ifdef CUTOFF
            reals least = depth[0];
            UNROLLED
            for (int f = 1; f < FREQUENCIES; ++f) least = SMALLER(least, depth[f]);
            const wholes over = (least > cutoff) & (there < ray.end);
            ray.end = over ? there : ray.end;
            ended = over ? over : ended;
#endif
        }
    }
#ifdef CLIPPED
    UNROLLED
    for (int f = 0; f < FREQUENCIES; ++f) {
        const reals more = behind * coefficients[f * HUMIDITY_POWERS * TEMPERATURE_POWERS];
#ifdef CUTOFF
        latest[f] += ended ? (reals)0 : more;
#else
        latest[f] += more;
#endif
    }
#endif
    take_in(depth, rest, latest);
#ifdef CUTOFF
    march_record_ends(&ray, ended, picked, count, first_ray, path_length, surface);
#endif
    const sources from = SOURCES;
    UNROLLED
    for (int f = 0; f < FREQUENCIES; ++f) {
        const reals source = surface_value(&from, first_ray, FREQUENCIES, f);
        STORE(depth[f], depth_out + (size_t)f * padded + first_ray);
        STORE(contrast[f] + EXP(-depth[f]) * source, contrast_out + (size_t)f * padded + first_ray);
    }
    segments[packet] = march_count(crossed, first_ray, count);
}
