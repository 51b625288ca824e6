// Where each ray ends: ground, boxes, or the longest range. In float64 where the device has it, one work-item a ray.
//
// Options: GROUND and BOXES where the scene has them.

#define BACKGROUND 0
#define GROUND_PLANE 1
#define FIRST_TARGET 2

// A box turned about the vertical: centre, half size, cosine and sine of the turn.
typedef struct {
    wide x, y, z, half_x, half_y, half_z, cosine, sine;
} box;

// The nearest thing met so far, and where.
typedef struct {
    wide reach;
    int surface;
} hit;

// Cuts the stretch enter ... leave of a ray down to its part between two parallel faces, -half <= position < half.
static void slab(wide origin, wide direction, wide half_size, int axis, wide *enter, wide *leave, int *enter_axis, int *leave_axis)
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

// The stripe at a point of a face, from the left as seen from outside, of `count` stripes.
static int stripe_at(const wide *point, const wide *half_size, int axis, int positive, int count)
{
    // Seen from outside, +x, -y and +z have their other horizontal axis running to the right, -x, +y and -z to the left.
    const int across = axis == 0 ? 1 : 0, to_right = axis == 1 ? !positive : positive;
    const wide part = (to_right ? point[across] + half_size[across] : half_size[across] - point[across]) / (2 * half_size[across]);
    return clamp((int)(part * count), 0, count - 1);
}

static void meet_box(__constant box *b, __constant int2 *stripes, int surface, point origin, point direction, hit *nearest)
{
    const wide along = origin.x - b->x, aside = origin.y - b->y;
    const wide half_size[3] = {b->half_x, b->half_y, b->half_z};
    const wide o[3] = {b->cosine * along + b->sine * aside, b->cosine * aside - b->sine * along, origin.z - b->z};
    const wide d[3] = {b->cosine * direction.x + b->sine * direction.y, b->cosine * direction.y - b->sine * direction.x, direction.z};
    wide enter = -INFINITY, leave = INFINITY;
    int enter_axis = 0, leave_axis = 0;
    for (int axis = 0; axis < 3; ++axis) slab(o[axis], d[axis], half_size[axis], axis, &enter, &leave, &enter_axis, &leave_axis);

    // From inside, the face that the ray leaves by is seen.
    const int inside = enter <= 0, axis = inside ? leave_axis : enter_axis;
    const wide reach = inside ? leave : enter;
    if (!(enter < leave) || !(reach > 0) || !(reach < nearest->reach)) return;
    nearest->reach = reach;
    nearest->surface = surface;
    const int positive = (d[axis] > 0) == inside;
    const int2 face = stripes[2 * axis + positive];
    if (face.x > 0) {
        const wide point[3] = {o[0] + reach * d[0], o[1] + reach * d[1], o[2] + reach * d[2]};
        if (stripe_at(point, half_size, axis, positive, face.x) % 2 == 0) nearest->surface = face.y;
    }
}

// `reach` in the ray's parameter; `path_length` in metres, and `stretch`, metres per unit of the parameter.
__kernel void surfaces(__constant frame *camera, int width, int height, wide max_range, __constant box *boxes,
                       __constant int2 *stripes, int box_count, __global wide *restrict reach,
                       __global real *restrict stretch, __global real *restrict path_length, __global int *restrict surface)
{
    const int ray = get_global_id(0);
    const point d = ray_direction(camera, width, height, min(ray, width * height - 1));
    const wide norm = sqrt(d.x * d.x + d.y * d.y + d.z * d.z);
    hit nearest = {max_range / norm, BACKGROUND};
#ifdef GROUND
    const wide down = -camera->origin.z / d.z;
    if (d.z < 0 && down > 0 && down < nearest.reach) {
        nearest.reach = down;
        nearest.surface = GROUND_PLANE;
    }
#endif
#ifdef BOXES
    for (int b = 0; b < box_count; ++b) meet_box(boxes + b, stripes + 6 * b, FIRST_TARGET + b, camera->origin, d, &nearest);
#endif
    reach[ray] = nearest.reach;
    stretch[ray] = (real)norm;
    path_length[ray] = (real)(nearest.reach * norm);
    surface[ray] = nearest.surface;
}
