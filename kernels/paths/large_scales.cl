// Means of plane waves along rays, in closed form: eddies larger than the cube (Lane, Glindemann
// and Dainty 1992). Each wave is size cos(2 pi phase), its mean over the ray sinc(turns) times its
// value in the middle.
//
// Option: MOTION where rays are taken at times of their own in moving air.

// The sine of x turns, within 1e-7 in float32 by its series: the library's costs ten times as much.
INLINE reals sine_of_turns(reals x)
{
#if PRECISION == 64
    return sin(2 * M_PI * x);
#else
    const reals r = x - NEAREST(x), size = r < 0 ? -r : r;
    const reals folded = size > 0.25f ? 0.5f - size : size;   // sin(pi - a) = sin(a)
    const reals a = 6.28318531f * (r < 0 ? -folded : folded), square = a * a;
    return a * (1 + square * (-0.166666667f + square * (8.33333333e-3f + square * (-1.98412698e-4f +
           square * (2.75573192e-6f - 2.50521084e-8f * square)))));
#endif
}

// `waves` (count, 6) are the vector in cycles per metre (3), the phase in cycles where rays start,
// the size, and the cycles per second by which moving air goes back. `way` (3, ray) leads from start
// to end of each ray, in m.
__kernel void means(int items, __global const real *restrict waves, int count,
                    __global const real *restrict way, __global const real *restrict time,
                    __global real *restrict mean)
{
    const int first = get_global_id(0) * LANES, rays = items * LANES;
    const reals x = LOAD(way + first), y = LOAD(way + rays + first), z = LOAD(way + 2 * rays + first);
#ifdef MOTION
    const reals t = LOAD(time + first);
#endif
    reals sum = 0;
    for (int n = 0; n < count; ++n) {
        __global const real *wave = waves + 6 * n;
        const reals turns = wave[0] * x + wave[1] * y + wave[2] * z;
        reals phase = wave[3] + turns * (real)0.5;
#ifdef MOTION
        phase -= wave[5] * t;
#endif
        const reals angle = (real)M_PI * turns;
        const reals small = turns < 0 ? -turns : turns;
        const reals sinc = small < (real)1e-3 ? 1 - angle * angle / 6 : sine_of_turns(turns * (real)0.5) / angle;
        sum += wave[4] * sinc * sine_of_turns(phase + (real)0.25);
    }
    STORE(sum, mean + first);
}
