// From path moments to what reaches the camera, at every frequency. In isothermal air the radiance above the air's own is
// (L_surface - B_air) exp(-tau), exactly, whatever the humidity; nothing larger is ever carried.

// Optical depth and contrast, both (frequency, ray); `coefficients` (frequency, MOMENTS + 1) per metre, `emitted`
// (surface, frequency) is L_surface - B_air.
__kernel void shade(__global const real *restrict path_length, __global const real *restrict moments,
                    __global const int *restrict surface, __constant real *coefficients,
                    __global const real *restrict emitted, int frequencies, __global real *restrict depth,
                    __global real *restrict contrast)
{
    const int first_ray = get_global_id(0) * LANES, padded = get_global_size(0) * LANES;
    const reals length = LOAD(path_length + first_ray);
    for (int f = 0; f < frequencies; ++f) {
        __constant real *c = coefficients + f * (MOMENTS + 1);
        reals tau = c[0] * length;
        for (int k = 0; k < MOMENTS; ++k) tau += c[k + 1] * LOAD(moments + k * padded + first_ray);
        real source[LANES];
        for (int lane = 0; lane < LANES; ++lane) source[lane] = emitted[surface[first_ray + lane] * frequencies + f];
        STORE(tau, depth + f * padded + first_ray);
        STORE(LOAD(source) * exp(-tau), contrast + f * padded + first_ray);
    }
}
