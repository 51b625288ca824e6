// From path moments to what reaches the camera. In isothermal air the radiance above the air's own
// is (L_surface - B_air) exp(-tau), exactly, whatever the humidity; nothing larger is ever carried.
//
// Options: MOMENTS; BANDS, the number of bands, where only sums over frequency are wanted;
// BLENDED, COSINES and what goes with it as in source.cl.

// Optical depth at one frequency; `c` holds MOMENTS + 1 coefficients per metre. The terms go to two
// sums in turn, so that each addition waits for half as many.
static inline reals depth_of(__global const real *c, reals length, const reals *moments)
{
    reals one = c[0] * length, other = 0;
    UNROLLED
    for (int k = 0; k < MOMENTS; ++k) {
        if (k % 2) one += c[k + 1] * moments[k];
        else other += c[k + 1] * moments[k];
    }
    return one + other;
}

// Whether all rays of a packet meet the same surface, as most do: then one value serves them all.
// Between textures, and where the angle counts, each ray has its own: the answer is no.
static inline int all_alike(__global const int *surface, int first_ray)
{
#if defined(BLENDED) || defined(COSINES)
    return 0;
#else
    int alike = 1;
    for (int lane = 1; lane < LANES; ++lane)
        alike &= surface[first_ray + lane] == surface[first_ray];
    return alike;
#endif
}

// Optical depth and contrast at each frequency, both (frequency, ray) in rows of `row`.
// `coefficients` (frequency, MOMENTS + 1) are per metre; `emitted` (surface, frequency) and what
// follows it, as in source.cl, are relative to B_air.
__kernel void shade(int items, __global const real *restrict path_length,
                    __global const real *restrict moments, __global const int *restrict surface,
                    __global const real *restrict coefficients,
                    SOURCE_PARAMETERS, int frequencies, int row,
                    __global real *restrict depth, __global real *restrict contrast)
{
    const int first_ray = get_global_id(0) * LANES, padded = items * LANES;
    const reals length = LOAD(path_length + first_ray);
    reals m[MOMENTS + 1];
    UNROLLED
    for (int k = 0; k < MOMENTS; ++k) m[k] = LOAD(moments + first_ray + (size_t)k * padded);
    const int alike = all_alike(surface, first_ray);
    __global const real *sent = emitted + surface[first_ray] * frequencies;
    const sources from = SOURCES;
    for (int f = 0; f < frequencies; ++f) {
        const reals tau = depth_of(coefficients + f * (MOMENTS + 1), length, m);
        const reals source =
            alike ? (reals)(sent[f])
                  : surface_value(&from, first_ray, frequencies, f);
        STORE(tau, depth + (size_t)f * row + first_ray);
        STORE(source * exp(-tau), contrast + (size_t)f * row + first_ray);
    }
}

#ifdef BANDS
// Depth of the mean transmission and contrast of each band, both (band, ray): sums over frequency
// with weights, of which no spectrum is ever stored. `weights` (band, frequency) sum to 1;
// `emitted` (band, row, frequency) and `seen` (band, frequency, ELEVATIONS) have weights of
// their own multiplied in. Sums are taken relative to the depth at each band's least absorbing
// frequency, whose coefficients are `thinnest` (band, MOMENTS + 1); `beyond` (band, frequency,
// MOMENTS + 1) is what the others have more. So both what is left and what is lost keep their
// digits, in air of any depth.
__kernel void shade_bands(int items, __global const real *restrict path_length,
                          __global const real *restrict moments,
                          __global const int *restrict surface,
                          __global const real *restrict thinnest,
                          __global const real *restrict beyond,
                          __global const real *restrict weights, SOURCE_PARAMETERS,
                          int frequencies, int rows,
                          __global real *restrict depth, __global real *restrict contrast)
{
    const int first_ray = get_global_id(0) * LANES, padded = items * LANES;
    const int alike = all_alike(surface, first_ray);
    const reals length = LOAD(path_length + first_ray);
    reals m[MOMENTS + 1];
    UNROLLED
    for (int k = 0; k < MOMENTS; ++k) m[k] = LOAD(moments + first_ray + (size_t)k * padded);
    for (int b = 0; b < BANDS; ++b) {
        sources from = SOURCES;
        from.table += b * rows * frequencies;
        __global const real *row = from.table + surface[first_ray] * frequencies;
#ifdef COSINES
        from.seen += b * frequencies * SEEN;
#endif
        const reals least = depth_of(thinnest + b * (MOMENTS + 1), length, m);
        reals left = 0, lost = 0, above = 0;
        for (int f = 0; f < frequencies; ++f) {
            reals less;
            const reals passed = attenuate(
                depth_of(beyond + (b * frequencies + f) * (MOMENTS + 1), length, m), &less);
            left += weights[b * frequencies + f] * passed;
            lost += weights[b * frequencies + f] * less;
            above += passed *
                     (alike ? (reals)row[f] : surface_value(&from, first_ray, frequencies, f));
        }
        // Of `left` and `lost` the smaller has the digits: where little is left, 1 - lost has none.
        STORE(least - (lost < (real)0.5 ? log1p(-lost) : log(left)),
              depth + (size_t)b * padded + first_ray);
        STORE(above * exp(-least), contrast + (size_t)b * padded + first_ray);
    }
}
#endif
