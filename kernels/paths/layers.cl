// The mean air by height, as departures from the scene's mean: delta and kelvins by look-up.
//
// Option: LAYERS, the number of heights in the look-up.

#ifdef LAYERS
// The look-up has 2^FINE steps an octave, so that a height's own bits say where it lies.
#define FINE 10
#if PRECISION == 64
#define BITS(x) VECTOR(as_long)(x)
#define BELOW (52 - FINE)
#else
#define BITS(x) VECTOR(as_int)(x)
#define BELOW (23 - FINE)
#endif

// `layers` (2, LAYERS) holds delta and offset at the heights, of which the lowest, `lowest`, is
// above 0, and the highest `highest`. Beyond them the air is that of the last one.
INLINE void layer_at(reals height, __global const real *layers, real lowest, real highest,
                     reals *delta, reals *offset)
{
    const reals above = height < lowest ? (reals)lowest : height,
                within = above < highest ? above : (reals)highest;
    const wholes bits = BITS(within), first = BITS((reals)lowest);
    const wholes cell = (bits >> BELOW) - (first >> BELOW);
    const reals part = TO_REALS(bits & ((((whole)1) << BELOW) - 1)) *
                       ((real)1 / (((whole)1) << BELOW));
    const reals d = GATHER(layers, cell), d_next = GATHER(layers + 1, cell),
                t = GATHER(layers + LAYERS, cell), t_next = GATHER(layers + LAYERS + 1, cell);
    *delta = d + part * (d_next - d);
    *offset = t + part * (t_next - t);
}
#endif
