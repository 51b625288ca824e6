// Random humidity and temperature on a periodic cube of n^3 voxels, x fastest. Numbers are
// counter-based: Philox 4x32-10 (Salmon et al. 2011) keyed by the seed and counted by the wave
// vector, so the field depends on nothing else.
//
// Option: TWO_FIELDS where two fields (humidity and temperature) are made at once.

typedef VECTOR(uint) uints;
typedef VECTOR(int) ints;
typedef VECTOR(float) floats;
#define TO_FLOATS(x) VECTOR(convert_float)(x)

// Philox 4x32-10: replaces the four words of each lane's counter by four random words.
static void philox(uints *c0, uints *c1, uints *c2, uints *c3, uint2 key)
{
    for (int round = 0; round < 10; ++round) {
        uints high0, high1;
        const uints low0 = PRODUCT(0xD2511F53u, *c0, &high0),
                    low1 = PRODUCT(0xCD9E8D57u, *c2, &high1);
        *c0 = high1 ^ *c1 ^ key.x;
        *c2 = high0 ^ *c3 ^ key.y;
        *c1 = low1;
        *c3 = low0;
        key += (uint2)(0x9E3779B9u, 0xBB67AE85u);
    }
}

// Box and Muller (1958): two independent normals of unit variance from two words.
static void normals(uints a, uints b, floats *one, floats *other)
{
    // The angle is half a turn and a sign: over a whole turn, the rounding of pi itself would leave
    // a mean of 3e-8, which adds up at one voxel.
    const floats radius = sqrt(-2.0f * log((TO_FLOATS(a) + 0.5f) * 0x1p-32f)) *
                          ((b >> 31) != 0 ? (floats)-1.0f : (floats)1.0f);
    floats cosine;
    const floats sine =
        sincos(3.14159265f * (TO_FLOATS(b & 0x7FFFFFFFu) * 0x1p-31f), &cosine);
    *one = radius * cosine;
    *other = radius * sine;
}

// White noise times sqrt(Psi dxi^3): the spectra H1, H2 of two independent real fields, with
// H(-k) = conj(H(k)). Each part has variance 1/2, or 1 where k is its own mirror image. For one
// field the half x = 0 ... n/2 of H1 is written, for a real transform. For two, all of
// a = H1 + i H2 is written, whose inverse transform holds one field in its real part and one in its
// imaginary part; the parts of a itself have unit variance. `amplitude` is a table over the squared
// wave number, which is a whole number on a cubic grid. Work-items past a row's end do nothing.
__kernel void spectrum(__global float2 *restrict out, __global const float *restrict amplitude,
                       int n, uint2 seed, uint stream)
{
    const int row = get_global_id(0) * LANES, ky = get_global_id(1), kz = get_global_id(2);
    if (row > n / 2) return;
    const int mirror_y = (n - ky) & (n - 1), mirror_z = (n - kz) & (n - 1);
    const int y = SMALLER(ky, mirror_y), z = SMALLER(kz, mirror_z);
    const ints kx = row + LANE_NUMBERS;

    // In the planes x = 0 and n/2 the mirror image lies in the plane itself: the earlier of the two
    // draws for both.
    const ints in_plane = (kx == 0) | (kx == n / 2);
    const int image_first = mirror_z < kz || (mirror_z == kz && mirror_y < ky),
              own_image = mirror_z == kz && mirror_y == ky;
    const ints conjugate = image_first ? in_plane : (ints)0,
               real_only = own_image ? in_plane : (ints)0;
    uints c0 = VECTOR(convert_uint)(kx), c1 = conjugate ? (uints)mirror_y : (uints)ky;
    uints c2 = conjugate ? (uints)mirror_z : (uints)kz, c3 = stream;
    philox(&c0, &c1, &c2, &c3, seed);

    const floats part = real_only ? (floats)1.0f : (floats)0.70710678f,
                 sign = conjugate ? (floats)-1.0f : (floats)1.0f;
    const floats sine = real_only ? (floats)0.0f : part * sign;
    floats re1, im1, re2 = 0, im2 = 0;
    normals(c0, c1, &re1, &im1);
#ifdef TWO_FIELDS
    normals(c2, c3, &re2, &im2);
#endif
    float h1_re[LANES], h1_im[LANES], h2_re[LANES], h2_im[LANES];
    STORE(part * re1, h1_re);
    STORE(sine * im1, h1_im);
    STORE(part * re2, h2_re);
    STORE(sine * im2, h2_im);
    for (int lane = 0; lane < LANES && row + lane <= n / 2; ++lane) {
        const int x = row + lane;
        const float a = amplitude[x * x + y * y + z * z];
#ifdef TWO_FIELDS
        out[((size_t)kz * n + ky) * n + x] =
            a * (float2)(h1_re[lane] - h2_im[lane], h1_im[lane] + h2_re[lane]);
        if (0 < x && x < n / 2)
            out[((size_t)mirror_z * n + mirror_y) * n + n - x] =
                a * (float2)(h1_re[lane] + h2_im[lane], h2_re[lane] - h1_im[lane]);
#else
        out[((size_t)kz * n + ky) * (n / 2 + 1) + x] = a * (float2)(h1_re[lane], h1_im[lane]);
#endif
    }
}

// Sum, sum of squares, smallest and largest of each stretch of `run` voxels.
__kernel void statistics(__global const float *restrict field, int run,
                         __global float4 *restrict out)
{
    const size_t first = (size_t)get_global_id(0) * run;
    float sum[LANES], square[LANES], low[LANES], high[LANES];
    floats s = 0, q = 0, l = INFINITY, h = -INFINITY;
    for (int i = 0; i < run; i += LANES) {
        const floats v = LOAD(field + first + i);
        s += v;
        q += v * v;
        l = v < l ? v : l;
        h = v > h ? v : h;
    }
    STORE(s, sum);
    STORE(q, square);
    STORE(l, low);
    STORE(h, high);
    float4 total = (float4)(0, 0, INFINITY, -INFINITY);
    for (int lane = 0; lane < LANES; ++lane) {
        total.x += sum[lane];
        total.y += square[lane];
        total.z = low[lane] < total.z ? low[lane] : total.z;
        total.w = high[lane] > total.w ? high[lane] : total.w;
    }
    out[get_global_id(0)] = total;
}

// Turns a Gaussian of zero mean into relative humidity fluctuations, in place: scale * g, clipped
// at dry air, or, where `shift` is positive, exp(scale * g - shift) - 1, whose mean is 0 too.
__kernel void humidity(__global float *restrict field, float scale, float shift)
{
    __global float *at = field + (size_t)get_global_id(0) * LANES;
    const floats g = scale * LOAD(at);
    STORE(shift > 0 ? expm1(g - shift) : g < -1.0f ? (floats)-1.0f : g, at);
}

#ifdef TWO_FIELDS
// Takes a complex cube apart into its real and its imaginary part.
__kernel void parts(__global const float2 *restrict both, __global float *restrict one,
                    __global float *restrict other)
{
    const size_t i = get_global_id(0);
    one[i] = both[i].x;
    other[i] = both[i].y;
}

// field = along * other + across * field.
__kernel void combine(__global float *restrict field, __global const float *restrict other,
                      float along, float across)
{
    const size_t i = (size_t)get_global_id(0) * LANES;
    STORE(along * LOAD(other + i) + across * LOAD(field + i), field + i);
}
#endif
