// What surfaces send out, by table: its row is the surface that a ray met, its column the
// frequency. A textured surface has several rows, and a ray may lie between two of them.
//
// Options: BILLBOARDS where the scene has textured surfaces; COSINES, where it matters from which
// side a surface is looked at, with ELEVATIONS and TILTS, all numbers of nodes, SCATTERED and SEEN.
// The table is then what surfaces would send if they reflected nothing.

// `table` (surface, column); by ray: the `surface` met, its `blend` with the next one, the `cosine`
// between ray and normal, the sine of the mirrored ray's `elevation`, and the `upward` component of
// the normal; the number of each surface's `mirror`; `reflectivity` (mirror, column, COSINES) from
// grazing to upright. What is `seen` in surfaces is (column, SEEN). Up to SCATTERED it holds sets
// by elevation, of three parts of ELEVATIONS nodes at equal steps of the root of its sine: from the
// horizon down (in the first set to the root `dip`, beyond which it is constant), from the horizon
// to the root `knee`, and on to straight up. From there on it holds sets for rough surfaces, of
// TILTS nodes at equal steps of the normal's angle, from straight down to straight up. `view` is
// where the set of each surface begins.
typedef struct {
    __global const real *table;
    __global const int *surface;
    __global const real *blend, *cosine, *elevation, *upward;
    __global const int *mirror, *view;
    __global const real *reflectivity, *seen;
    real knee, dip;
} sources;

#ifdef COSINES
// A row's value at `part` of the way from its first node to its last.
static inline real between(__global const real *row, int nodes, real part)
{
    const real place = part * (nodes - 1);
    const int below = clamp((int)place, 0, nodes - 2);
    return row[below] + (place - below) * (row[below + 1] - row[below]);
}

// What a set of nodes by elevation holds; beyond the knee the second part is followed by the third.
static inline real by_elevation(__global const real *set, real sine, real knee, real dip)
{
    const real root = sqrt(fabs(sine));
    if (sine < 0) return between(set, ELEVATIONS, min(root / dip, (real)1));
    if (root < knee) return between(set + ELEVATIONS, ELEVATIONS, root / knee);
    return between(set + 2 * ELEVATIONS, ELEVATIONS, (root - knee) / (1 - knee));
}

// Where in a set of nodes by tilt a normal lies whose vertical component is given.
static inline real by_tilt(real upward)
{
    return (real)0.5 + asin(upward) * (real)0.31830988618379067;
}
#endif

// What a ray receives from a surface.
static inline real sent_by(const sources *from, int ray, int surface, int columns, int column)
{
    const real own = from->table[surface * columns + column];
#ifdef COSINES
    __global const real *mirror =
        from->reflectivity + (from->mirror[surface] * columns + column) * COSINES;
    const int view = from->view[surface];
    __global const real *set = from->seen + column * SEEN + view;
    const real seen = view < SCATTERED
                          ? by_elevation(set, from->elevation[ray], from->knee,
                                         view == 0 ? from->dip : (real)1)
                          : between(set, TILTS, by_tilt(from->upward[ray]));
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
