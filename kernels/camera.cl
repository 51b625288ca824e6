// The pinhole camera. Row 0 is the top of the image, column 0 its left as the camera sees it.

typedef struct {
    wide x, y, z;
} point;

// A frame: origin, then the direction of the image centre, then what one column to the right and one row up add to it.
typedef struct {
    point origin, forward, right, up;
} frame;

static point ray_direction(__constant frame *f, int width, int height, int ray)
{
    const wide u = ray % width + (wide)0.5 - (wide)0.5 * width;
    const wide v = (wide)0.5 * height - ray / width - (wide)0.5;
    point d;
    d.x = f->forward.x + u * f->right.x + v * f->up.x;
    d.y = f->forward.y + u * f->right.y + v * f->up.y;
    d.z = f->forward.z + u * f->right.z + v * f->up.z;
    return d;
}
