// Fewer rays where neighbours share voxels. Rays on a lattice of the raster (every `stride`-th of
// its rows and columns, and the last of each) are traced, and so are those that see another thing
// than the lattice around them; the rest is interpolated. The means along the path, M_k over its
// length, are what is interpolated, since they vary smoothly over a surface; the length itself
// stays each ray's own.
//
// Option: MOMENTS.

#define BETWEEN 0   // interpolated
#define LATTICE 1
#define ALONE 2     // traced, since the lattice around it does not see what it sees

// The lattice cell of a ray: the ray's row and column, those of the cell's edges, and the row and
// column of its upper left corner on the lattice.
typedef struct {
    int row, column, top, bottom, left, right, lattice_row, lattice_column;
} cell;

static cell cell_of(int ray, int width, int height, int stride)
{
    cell c;
    c.row = ray / width;
    c.column = ray - c.row * width;
    c.lattice_row = c.row / stride;
    c.lattice_column = c.column / stride;
    c.top = c.lattice_row * stride;
    c.left = c.lattice_column * stride;
    c.bottom = min(c.top + stride, height - 1);
    c.right = min(c.left + stride, width - 1);
    return c;
}

// Turns a ray's cell into that of the next ray, without the divisions of cell_of, which would cost
// more than all the rest.
static inline void cell_next(cell *c, int width, int height, int stride)
{
    if (++c->column == width) {
        c->column = c->left = c->lattice_column = 0;
        c->right = min(stride, width - 1);
        if (++c->row - c->top == stride) {
            c->top = c->row;
            c->bottom = min(c->top + stride, height - 1);
            ++c->lattice_row;
        }
    } else if (c->column - c->left == stride) {
        c->left = c->column;
        c->right = min(c->left + stride, width - 1);
        ++c->lattice_column;
    }
}

// What all corners of a cell see, or -1 where they differ, and the span of lengths of the rays that
// may be interpolated between them. Towards the horizon neighbours end far apart, behind air that
// they do not share, so a ray's length must lie near those of all corners.
typedef struct {
    int thing;
    real shortest, longest;
} view;

static view view_of(const cell *c, int width, __global const int *surface,
                    __global const real *length, __global const int *things)
{
    const int corners[4] = {c->top * width + c->left, c->top * width + c->right,
                            c->bottom * width + c->left, c->bottom * width + c->right};
    view v = {things[surface[corners[0]]], length[corners[0]], length[corners[0]]};
    for (int k = 1; k < 4; ++k) {
        const real there = length[corners[k]];
        if (things[surface[corners[k]]] != v.thing) v.thing = -1;
        v.shortest = there < v.shortest ? there : v.shortest;
        v.longest = there > v.longest ? there : v.longest;
    }
    const real least = v.longest / (real)1.1;
    v.longest = v.shortest / (real)0.9;
    v.shortest = least;
    return v;
}

// Writes the kind of each ray. `things` maps surfaces to the number of what they belong to, so that
// stripes and shades of one target are one.
__kernel void sift(int width, int height, int stride, __global const int *restrict surface,
                   __global const real *restrict length, __global const int *restrict things,
                   __global char *restrict kind)
{
    const int first = get_global_id(0) * LANES, rays = width * height;
    if (first >= rays) return;
    cell c = cell_of(first, width, height, stride);
    view v = view_of(&c, width, surface, length, things);
    for (int ray = first; ray < min(first + LANES, rays);
         ++ray, cell_next(&c, width, height, stride)) {
        if (c.column == c.left) v = view_of(&c, width, surface, length, things);
        const int on_row = c.row == c.top || c.row == height - 1,
                  on_column = c.column == c.left || c.column == width - 1;
        const int same = things[surface[ray]] == v.thing && length[ray] >= v.shortest &&
                         length[ray] <= v.longest;
        kind[ray] = on_row && on_column ? LATTICE : same ? BETWEEN : ALONE;
    }
}

// Writes the moments of every ray (MOMENTS, ray). `means` (MOMENTS, lattice) are M_k over the
// length; `kept` (lattice) is the part of its length that the cut-off left a ray on the lattice;
// `traced` (MOMENTS, slot) are the moments of the traced rays, and `slot` is a ray's place among
// them. Where a corner was cut off, what lies between ends as early, and meets nothing.
__kernel void spread(int items, int width, int height, int stride, __global const char *restrict kind,
                     __global const int *restrict slot, __global const real *restrict means,
                     int lattice_width, int lattice, __global const real *restrict kept,
                     __global const real *restrict traced, int padded,
                     __global real *restrict path_length, __global int *restrict surface,
                     __global real *restrict moments)
{
    const int first = get_global_id(0) * LANES, all = items * LANES,
              last = width * height - 1;
    whole nw[LANES], ne[LANES], sw[LANES], se[LANES];
    real across[LANES], down[LANES];
    cell c = cell_of(min(first, last), width, height, stride);
    for (int lane = 0; lane < LANES; ++lane) {
        const int right = c.lattice_column + (c.right > c.left),
                  bottom = c.lattice_row + (c.bottom > c.top);
        nw[lane] = c.lattice_row * lattice_width + c.lattice_column;
        ne[lane] = c.lattice_row * lattice_width + right;
        sw[lane] = bottom * lattice_width + c.lattice_column;
        se[lane] = bottom * lattice_width + right;
        across[lane] = c.right > c.left ? (real)(c.column - c.left) / (c.right - c.left) : 0;
        down[lane] = c.bottom > c.top ? (real)(c.row - c.top) / (c.bottom - c.top) : 0;
        if (first + lane < last) cell_next(&c, width, height, stride);
    }
    const wholes i = LOAD(nw), j = LOAD(ne), k = LOAD(sw), l = LOAD(se);
    const reals x = LOAD(across), y = LOAD(down);
    const reals upper = SMALLER(GATHER(kept, i), GATHER(kept, j)),
                lower = SMALLER(GATHER(kept, k), GATHER(kept, l));
    const reals part = SMALLER(upper, lower), length = LOAD(path_length + first) * part;
    real left_of[LANES];
    STORE(part, left_of);
    UNROLLED
    for (int m = 0; m < MOMENTS; ++m) {
        __global const real *mean = means + (size_t)m * lattice;
        const reals above = GATHER(mean, i) + x * (GATHER(mean, j) - GATHER(mean, i));
        const reals below = GATHER(mean, k) + x * (GATHER(mean, l) - GATHER(mean, k));
        STORE(length * (above + y * (below - above)), moments + (size_t)m * all + first);
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
            UNROLLED
            for (int m = 0; m < MOMENTS; ++m)
                moments[(size_t)m * all + ray] = traced[(size_t)m * padded + slot[ray]];
        }
    }
}
