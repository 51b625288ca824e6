// The mean air by height, as departures from the scene's mean: delta and kelvins by look-up.
//
// Option: LAYERS, the largest power of two that is no more than the number of rows.

#ifdef LAYERS
// `layers` (4, rows) holds height in m, one over the step to the next row (in ln z where the row is
// above 0, else in z), delta and offset. Beyond the rows the air is that of the last one.
INLINE void layer_at(reals z, __global const real *layers, int rows, reals *delta, reals *offset)
{
    wholes low = 0;
    for (int step = LAYERS; step; step >>= 1) {
        const wholes next = SMALLER(low + (whole)step, (wholes)(rows - 2));
        low = GATHER(layers, next) <= z ? next : low;
    }
    const reals below = GATHER(layers, low), inverse = GATHER(layers + rows, low);
    const reals height = z < below ? below : z;
    const reals part = (below > 0 ? log(height / (below > 0 ? below : (reals)1)) : height - below) *
                       inverse;
    const reals up = part > 1 ? (reals)1 : part;
    const wholes high = low + (whole)1;
    __global const real *d = layers + 2 * rows, *t = layers + 3 * rows;
    *delta = GATHER(d, low) + up * (GATHER(d, high) - GATHER(d, low));
    *offset = GATHER(t, low) + up * (GATHER(t, high) - GATHER(t, low));
}
#endif
