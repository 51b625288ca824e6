// What a depth leaves and what it takes away, each to its own rounding: 1 less the one is not the
// other in floating point.

// Returns exp(-x), and in `lost` 1 - exp(-x), for x >= 0 (or not far below), each with a relative
// error below 2e-7 in float32. The argument is reduced to |r| <= ln(2)/2, where
// expm1(r) = r + r^2 q(r) with q of degree 4, the best uniformly. The library's expm1 costs several
// times as much.
static inline reals attenuate(reals x, reals *lost)
{
#if PRECISION == 64
    *lost = -expm1(-x);
    return exp(-x);
#else
    const reals capped = SMALLER(x, (reals)80.0f);
    const reals n = NEAREST(capped * 1.44269504f);
    const reals r = (n * 0.693145752f - capped) + n * 1.42860677e-6f;   // ln 2 in two parts
    const reals square = r * r, tail = (8.363178e-3f * r + 0.041666556f) + square * 1.3926182e-3f;
    // Neither half of the series waits for the other.
    const reals series = r + square * ((0.16666576f * r + 0.5f) + square * tail);
    const reals scale = VECTOR(as_float)((127 - TO_WHOLES(n)) << 23);   // 2^-n
    *lost = (1.0f - scale) - scale * series;
    return scale + scale * series;
#endif
}

// Returns exp(-x), and in `lost` 1 - exp(-x), for x up to 1/8, the depth of a thin voxel. There the
// series alone is good to 4e-8 of what is lost.
static inline reals attenuate_thin(reals x, reals *lost)
{
#if PRECISION == 64
    return attenuate(x, lost);
#else
    *lost = x * (1.0f - x * (0.5f - x * (0.166666672f -
            x * (0.0416666679f - x * 8.33333377e-3f))));
    return 1.0f - *lost;
#endif
}
