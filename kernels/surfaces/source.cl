// What surfaces send out, by table: its row is the surface that a ray met, its column the
// frequency. A textured surface has several rows, and a ray may lie between two of them.
//
// Options: BLENDED where rays lie between two rows; COSINES, where it matters from which side a
// surface is looked at, with ELEVATIONS and TILTS, all numbers of nodes, LAWS (how many laws of the
// cosine there are), SCATTERED and SEEN. The table is then what surfaces would send if they
// reflected nothing. With it go MIRRORED where a share of what is reflected is mirrored, its law
// SHARE; POLARIZED, the law of the difference between polarisations; LOBE, the law of what comes
// back to a transmitter; COVERED where surfaces have covers; BOUNCES where mirrored rays are
// followed.

// `table` (surface, column); by ray: the `surface` met, its `blend` with the next one, the `cosine`
// between ray and normal, the sine of the mirrored ray's `elevation`, the `upward` component of
// the normal, and the part of the power whose field stands `across` the plane of incidence; the
// number of each surface's `mirror`; `reflectivity` (mirror, column, LAWS, COSINES) by the root of
// the cosine, from grazing to upright. What is `seen` in surfaces is (column, SEEN). Up to SCATTERED
// it holds sets by elevation, of three parts of ELEVATIONS nodes at equal steps of the root of its
// sine: from the horizon down (in the first set to the root `dip`, beyond which it is constant),
// from the horizon to the root `knee`, and on to straight up. From there on it holds sets for rough
// surfaces, of TILTS nodes at equal steps of the normal's angle, from straight down to straight up.
// `view` is where the set of each surface begins. `cover` (mirror, column, 2) are what covers let
// through and scatter, and `table` goes on, from row `covered`, with what surface and cover add for
// each part of light between them. By ray, `met` is the surface that the mirrored ray meets, or 0,
// and `bounce` (5) its blend, cosine, elevation and upward there, and the way in metres, along which
// the air absorbs `dimming` (column) per metre.
typedef struct {
    __global const real *table;
    __global const int *surface;
    __global const real *blend, *cosine, *elevation, *upward;
    __global const int *mirror, *view;
    __global const real *reflectivity, *seen;
    real knee, dip;
    __global const real *across, *cover;
    int covered;
    __global const int *met;
    __global const real *bounce, *dimming;
} sources;

// The parameters of a kernel that reads this file, and the struct made of them.
#define SOURCE_PARAMETERS                                                                          \
    __global const real *restrict emitted, __global const real *restrict blend,                    \
    __global const real *restrict cosine, __global const real *restrict elevation,                 \
    __global const real *restrict upward, __global const int *restrict mirror,                     \
    __global const int *restrict view, __global const real *restrict reflectivity,                 \
    __global const real *restrict seen, real knee, real dip, __global const real *restrict across, \
    __global const real *restrict cover, int covered, __global const int *restrict met,            \
    __global const real *restrict bounce, __global const real *restrict dimming
#define SOURCES                                                                                    \
    {emitted, surface, blend, cosine, elevation, upward, mirror, view,    reflectivity,            \
     seen,    knee,    dip,   across, cover,     covered, met,   bounce, dimming}

#ifdef COSINES
// Where a ray meets a surface: the cosine of the angle to its normal, the sine of the elevation at
// which it goes on, the normal's vertical component, and the part of its power across.
typedef struct {
    real cosine, elevation, upward, across;
} meeting;

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

// What a surface sends along a ray that meets it so, if `glint` is what it mirrors.
static inline real sent_so(const sources *from, int surface, meeting at, int columns, int column,
                           real glint)
{
    const real own = from->table[surface * columns + column];
    __global const real *laws =
        from->reflectivity + (from->mirror[surface] * columns + column) * LAWS * COSINES;
    const real root = sqrt(at.cosine);
    real part = between(laws, COSINES, root);
#ifdef POLARIZED
    part += (at.across - (real)0.5) * between(laws + POLARIZED * COSINES, COSINES, root);
#endif
    const int view = from->view[surface];
    __global const real *set = from->seen + column * SEEN + view;
    const real scattered = view < SCATTERED
                               ? by_elevation(set, at.elevation, from->knee,
                                              view == 0 ? from->dip : (real)1)
                               : between(set, TILTS, by_tilt(at.upward));
    real seen = scattered;
#ifdef MIRRORED
    seen += between(laws + SHARE * COSINES, COSINES, root) * (glint - seen);
#endif
#ifdef COVERED
    const int layer = 2 * (from->mirror[surface] * columns + column);
    const real passed = from->cover[layer], back = from->cover[layer + 1];
    const real exchanged = part / (1 - part * back);
    real sent = own + exchanged * from->table[(from->covered + surface) * columns + column] +
                back * scattered + passed * passed * exchanged * seen;
#else
    real sent = own + part * (seen - own);
#endif
#ifdef LOBE
    sent += between(laws + LOBE * COSINES, COSINES, root);
#endif
    return sent;
}

// What is seen in the mirrored direction of a ray that meets a surface so.
static inline real mirrored(const sources *from, meeting at, int column)
{
#ifdef MIRRORED
    return by_elevation(from->seen + column * SEEN + MIRRORED, at.elevation, from->knee,
                        MIRRORED == 0 ? from->dip : (real)1);
#else
    return 0;
#endif
}

// What is seen in the mirrored direction of a camera's ray: the next surface, or what stands around.
static inline real glint_of(const sources *from, int ray, meeting at, int columns, int column)
{
#ifdef BOUNCES
    const int met = from->met[ray];
    if (met > 0) {
        __global const real *there = from->bounce + 5 * ray;
        const meeting then = {there[1], there[2], there[3], (real)0.5};
        const real beyond = mirrored(from, then, column);
        real sent = sent_so(from, met, then, columns, column, beyond);
#ifdef BLENDED
        if (there[0] > 0)
            sent += there[0] * (sent_so(from, met + 1, then, columns, column, beyond) - sent);
#endif
        return sent * exp(-from->dimming[column] * there[4]);
    }
#endif
    return mirrored(from, at, column);
}
#endif

// The value for each ray of a packet. Where there are textures, `blend` says how far a ray lies
// from its row towards the next.
static inline reals surface_value(const sources *from, int first_ray, int columns, int column)
{
    real value[LANES];
    for (int lane = 0; lane < LANES; ++lane) {
        const int ray = first_ray + lane, surface = from->surface[ray];
#ifdef COSINES
        const meeting at = {from->cosine[ray], from->elevation[ray], from->upward[ray],
#ifdef POLARIZED
                            from->across[ray]};
#else
                            (real)0.5};
#endif
        const real glint = glint_of(from, ray, at, columns, column);
        value[lane] = sent_so(from, surface, at, columns, column, glint);
#ifdef BLENDED
        const real next = sent_so(from, surface + 1, at, columns, column, glint);
        value[lane] += from->blend[ray] * (next - value[lane]);
#endif
#else
        value[lane] = from->table[surface * columns + column];
#ifdef BLENDED
        const real next = from->table[(surface + 1) * columns + column];
        value[lane] += from->blend[ray] * (next - value[lane]);
#endif
#endif
    }
    return LOAD(value);
}
