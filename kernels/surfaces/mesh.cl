// Where rays meet triangles, by a tree of boxes. The test of a triangle loses no ray through an edge
// or a vertex that two triangles share (Woop, Benthin and Wald 2013, JCGT 2, 65): each edge is
// judged by one product of differences, whose sign is the same for both triangles. The compiler must
// not fuse these products with the difference, since then they would not be.
//
// Option: MESHES where the scene has them; TEMPERED where their temperature varies.

#ifdef MESHES
#pragma OPENCL FP_CONTRACT OFF

#define DEEPEST 64        // boxes on the way down that are still to be looked at: deeper than trees
#define ROUNDED (wide)8   // roundings by which boxes are widened
#ifdef WIDE
#define EPSILON (wide)2.2204460492503131e-16
#define SMALLEST (wide)1e-300
#else
#define EPSILON (wide)1.1920929e-7
#define SMALLEST (wide)1e-30
#endif

// Triangles, and the tree over them: `boxes` (node, 6) are the lowest and the highest corner, and
// `links` (node, 2) the first of two children that follow each other, and 0, or the first triangle
// and how many there are. A triangle has three `vertices` and a surface. `levels` (triangle, 3) say
// how far each corner lies beyond its surface, in numbers of surfaces.
typedef struct {
    __global const float *boxes;
    __global const int2 *links;
    __global const int4 *triangles;
    __global const wide *vertices;
    __global const float *levels;
} mesh;

// A ray as triangles see it: its longest component is axis z, towards which the others are sheared.
typedef struct {
    int x, y, z;
    wide shear_x, shear_y, scale;
    wide origin[3], inverse[3];
} shot;

// What a ray meets: how far it goes, the triangle, and the weights of its corners.
typedef struct {
    wide reach;
    int triangle;
    wide u, v, w;
} strike;

static shot shot_of(const wide *origin, const wide *direction)
{
    shot s;
    const wide a = fabs(direction[0]), b = fabs(direction[1]), c = fabs(direction[2]);
    s.z = a > b ? (a > c ? 0 : 2) : (b > c ? 1 : 2);
    s.x = (s.z + 1) % 3;
    s.y = (s.x + 1) % 3;
    s.shear_x = direction[s.x] / direction[s.z];
    s.shear_y = direction[s.y] / direction[s.z];
    s.scale = 1 / direction[s.z];
    for (int k = 0; k < 3; ++k) {
        const wide d = direction[k];
        s.origin[k] = origin[k];
        s.inverse[k] = 1 / (fabs(d) < SMALLEST ? SMALLEST : d);
    }
    return s;
}

// Where a ray enters a box, widened by its roundings, or INFINITY if it does not before `reach`.
static wide entered(const shot *ray, __global const float *box, wide reach)
{
    wide enter = 0, leave = reach;
    for (int k = 0; k < 3; ++k) {
        const wide one = (box[k] - ray->origin[k]) * ray->inverse[k],
                   other = (box[k + 3] - ray->origin[k]) * ray->inverse[k];
        enter = fmax(enter, fmin(one, other) * (1 - ROUNDED * EPSILON));
        leave = fmin(leave, fmax(one, other) * (1 + ROUNDED * EPSILON));
    }
    return enter <= leave ? enter : INFINITY;
}

// Records a triangle in `nearest` if the ray meets it sooner, from either side.
static void meet_triangle(const shot *ray, const mesh *all, int triangle, strike *nearest)
{
    const int4 t = all->triangles[triangle];
    const int corner[3] = {t.x, t.y, t.z};
    wide x[3], y[3], z[3];
    for (int k = 0; k < 3; ++k) {
        __global const wide *v = all->vertices + 3 * corner[k];
        const wide depth = v[ray->z] - ray->origin[ray->z];
        x[k] = (v[ray->x] - ray->origin[ray->x]) - ray->shear_x * depth;
        y[k] = (v[ray->y] - ray->origin[ray->y]) - ray->shear_y * depth;
        z[k] = ray->scale * depth;
    }
    const wide u = x[2] * y[1] - y[2] * x[1], v = x[0] * y[2] - y[0] * x[2],
               w = x[1] * y[0] - y[1] * x[0];
    if ((u < 0 || v < 0 || w < 0) && (u > 0 || v > 0 || w > 0)) return;
    const wide sum = u + v + w;
    if (sum == 0) return;
    const wide reach = (u * z[0] + v * z[1] + w * z[2]) / sum;
    if (!(reach > 0) || !(reach < nearest->reach)) return;
    nearest->reach = reach;
    nearest->triangle = triangle;
    nearest->u = u / sum;
    nearest->v = v / sum;
    nearest->w = w / sum;
}

// Finds the nearest triangle before `nearest->reach`, if there is one; else its triangle stays.
static void meet_triangles(const mesh *all, const shot *ray, strike *nearest)
{
    int waiting[DEEPEST], count = 0, node = 0;
    wide since[DEEPEST];
    if (entered(ray, all->boxes, nearest->reach) == INFINITY) return;
    for (;;) {
        const int2 link = all->links[node];
        if (link.y > 0) {
            for (int k = 0; k < link.y; ++k) meet_triangle(ray, all, link.x + k, nearest);
        } else {
            const wide one = entered(ray, all->boxes + 6 * link.x, nearest->reach),
                       other = entered(ray, all->boxes + 6 * link.x + 6, nearest->reach);
            const int first = link.x + (other < one), second = link.x + !(other < one);
            if (fmax(one, other) < INFINITY) {
                waiting[count] = second;
                since[count++] = fmax(one, other);
            }
            if (fmin(one, other) < INFINITY) {
                node = first;
                continue;
            }
        }
        do {
            if (count == 0) return;
            node = waiting[--count];
        } while (since[count] > nearest->reach);
    }
}
#endif
