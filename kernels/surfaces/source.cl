// What surfaces send out, by table: row of the surface that each ray met, column of the frequency.
// A textured surface has several rows, and the ray lies between two of them.
//
// Options: BILLBOARDS where the scene has textured surfaces.

static inline reals surface_value(__global const real *table, __global const int *surface, __global const real *blend,
                                  int first_ray, int columns, int column)
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
