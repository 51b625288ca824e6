// Number types. Every work-item carries LANES neighbours (rays, or wave vectors) in vectors: a CPU
// has no other way to use its vector units, since PoCL does not vectorise divergent loops across
// work-items. On a GPU LANES is 1.
//
// Options: LANES is 1, 4 or 8; PRECISION is 32 or 64, the bits of `real`; WIDE is set where the
// device has float64.

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define VECTOR_OF_4(type) JOIN(type, 4)
#define VECTOR_OF_8(type) JOIN(type, 8)

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
#elif LANES == 4
#define VECTOR(type) JOIN(type, 4)
#define LOAD(p) vload4(0, p)
#define STORE(value, p) vstore4(value, 0, p)
#define ANY(condition) any_of_4(condition)
#define LANE_NUMBERS (int4)(0, 1, 2, 3)
#define GATHER(p, i) \
    (reals)((p)[(uint)(i).s0], (p)[(uint)(i).s1], (p)[(uint)(i).s2], (p)[(uint)(i).s3])
#elif LANES == 8
#define VECTOR(type) JOIN(type, 8)
#define LOAD(p) vload8(0, p)
#define STORE(value, p) vstore8(value, 0, p)
#define ANY(condition) any_of_8(condition)
#define LANE_NUMBERS (int8)(0, 1, 2, 3, 4, 5, 6, 7)
#define GATHER(p, i) \
    (reals)((p)[(uint)(i).s0], (p)[(uint)(i).s1], (p)[(uint)(i).s2], (p)[(uint)(i).s3], \
            (p)[(uint)(i).s4], (p)[(uint)(i).s5], (p)[(uint)(i).s6], (p)[(uint)(i).s7])
#endif

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

// For loops of few turns over values that are to stay in registers.
#define UNROLLED _Pragma("unroll")

// Whether a comparison holds in any lane. OpenCL's any() is a function call in PoCL, which sends
// every vector around it to memory and back.
#define JOINED_2(m) ((m).x | (m).y)
#define JOINED_4(m) JOINED_2((m).lo | (m).hi)
static inline int any_of_4(VECTOR_OF_4(WHOLE) m) { return JOINED_4(m) < 0; }
static inline int any_of_8(VECTOR_OF_8(WHOLE) m) { return JOINED_4((m).lo | (m).hi) < 0; }

// The smaller of two numbers. OpenCL's fmin honours NaN and makes loops three times slower.
#define SMALLER(a, b) ((a) < (b) ? (a) : (b))
