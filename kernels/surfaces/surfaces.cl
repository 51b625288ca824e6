// Where each ray ends: ground, boxes, billboards, meshes, or the longest range. A work-item finds
// the end of one ray, in float64 where the device has it.
//
// Options: GROUND, BOXES, BILLBOARDS and MESHES where the scene has them; BLENDED where rays end
// between two surfaces; COSINE where the slant of the surface is wanted; ELEVATION where it is
// wanted where a mirrored ray goes and how surfaces lie; ACROSS where the polarisation is wanted;
// BOUNCES where mirrored rays are followed; CEILING where rays that meet nothing end at a height;
// OUTGOING as in camera.cl.

#define BACKGROUND 0
#define GROUND_PLANE 1
#define FIRST_TARGET 2

// A box turned about the vertical: centre, half size, cosine and sine of the turn.
typedef struct {
    wide x, y, z, half_x, half_y, half_z, cosine, sine;
} box;

// An upright rectangle: centre, half width and height, cosine and sine of the direction that its
// front faces.
typedef struct {
    wide x, y, z, half_width, half_height, cosine, sine;
} billboard;

// A billboard's texture: where it begins, its size, whether to take the nearest value, the first of
// its surfaces, how many there are, and where its mask begins, or -1. Values run from 0 to 1, row
// by row from the top left as seen from the front.
typedef struct {
    int first, width, height, nearest, surface, levels, mask;
} texture;

// The nearest surface met so far: how far the ray goes, the surface's number, how far towards the
// next number, the cosine of the angle between ray and normal, the vertical component of the
// normal that looks towards the ray's start, and its horizontal ones.
typedef struct {
    wide reach;
    int surface;
    wide blend, cosine, upward, east, north;
} hit;

// What rays can meet.
typedef struct {
    __constant box *boxes;
    __constant int2 *stripes;
    int box_count;
    __constant billboard *billboards;
    __constant texture *textures;
    __global const float *texels;
    int billboard_count;
#ifdef MESHES
    mesh meshes;
#endif
} things;

// Cuts the stretch enter ... leave of a ray down to its part between two parallel faces, where
// -half_size <= position < half_size.
static void slab(wide origin, wide direction, wide half_size, int axis, wide *enter, wide *leave,
                 int *enter_axis, int *leave_axis)
{
    if (direction == 0) {
        if (origin < -half_size || origin >= half_size) *leave = -INFINITY;
        return;
    }
    const wide one = (-half_size - origin) / direction, other = (half_size - origin) / direction;
    const wide near = one < other ? one : other, far = one < other ? other : one;
    if (near > *enter) { *enter = near; *enter_axis = axis; }
    if (far < *leave) { *leave = far; *leave_axis = axis; }
}

// The stripe at a point of a face, of `count` stripes from the left as seen from outside.
static int stripe_at(const wide *p, const wide *half_size, int axis, int positive, int count)
{
    // Seen from outside, the other horizontal axis runs to the right on the faces +x, -y and +z,
    // and to the left on -x, +y and -z.
    const int across = axis == 0 ? 1 : 0, to_right = axis == 1 ? !positive : positive;
    const wide part = (to_right ? p[across] + half_size[across] : half_size[across] - p[across]) /
                      (2 * half_size[across]);
    return clamp((int)(part * count), 0, count - 1);
}

// Records a box in `nearest` if the ray meets it sooner. `stripes` holds for each face (-x, +x, -y,
// +y, -z, +z) the number of its stripes, or 0, and the surface of every other stripe, beginning
// with the leftmost.
static void meet_box(__constant box *b, __constant int2 *stripes, int surface, point origin,
                     point direction, wide norm, hit *nearest)
{
    const wide east = origin.x - b->x, north = origin.y - b->y;
    const wide half_size[3] = {b->half_x, b->half_y, b->half_z};
    const wide o[3] = {b->cosine * east + b->sine * north, b->cosine * north - b->sine * east,
                       origin.z - b->z};
    const wide d[3] = {b->cosine * direction.x + b->sine * direction.y,
                       b->cosine * direction.y - b->sine * direction.x, direction.z};
    wide enter = -INFINITY, leave = INFINITY;
    int enter_axis = 0, leave_axis = 0;
    for (int axis = 0; axis < 3; ++axis)
        slab(o[axis], d[axis], half_size[axis], axis, &enter, &leave, &enter_axis, &leave_axis);

    // From inside, the face that the ray leaves by is seen.
    const int inside = enter <= 0, axis = inside ? leave_axis : enter_axis;
    const wide reach = inside ? leave : enter;
    if (!(enter < leave) || !(reach > 0) || !(reach < nearest->reach)) return;
    nearest->reach = reach;
    nearest->surface = surface;
    nearest->blend = 0;
    nearest->cosine = fabs(d[axis]) / norm;
    nearest->upward = axis < 2 ? 0 : d[axis] < 0 ? 1 : -1;
    const wide turned = axis == 2 ? 0 : d[axis] < 0 ? 1 : -1;
    nearest->east = turned * (axis == 0 ? b->cosine : -b->sine);
    nearest->north = turned * (axis == 0 ? b->sine : b->cosine);
    const int positive = (d[axis] > 0) == inside;
    const int2 face = stripes[2 * axis + positive];
    if (face.x > 0) {
        const wide p[3] = {o[0] + reach * d[0], o[1] + reach * d[1], o[2] + reach * d[2]};
        if (stripe_at(p, half_size, axis, positive, face.x) % 2 == 0) nearest->surface = face.y;
    }
}

// A texture's value at (u, v), both 0 to 1 from its top left, with texel centres at half numbers.
static wide texel(__global const float *values, int width, int height, int nearest, wide u, wide v)
{
    if (nearest)
        return values[clamp((int)(v * height), 0, height - 1) * width +
                      clamp((int)(u * width), 0, width - 1)];
    const wide x = clamp(u * width - (wide)0.5, (wide)0, (wide)(width - 1)),
               y = clamp(v * height - (wide)0.5, (wide)0, (wide)(height - 1));
    const int left = (int)x, top = (int)y, right = min(left + 1, width - 1),
              below = min(top + 1, height - 1);
    const wide fx = x - left, fy = y - top;
    const wide upper = (1 - fx) * values[top * width + left] + fx * values[top * width + right];
    const wide lower = (1 - fx) * values[below * width + left] + fx * values[below * width + right];
    return (1 - fy) * upper + fy * lower;
}

// Records a billboard in `nearest` if the ray meets it sooner, where its mask is not below half.
static void meet_billboard(__constant billboard *b, __constant texture *t,
                           __global const float *texels, point origin, point direction, wide norm,
                           hit *nearest)
{
    const wide ahead = direction.x * b->cosine + direction.y * b->sine;
    const wide reach = ((b->x - origin.x) * b->cosine + (b->y - origin.y) * b->sine) / ahead;
    if (ahead == 0 || !(reach > 0) || !(reach < nearest->reach)) return;
    const point p = along(origin, reach, direction);
    // Seen from the front, right is the front's direction turned by a quarter to the left, seen
    // from above.
    const wide u = (wide)0.5 +
                   ((p.y - b->y) * b->cosine - (p.x - b->x) * b->sine) / (2 * b->half_width);
    const wide v = (wide)0.5 - (p.z - b->z) / (2 * b->half_height);
    if (u < 0 || u >= 1 || v < 0 || v >= 1) return;
    if (t->mask >= 0 && texel(texels + t->mask, t->width, t->height, 1, u, v) < (wide)0.5) return;
    const wide level =
        texel(texels + t->first, t->width, t->height, t->nearest, u, v) * (t->levels - 1);
    const int below = clamp((int)level, 0, t->levels - 2);
    nearest->reach = reach;
    nearest->surface = t->surface + below;
    nearest->blend = level - below;
    nearest->cosine = fabs(ahead) / norm;
    nearest->upward = 0;
    nearest->east = ahead < 0 ? b->cosine : -b->cosine;
    nearest->north = ahead < 0 ? b->sine : -b->sine;
}

// Where a ray ends that meets nothing: at `max_range`, or sooner where it rises to the height of
// `ceiling`.
static hit nothing_met(point origin, point d, wide norm, wide max_range, wide ceiling)
{
    hit nearest = {max_range / norm, 0, 0, 0, 0, 0, 0};
#ifdef CEILING
    if (d.z > 0) nearest.reach = min(nearest.reach, max((ceiling - origin.z) / d.z, (wide)0));
#endif
    return nearest;
}

#ifdef MESHES
// A normal of a triangle, twice as long as its area.
static point triangle_normal(const mesh *all, int triangle)
{
    const int4 t = all->triangles[triangle];
    __global const wide *a = all->vertices + 3 * t.x, *b = all->vertices + 3 * t.y,
                        *c = all->vertices + 3 * t.z;
    const point one = {b[0] - a[0], b[1] - a[1], b[2] - a[2]},
                other = {c[0] - a[0], c[1] - a[1], c[2] - a[2]};
    const point n = {one.y * other.z - one.z * other.y, one.z * other.x - one.x * other.z,
                     one.x * other.y - one.y * other.x};
    return n;
}

// Records the nearest triangle of all meshes in `nearest` if the ray meets it sooner.
static void meet_meshes(const mesh *all, point origin, point direction, wide norm, hit *nearest)
{
    const wide o[3] = {origin.x, origin.y, origin.z}, d[3] = {direction.x, direction.y, direction.z};
    const shot ray = shot_of(o, d);
    strike met = {nearest->reach, -1, 0, 0, 0};
    meet_triangles(all, &ray, &met);
    if (met.triangle < 0) return;
    const point n = triangle_normal(all, met.triangle);
    const wide across = n.x * d[0] + n.y * d[1] + n.z * d[2];
    const wide size = sqrt(n.x * n.x + n.y * n.y + n.z * n.z);
    const wide towards = across < 0 ? 1 / size : -1 / size;
    nearest->reach = met.reach;
    nearest->surface = all->triangles[met.triangle].w;
    nearest->blend = 0;
    nearest->cosine = min(fabs(across) / (size * norm), (wide)1);
    nearest->upward = towards * n.z;
    nearest->east = towards * n.x;
    nearest->north = towards * n.y;
#ifdef TEMPERED
    __global const float *level = all->levels + 3 * met.triangle;
    const wide beyond = met.u * level[0] + met.v * level[1] + met.w * level[2];
    const int below = max((int)beyond, 0);
    nearest->surface += below;
    nearest->blend = max(beyond - below, (wide)0);
#endif
}
#endif

static void meet_all(const things *all, point origin, point direction, wide norm, hit *nearest)
{
#ifdef GROUND
    const wide down = -origin.z / direction.z;
    if (direction.z < 0 && down > 0 && down < nearest->reach) {
        nearest->reach = down;
        nearest->surface = GROUND_PLANE;
        nearest->cosine = -direction.z / norm;
        nearest->upward = 1;
        nearest->east = nearest->north = 0;
    }
#endif
#ifdef BOXES
    for (int b = 0; b < all->box_count; ++b)
        meet_box(all->boxes + b, all->stripes + 6 * b, FIRST_TARGET + b, origin, direction, norm,
                 nearest);
#endif
#ifdef BILLBOARDS
    for (int b = 0; b < all->billboard_count; ++b)
        meet_billboard(all->billboards + b, all->textures + b, all->texels, origin, direction, norm,
                       nearest);
#endif
#ifdef MESHES
    meet_meshes(&all->meshes, origin, direction, norm, nearest);
#endif
}

// The parameters of a kernel that finds what rays meet, and the struct made of them.
#define THINGS_PARAMETERS                                                                          \
    __constant box *boxes, __constant int2 *stripes, int box_count,                                \
    __constant billboard *billboards, __constant texture *textures,                                \
    __global const float *texels, int billboard_count, __global const float *mesh_boxes,           \
    __global const int2 *mesh_links, __global const int4 *mesh_triangles,                          \
    __global const wide *mesh_vertices, __global const float *mesh_levels
#ifdef MESHES
#define THINGS                                                                                     \
    {boxes, stripes, box_count, billboards, textures, texels, billboard_count,                     \
     {mesh_boxes, mesh_links, mesh_triangles, mesh_vertices, mesh_levels}}
#else
#define THINGS {boxes, stripes, box_count, billboards, textures, texels, billboard_count}
#endif


// How far beside a surface, over the way to it, a ray begins that leaves it.
#ifdef WIDE
#define BESIDE 1e-9
#else
#define BESIDE (wide)1e-6
#endif

// The normal of what was met, towards the ray's start.
static inline point normal_of(const hit *met)
{
    const point n = {met->east, met->north, met->upward};
    return n;
}

// The part (e . s)^2 of the power whose field stands across the plane of incidence: e is the
// polarisation seen, projected across the ray, and s the unit vector across ray and normal. It is
// half where the ray comes along the normal, or meets nothing.
static inline wide part_across(point d, wide norm, const hit *met, __global const wide *polarization)
{
    const point n = normal_of(met), e = {polarization[0], polarization[1], polarization[2]};
    const point s = {n.y * d.z - n.z * d.y, n.z * d.x - n.x * d.z, n.x * d.y - n.y * d.x};
    const wide size = s.x * s.x + s.y * s.y + s.z * s.z, square = norm * norm;
    const wide along_ray = e.x * d.x + e.y * d.y + e.z * d.z;
    const wide seen = e.x * e.x + e.y * e.y + e.z * e.z - along_ray * along_ray / square;
    if (!(size > (wide)1e-12 * square) || !(seen > (wide)1e-12)) return (wide)0.5;
    const wide across = e.x * s.x + e.y * s.y + e.z * s.z;   // s stands across the ray
    return min(across * across / (size * seen), (wide)1);
}

// For each of the `count` rays that are followed, in their order: `reach` in the ray's parameter;
// `path_length` in metres; `stretch`, metres per unit of the parameter; `surface` and `blend` as in
// source.cl; `cosine` of the angle between ray and normal; `elevation`, the sine of the angle above
// the horizon at which the ray goes on if it is mirrored, or as it comes if it meets nothing;
// `upward`, the vertical component of the normal; `across`, the part of the power with its electric
// field along `polarization` in the image that stands across the plane of incidence. Of the mirrored
// ray, `met` is the surface and `bounce` what source.cl says.
__kernel void surfaces(__constant frame *camera, int width, int height, wide max_range,
                       wide ceiling, THINGS_PARAMETERS,
                       __global const int *restrict picked, int count,
                       __global wide *restrict reach, __global real *restrict stretch,
                       __global real *restrict path_length, __global int *restrict surface,
                       __global real *restrict blend, __global real *restrict cosine,
                       __global real *restrict elevation, __global real *restrict upward,
                       __global const wide *polarization, __global real *restrict across,
                       __global int *restrict met, __global real *restrict bounce)
{
    const int slot = get_global_id(0), ray = RAY(min(slot, count - 1));
    const things all = THINGS;
    const point d = ray_direction(camera, width, height, ray);
    const wide norm = sqrt(d.x * d.x + d.y * d.y + d.z * d.z);
    hit nearest = nothing_met(camera->origin, d, norm, max_range, ceiling);
    meet_all(&all, camera->origin, d, norm, &nearest);
    reach[slot] = nearest.reach;
    stretch[slot] = (real)norm;
    path_length[slot] = (real)(nearest.reach * norm);
    surface[slot] = nearest.surface;
#ifdef BLENDED
    blend[slot] = (real)nearest.blend;
#endif
#ifdef COSINE
    cosine[slot] = (real)nearest.cosine;
#endif
#ifdef ELEVATION
    elevation[slot] = (real)(d.z / norm + 2 * nearest.cosine * nearest.upward);
    upward[slot] = (real)nearest.upward;
#endif
#ifdef ACROSS
    across[slot] = (real)part_across(d, norm, &nearest, polarization);
#endif
#ifdef BOUNCES
    const point off = along(along(camera->origin, nearest.reach, d), BESIDE * nearest.reach * norm,
                            normal_of(&nearest));
    const point on = along(d, 2 * nearest.cosine * norm, normal_of(&nearest));
    hit next = nothing_met(off, on, norm, max_range, ceiling);
    if (nearest.surface != BACKGROUND) meet_all(&all, off, on, norm, &next);
    met[slot] = next.surface;
    __global real *there = bounce + 5 * slot;
    there[0] = (real)next.blend;
    there[1] = (real)next.cosine;
    there[2] = (real)(on.z / norm + 2 * next.cosine * next.upward);
    there[3] = (real)next.upward;
    there[4] = (real)(next.reach * norm);
#endif
}

#ifdef OUTGOING
// The last part of a way, in which only the surface is met that it leads to: more than rounding
// moves that surface.
#ifdef WIDE
#define SAME_SURFACE 1e-9
#else
#define SAME_SURFACE 1e-5
#endif

// The way from the transmitter, the frame's origin, to what each camera ray met: its `end` (1, or 0
// where nothing was met or something stands between), and its `length` in metres, which is also the
// stretch of its parameter.
__kernel void outgoing(__constant frame *transmitter, int width, int height, THINGS_PARAMETERS,
                       __global const int *restrict picked, int count,
                       __global const wide *restrict reach, __global int *restrict surface,
                       int first_of_meshes,
                       __global wide *restrict end, __global real *restrict length)
{
    const int slot = get_global_id(0), ray = RAY(min(slot, count - 1));
    const things all = THINGS;
    const point d = follow_direction(transmitter, width, height, ray, reach[slot]);
    const wide norm = sqrt(d.x * d.x + d.y * d.y + d.z * d.z);
    // The point itself lies at 1: what is met just before it is the surface that it lies on.
    hit nearest = {1 - (wide)SAME_SURFACE, BACKGROUND, 0, 0, 0, 0, 0};
    meet_all(&all, transmitter->origin, d, norm, &nearest);
    int lit = surface[slot] != BACKGROUND && nearest.surface == BACKGROUND;
#ifdef BILLBOARDS
    // A billboard is lit on the side that the camera sees, or not at all.
    const point seen = ray_direction(transmitter, width, height, ray);
    for (int b = 0; b < billboard_count; ++b) {
        __constant billboard *board = billboards + b;
        const wide lighting = d.x * board->cosine + d.y * board->sine,
                   viewing = seen.x * board->cosine + seen.y * board->sine;
        const int row = surface[slot] - textures[b].surface;
        if (row >= 0 && row < textures[b].levels && (lighting > 0) != (viewing > 0)) lit = 0;
    }
#endif
#ifdef MESHES
    // So is a triangle, which may stand alone: the camera's ray is looked at again.
    const point eye = along(transmitter->origin, 1, transmitter->offset),
                view = ray_direction(transmitter, width, height, ray);
    const wide seen_from[3] = {eye.x, eye.y, eye.z}, going[3] = {view.x, view.y, view.z};
    const shot camera_ray = shot_of(seen_from, going);
    strike met = {reach[slot] * (1 + (wide)SAME_SURFACE), -1, 0, 0, 0};
    if (surface[slot] >= first_of_meshes) meet_triangles(&all.meshes, &camera_ray, &met);
    if (met.triangle >= 0) {
        const point n = triangle_normal(&all.meshes, met.triangle);
        const wide lighting = n.x * d.x + n.y * d.y + n.z * d.z,
                   viewing = n.x * view.x + n.y * view.y + n.z * view.z;
        if ((lighting > 0) != (viewing > 0)) lit = 0;
    }
#endif
    if (!lit) surface[slot] = BACKGROUND;
    end[slot] = lit;
    length[slot] = (real)(lit * norm);
}
#endif
