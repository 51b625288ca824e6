// Number types. Every work-item carries LANES neighbours (rays, or wave vectors) in vectors: a CPU
// has no other way to use its vector units, since PoCL does not vectorise divergent loops across
// work-items. On a GPU LANES is 1.
//
// Options: LANES is 1, 4, 8 or 16; PRECISION is 32 or 64, the bits of `real`; WIDE is set where the
// device has float64.

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)

// VECTOR names the type of LANES numbers. LOAD and STORE move one packet of them, ANY says whether
// a comparison holds in any lane, and GATHER reads p at each lane's own index. GATHER takes the
// indices as unsigned, since none is below 0: to widen signed ones to 64 bits would cost an eighth
// of a trace.
#if LANES == 1
#define VECTOR(type) type
#define LOAD(p) (*(p))
#define STORE(value, p) (*(p) = (value))
#define ANY(condition) (condition)
#define LANE_NUMBERS 0
#define GATHER(p, i) ((p)[i])
#else
#define VECTOR(type) JOIN(type, LANES)
#define LOAD(p) JOIN(vload, LANES)(0, p)
#define STORE(value, p) JOIN(vstore, LANES)(value, 0, p)
#define ANY(condition) any(condition)
#define LANE_NUMBERS (VECTOR(int))(JOIN(NUMBERS_, LANES))
#define GATHER(p, i) ((reals)(JOIN(READ_, LANES)(p, i)))
#endif
#define NUMBERS_4 0, 1, 2, 3
#define NUMBERS_8 NUMBERS_4, 4, 5, 6, 7
#define NUMBERS_16 NUMBERS_8, 8, 9, 10, 11, 12, 13, 14, 15
#define READ_4(p, i) (p)[(uint)(i).s0], (p)[(uint)(i).s1], (p)[(uint)(i).s2], (p)[(uint)(i).s3]
#define READ_8(p, i) READ_4(p, (i).lo), READ_4(p, (i).hi)
#define READ_16(p, i) READ_8(p, (i).lo), READ_8(p, (i).hi)

#if PRECISION == 64
typedef double real;
typedef long whole;   // as wide as `real`, so that a comparison of reals selects between wholes
#define REAL double
#define WHOLE long
#else
typedef float real;
typedef int whole;
#define REAL float
#define WHOLE int
#endif
typedef VECTOR(REAL) reals;
typedef VECTOR(WHOLE) wholes;
#define TO_REALS(x) VECTOR(JOIN(convert_, REAL))(x)
#define TO_WHOLES(x) VECTOR(JOIN(convert_, WHOLE))(x)

// Rays start in float64 where the device has it: a hit or a miss must not depend on rounding.
#ifdef WIDE
typedef double wide;
#else
typedef float wide;
#endif

// For functions that are part of a loop over packets.
#define INLINE static inline

// For loops of few turns over values that are to stay in registers.
#define UNROLLED _Pragma("unroll")

// The smaller of two numbers. OpenCL's fmin honours NaN and makes loops three times slower.
#define SMALLER(a, b) ((a) < (b) ? (a) : (b))

// What has other forms in pocl.cl: the largest whole number that is not above a number of type
// `wide`, the whole number nearest to a small one, exponentials, and the product of a number of 32
// bits and a packet of them: its low words, and in `high` its high ones.
#define FLOOR(x) floor(x)
#define NEAREST(x) rint(x)
#define EXP(x) exp(x)
#define PRODUCT(a, b, high) (*(high) = mul_hi((VECTOR(uint))(a), b), (a) * (b))
