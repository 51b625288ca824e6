// The pinhole camera, and where rays start. Row 0 is the top of the image, column 0 its left as the
// camera sees it.
//
// Options: MOTION where pixels are taken at times of their own in moving air; OUTGOING for the way
// from a transmitter to what the camera's rays met.

// The number of a ray that is followed. Where only some rays of the raster are followed, `picked`
// lists them; else it is NULL.
#define RAY(slot) (picked ? picked[slot] : (slot))

typedef struct {
    wide x, y, z;
} point;

// A frame: the origin, the direction of the image centre, and what one column to the right and one
// row up add to that direction. In the cube's frame, `drift` is how far the origin moves in a
// second, in voxels. On the outgoing way `origin` is the transmitter, and `offset` leads from there
// to the camera.
typedef struct {
    point origin, forward, right, up, drift, offset;
} frame;

static inline point along(point start, wide reach, point direction)
{
    const point p = {start.x + reach * direction.x, start.y + reach * direction.y,
                     start.z + reach * direction.z};
    return p;
}

// The direction of a camera's ray. Its component along the line of sight is 1, so that `reach` is
// depth into the scene.
static inline point ray_direction(__constant frame *f, int width, int height, int ray)
{
    const wide u = ray % width + (wide)0.5 - (wide)0.5 * width;
    const wide v = (wide)0.5 * height - ray / width - (wide)0.5;
    return along(along(f->forward, u, f->right), v, f->up);
}

// The direction of the ray that is followed: the camera's own, or on the outgoing way the direction
// from the transmitter to the point at `reach` on the camera's ray.
static inline point follow_direction(__constant frame *f, int width, int height, int ray,
                                     wide reach)
{
    const point d = ray_direction(f, width, height, ray);
#ifdef OUTGOING
    return along(f->offset, reach, d);
#else
    return d;
#endif
}
