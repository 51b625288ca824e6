// Fewer rays where neighbours share voxels: rays on a lattice of the raster, every `stride`-th of its rows and columns and the
// last of each, are traced, and so are those whose neighbours on it see another thing; the rest is interpolated. What is
// interpolated are the means along the path, M_k over its length, which vary smoothly over a surface; the length itself
// stays each ray's own.
//
// Option: MOMENTS.

#define BETWEEN 0   // interpolated
#define LATTICE 1
#define ALONE 2     // traced, since the lattice around it does not see what it sees

// The lattice cell of a ray: the ray's row and column, and those of the corners.
typedef struct {
    int row, column, top, bottom, left, right;
} cell;

static inline cell cell_of(int ray, int width, int height, int stride)
{
    cell c;
    c.row = ray / width;
    c.column = ray % width;
    c.top = c.row / stride * stride;
    c.left = c.column / stride * stride;
    c.bottom = min(c.top + stride, height - 1);
    c.right = min(c.left + stride, width - 1);
    return c;
}

// A thing's own number: `things` maps surfaces to it, so that stripes and shades of one target are one.
static inline int alike(__global const int *surface, __global const real *length, __global const int *things, int one, int other)
{
    const real here = length[one], there = length[other];
    // Towards the horizon neighbours end far apart, behind air that they do not share.
    return things[surface[one]] == things[surface[other]] && fabs(here - there) <= (real)0.1 * here;
}

__kernel void sift(int width, int height, int stride, __global const int *restrict surface,
                   __global const real *restrict length, __global const int *restrict things, __global char *restrict kind)
{
    const int ray = get_global_id(0);
    if (ray >= width * height) return;
    const cell c = cell_of(ray, width, height, stride);
    if ((c.row == c.top || c.row == height - 1) && (c.column == c.left || c.column == width - 1)) {
        kind[ray] = LATTICE;
        return;
    }
    const int same = alike(surface, length, things, ray, c.top * width + c.left) &&
                     alike(surface, length, things, ray, c.top * width + c.right) &&
                     alike(surface, length, things, ray, c.bottom * width + c.left) &&
                     alike(surface, length, things, ray, c.bottom * width + c.right);
    kind[ray] = same ? BETWEEN : ALONE;
}

// Moments of every ray (MOMENTS, ray): `means` (MOMENTS, lattice) are M_k over the length, `kept` (lattice) the part of its
// length that the cut-off left a ray on the lattice; `traced` (MOMENTS, slot) the moments of rays traced, `slot` a ray's
// place among them. Where a corner was cut off, so is what lies between: it ends as early, and meets nothing.
__kernel void spread(int width, int height, int stride, __global const char *restrict kind, __global const int *restrict slot,
                     __global const real *restrict means, int lattice_width, int lattice, __global const real *restrict kept,
                     __global const real *restrict traced, int padded, __global real *restrict path_length,
                     __global int *restrict surface, __global real *restrict moments)
{
    const int first = get_global_id(0) * LANES, all = get_global_size(0) * LANES, last = width * height - 1;
    whole nw[LANES], ne[LANES], sw[LANES], se[LANES];
    real across[LANES], down[LANES];
    for (int lane = 0; lane < LANES; ++lane) {
        const cell c = cell_of(min(first + lane, last), width, height, stride);
        const int left = c.left / stride, right = left + (c.right > c.left), top = c.top / stride, bottom = top + (c.bottom > c.top);
        nw[lane] = top * lattice_width + left;
        ne[lane] = top * lattice_width + right;
        sw[lane] = bottom * lattice_width + left;
        se[lane] = bottom * lattice_width + right;
        across[lane] = c.right > c.left ? (real)(c.column - c.left) / (c.right - c.left) : 0;
        down[lane] = c.bottom > c.top ? (real)(c.row - c.top) / (c.bottom - c.top) : 0;
    }
    const wholes i = LOAD(nw), j = LOAD(ne), k = LOAD(sw), l = LOAD(se);
    const reals x = LOAD(across), y = LOAD(down);
    const reals upper = SMALLER(GATHER(kept, i), GATHER(kept, j)), lower = SMALLER(GATHER(kept, k), GATHER(kept, l));
    const reals part = SMALLER(upper, lower), length = LOAD(path_length + first) * part;
    real left_of[LANES];
    STORE(part, left_of);
    for (int m = 0; m < MOMENTS; ++m) {
        __global const real *mean = means + m * lattice;
        const reals above = GATHER(mean, i) + x * (GATHER(mean, j) - GATHER(mean, i));
        const reals below = GATHER(mean, k) + x * (GATHER(mean, l) - GATHER(mean, k));
        STORE(length * (above + y * (below - above)), moments + m * all + first);
    }
    for (int lane = 0; lane < LANES; ++lane) {
        const int ray = first + lane;
        if (ray > last) return;
        if (kind[ray] == BETWEEN) {
            if (left_of[lane] < 1) {
                path_length[ray] *= left_of[lane];
                surface[ray] = 0;
            }
        } else {
            for (int m = 0; m < MOMENTS; ++m) moments[m * all + ray] = traced[m * padded + slot[ray]];
        }
    }
}
