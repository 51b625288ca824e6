// From path moments to what reaches the camera. In isothermal air the radiance above the air's own is
// (L_surface - B_air) exp(-tau), exactly, whatever the humidity; nothing larger is ever carried.
//
// Options: MOMENTS; BANDS, the number of bands, where only sums over frequency are wanted.

// Optical depth at one frequency; `c` holds MOMENTS + 1 coefficients per metre.
static inline reals optical_depth(__constant real *c, reals length, __global const real *moments, int padded)
{
    reals tau = c[0] * length;
    for (int k = 0; k < MOMENTS; ++k) tau += c[k + 1] * LOAD(moments + k * padded);
    return tau;
}

// Optical depth and contrast at each frequency, both (frequency, ray); `coefficients` (frequency, MOMENTS + 1) per metre,
// `emitted` (surface, frequency) is L_surface - B_air.
__kernel void shade(__global const real *restrict path_length, __global const real *restrict moments,
                    __global const int *restrict surface, __global const real *restrict blend,
                    __constant real *coefficients, __global const real *restrict emitted, int frequencies,
                    __global real *restrict depth, __global real *restrict contrast)
{
    const int first_ray = get_global_id(0) * LANES, padded = get_global_size(0) * LANES;
    const reals length = LOAD(path_length + first_ray);
    for (int f = 0; f < frequencies; ++f) {
        const reals tau = optical_depth(coefficients + f * (MOMENTS + 1), length, moments + first_ray, padded);
        const reals source = surface_value(emitted, surface, blend, first_ray, frequencies, f);
        STORE(tau, depth + f * padded + first_ray);
        STORE(source * exp(-tau), contrast + f * padded + first_ray);
    }
}

#ifdef BANDS
// The same, summed over frequency with weights, without ever storing a spectrum: transmission and contrast of each band,
// both (band, ray). `weights` (band, frequency) sum to 1; `emitted` (band, surface, frequency) has them multiplied in.
__kernel void shade_bands(__global const real *restrict path_length, __global const real *restrict moments,
                          __global const int *restrict surface, __global const real *restrict blend,
                          __constant real *coefficients, __constant real *weights, __global const real *restrict emitted,
                          int frequencies, int surfaces, __global real *restrict transmission,
                          __global real *restrict contrast)
{
    const int first_ray = get_global_id(0) * LANES, padded = get_global_size(0) * LANES;
    const reals length = LOAD(path_length + first_ray);
    reals passed[BANDS], above[BANDS];
    for (int b = 0; b < BANDS; ++b) passed[b] = above[b] = 0;
    for (int f = 0; f < frequencies; ++f) {
        const reals e = exp(-optical_depth(coefficients + f * (MOMENTS + 1), length, moments + first_ray, padded));
        for (int b = 0; b < BANDS; ++b) {
            passed[b] += weights[b * frequencies + f] * e;
            above[b] += e * surface_value(emitted + b * surfaces * frequencies, surface, blend, first_ray, frequencies, f);
        }
    }
    for (int b = 0; b < BANDS; ++b) {
        STORE(passed[b], transmission + b * padded + first_ray);
        STORE(above[b], contrast + b * padded + first_ray);
    }
}
#endif
