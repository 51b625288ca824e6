// What surfaces send out, by table: its row is the surface that a ray met, its column the
// frequency. A textured surface has several rows, and a ray may lie between two of them.
//
// Option: BILLBOARDS where the scene has textured surfaces.

// The table's value for each ray of a packet. Where there are textures, `blend` says how far a ray
// lies from its row towards the next.
static inline reals surface_value(__global const real *table, __global const int *surface,
                                  __global const real *blend, int first_ray, int columns,
                                  int column)
{
    real value[LANES];
    for (int lane = 0; lane < LANES; ++lane) {
        __global const real *at = table + surface[first_ray + lane] * columns + column;
#ifdef BILLBOARDS
        value[lane] = at[0] + blend[first_ray + lane] * (at[columns] - at[0]);
#else
        value[lane] = at[0];
#endif
    }
    return LOAD(value);
}
