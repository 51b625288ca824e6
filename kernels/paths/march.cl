// Voxel by voxel through the periodic cube (Amanatides and Woo 1987), LANES rays abreast. Lengths
// along a ray are in the ray's own parameter: the point at s is origin + s * direction, and the
// direction of a camera's ray has component 1 along the optical axis.
//
// Crossings are counted and the place of each is computed afresh: adding steps up drifts, thirty
// times worse after 660 voxels. A ray in a face of a voxel belongs to the voxel above it: voxel i
// spans [i, i + 1).
//
// Edges of the cube are powers of two, given by their logarithms. A bounded cube is crossed from
// where a ray enters it to where the ray leaves it; nothing is known of the air around it here.
//
// Options: MOTION and OUTGOING as in camera.cl; CLIPPED where the cube is bounded.

typedef struct {
    reals step;        // ray parameter from one crossing of this axis to the next
    reals first;       // ray parameter at the first crossing
    reals next;        // ray parameter at the next crossing
    reals following;   // at the crossing after it: known ahead, so that no voxel waits for a sum
    wholes crossings;  // of this axis, the next included
    wholes stride;     // what one crossing adds to the cell number
    wholes cell;       // this axis's share of the cell number; wraps by `mask`
    whole mask;
} axis;

// One axis of LANES rays that are at `origin` (voxels, in [0, N)) at the parameter `start`, with
// `direction` (voxels per unit of parameter).
INLINE axis axis_start(const wide *origin, const wide *direction, const wide *start, int shift,
                       int log2n)
{
    real step[LANES], first[LANES];
    whole cell[LANES], stride[LANES];
    for (int lane = 0; lane < LANES; ++lane) {
        const wide d = direction[lane], below = FLOOR(origin[lane]), inside = origin[lane] - below;
        const wide size = 1 / (d < 0 ? -d : d);
        // A ray that never crosses has a step of 0 from infinity, so that no product of zero and
        // infinity arises.
        step[lane] = d == 0 ? 0 : (real)size;
        wide there = (d > 0 ? 1 - inside : inside) * size;
#ifdef CLIPPED
        there += start[lane];
#endif
        first[lane] = d == 0 ? INFINITY : (real)(there);
        cell[lane] = (whole)below << shift;
        stride[lane] = (whole)(d > 0 ? 1 : -1) << shift;
    }
    axis a;
    a.step = LOAD(step);
    a.first = a.next = LOAD(first);
    a.following = a.step + a.first;
    a.crossings = 1;
    a.stride = LOAD(stride);
    a.cell = LOAD(cell);
    a.mask = (((whole)1 << log2n) - 1) << shift;
    return a;
}

// Moves the rays whose next crossing of this axis is reached at `there` into the next voxel.
INLINE void axis_cross(axis *a, reals there)
{
    const wholes crossed = a->next <= there;
    a->next = crossed ? a->following : a->next;
    a->cell += crossed ? a->stride : (wholes)0;
    a->crossings += crossed ? (wholes)1 : (wholes)0;
    a->following = TO_REALS(a->crossings) * a->step + a->first;
}

// LANES rays on their way through the cube.
typedef struct {
    axis x, y, z;
    reals here, end;   // ray parameter of the last crossing, and where the ray stops
    reals metres;      // to a unit of the ray's parameter
} march;

// The rays of a packet at their start: those from number `first` of the `count` that are followed.
// `reach` is how far the camera's ray goes, `end` how far the ray that is followed goes; the two
// differ on the outgoing way only. `time` is when each ray is taken, in seconds; `enter` and `leave`
// are where it enters and leaves a bounded cube.
INLINE march march_start(__constant frame *cube, int width, int height, int log2x, int log2y,
                         int log2z, __global const wide *reach, __global const wide *end,
                         __global const wide *time, __global const wide *enter,
                         __global const wide *leave, __global const real *stretch,
                         __global const int *picked, int count, int first)
{
    wide ox[LANES], oy[LANES], oz[LANES], dx[LANES], dy[LANES], dz[LANES], begin[LANES];
    real start[LANES], stop[LANES], metres[LANES];
    for (int lane = 0; lane < LANES; ++lane) {
        const int ray = RAY(SMALLER(first + lane, count - 1));
        const point d = follow_direction(cube, width, height, ray, reach[ray]);
        point o = cube->origin;
#ifdef MOTION
        o = along(o, time[ray], cube->drift);
#endif
#ifdef CLIPPED
        o = along(o, enter[ray], d);
#endif
#if defined(MOTION) || defined(CLIPPED)
        const wide nx = 1 << log2x, ny = 1 << log2y, nz = 1 << log2z;
        o.x -= nx * FLOOR(o.x / nx);
        o.y -= ny * FLOOR(o.y / ny);
        o.z -= nz * FLOOR(o.z / nz);
#endif
        ox[lane] = o.x;
        oy[lane] = o.y;
        oz[lane] = o.z;
        dx[lane] = d.x;
        dy[lane] = d.y;
        dz[lane] = d.z;
#ifdef CLIPPED
        begin[lane] = enter[ray];
        start[lane] = (real)begin[lane];
        stop[lane] = (real)leave[ray];
#else
        stop[lane] = (real)end[ray];
#endif
        metres[lane] = stretch[ray];
    }
    march m;
    m.x = axis_start(ox, dx, begin, 0, log2x);
    m.y = axis_start(oy, dy, begin, log2x, log2y);
    m.z = axis_start(oz, dz, begin, log2x + log2y, log2z);
#ifdef CLIPPED
    m.here = LOAD(start);
#else
    m.here = 0;
#endif
    m.end = LOAD(stop);
    m.metres = LOAD(metres);
    return m;
}

// The numbers of the voxels that the rays are in.
INLINE wholes march_voxel(const march *m)
{
    return (m->x.cell & m->x.mask) + (m->y.cell & m->y.mask) + (m->z.cell & m->z.mask);
}

// Where the rays leave the voxels that they are in.
INLINE reals march_exit(const march *m)
{
    const reals side = SMALLER(m->x.next, m->y.next), cap = SMALLER(m->z.next, m->end);
    return SMALLER(side, cap);
}

// Moves all rays on to `there`, into their next voxels.
INLINE void march_cross(march *m, reals there)
{
    axis_cross(&m->x, there);
    axis_cross(&m->y, there);
    axis_cross(&m->z, there);
    m->here = there;
}

// The number of voxels that a packet's rays crossed over positive length; the last packet's idle
// lanes do not count.
INLINE int march_count(wholes crossed, int first, int count)
{
    whole counts[LANES];
    STORE(crossed, counts);
    int sum = 0;
    for (int lane = 0; lane < LANES; ++lane) sum += first + lane < count ? (int)counts[lane] : 0;
    return sum;
}

// Records the rays that the cut-off ended: each keeps its path so far, and meets nothing.
INLINE void march_record_ends(const march *m, wholes ended, __global const int *picked, int count,
                              int first, __global real *path_length, __global int *surface)
{
    real length[LANES];
    whole over[LANES];
    STORE(m->end * m->metres, length);
    STORE(ended, over);
    for (int lane = 0; lane < LANES; ++lane) {
        const int ray = RAY(SMALLER(first + lane, count - 1));
        if (over[lane]) {
            path_length[ray] = length[lane];
            surface[ray] = 0;
        }
    }
}
