// What surfaces send out, by table: its row is the surface that a ray met, its column the
// frequency. A textured surface has several rows, and a ray may lie between two of them.
//
// Options: BILLBOARDS where the scene has textured surfaces; COSINES and ELEVATIONS, numbers of
// nodes, where it matters from which side a surface is looked at. The table is then what surfaces
// would send if they reflected nothing.

// `table` (surface, column); by ray: the `surface` met, its `blend` with the next one, the `cosine`
// between ray and normal, and the sine of the mirrored ray's `elevation`; the number of each
// surface's `mirror`; `reflectivity` (mirror, column, COSINES) from grazing to upright; what is
// `seen` in mirrors, (column, ELEVATIONS), from straight below to straight above.
typedef struct {
    __global const real *table;
    __global const int *surface;
    __global const real *blend, *cosine, *elevation;
    __global const int *mirror;
    __global const real *reflectivity, *seen;
} sources;

#ifdef COSINES
// A row's value at `part` of the way from its first node to its last.
static inline real between(__global const real *row, int nodes, real part)
{
    const real place = part * (nodes - 1);
    const int below = clamp((int)place, 0, nodes - 2);
    return row[below] + (place - below) * (row[below + 1] - row[below]);
}
#endif

// What a ray receives from a surface.
static inline real sent_by(const sources *from, int ray, int surface, int columns, int column)
{
    const real own = from->table[surface * columns + column];
#ifdef COSINES
    __global const real *mirror =
        from->reflectivity + (from->mirror[surface] * columns + column) * COSINES;
    const real seen = between(from->seen + column * ELEVATIONS, ELEVATIONS,
                              (real)0.5 + (real)0.5 * from->elevation[ray]);
    return own + between(mirror, COSINES, from->cosine[ray]) * (seen - own);
#else
    return own;
#endif
}

// The value for each ray of a packet. Where there are textures, `blend` says how far a ray lies
// from its row towards the next.
static inline reals surface_value(const sources *from, int first_ray, int columns, int column)
{
    real value[LANES];
    for (int lane = 0; lane < LANES; ++lane) {
        const int ray = first_ray + lane, surface = from->surface[ray];
        value[lane] = sent_by(from, ray, surface, columns, column);
#ifdef BILLBOARDS
        const real next = sent_by(from, ray, surface + 1, columns, column);
        value[lane] += from->blend[ray] * (next - value[lane]);
#endif
    }
    return LOAD(value);
}
