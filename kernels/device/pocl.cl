// What works around PoCL 3.0 of 2022 on processors, and its gathers. It follows lanes.cl, on PoCL
// alone; everything here may go once its version is passed, and is only slower if it stays.
//
// Option: GATHERS where the processor's own gathers were found to be faster than single loads.

// Until 7.0 PoCL does not inline its library: vload(), any(), rint(), floor(), min() and mul_hi()
// are calls, which send every vector around them to memory and back, and keep loops from becoming
// vectors. Nor does its compiler inline by itself what is called three times.
#undef INLINE
#define INLINE __attribute__((always_inline)) static inline
#if LANES > 1
#define OVERLOADED INLINE __attribute__((overloadable))
#define PACKED(type) JOIN(packed_, type)
#define MOVES_IN(space, type) \
    OVERLOADED VECTOR(type) load_packet(space const type *p) \
    { \
        return *(space const PACKED(type) *)p; \
    } \
    OVERLOADED void store_packet(VECTOR(type) value, space type *p) \
    { \
        *(space PACKED(type) *)p = value; \
    }
#define MOVES(type) \
    typedef type PACKED(type) __attribute__((ext_vector_type(LANES), aligned(sizeof(type)))); \
    MOVES_IN(__global, type) \
    MOVES_IN(__private, type)
MOVES(float)
MOVES(int)
MOVES(uint)
MOVES(long)
#ifdef WIDE
MOVES(double)
#endif
#undef LOAD
#define LOAD(p) load_packet(p)
#undef STORE
#define STORE(value, p) store_packet(value, p)
#endif
#define JOINED_2(m) ((m).x | (m).y)
#define JOINED_4(m) JOINED_2((m).lo | (m).hi)
#define JOINED_8(m) JOINED_4((m).lo | (m).hi)
#define JOINED_16(m) JOINED_8((m).lo | (m).hi)
#if LANES > 1
INLINE int any_of(wholes m) { return JOIN(JOINED_, LANES)(m) < 0; }
#undef ANY
#define ANY(condition) any_of(condition)
#endif
#undef FLOOR
#define FLOOR(x) __builtin_floor(x)
#if PRECISION == 32
// Adding and subtracting 1.5 2^23 rounds to the nearest whole number.
#undef NEAREST
#define NEAREST(x) (((x) + 12582912.0f) - 12582912.0f)
#endif
#if LANES == 8
INLINE uint8 product_of_8(uint a, uint8 b, uint8 *high)
{
    const uint8 one = as_uint8(as_ulong4((uint8)(b.s0, 0, b.s1, 0, b.s2, 0, b.s3, 0)) * (ulong)a);
    const uint8 two = as_uint8(as_ulong4((uint8)(b.s4, 0, b.s5, 0, b.s6, 0, b.s7, 0)) * (ulong)a);
    *high = (uint8)(one.odd, two.odd);
    return (uint8)(one.even, two.even);
}
#undef PRODUCT
#define PRODUCT(a, b, high) product_of_8(a, b, high)
#endif

// PoCL 3.0 and 3.1 may pass a vector of 512 bits otherwise than their library takes it: nothing of
// 16 lanes may be passed to it. No version that ends it is known.
#if LANES == 16
#undef EXP
#define EXP(x) __builtin_shufflevector(exp((x).lo), exp((x).hi), NUMBERS_16)
#undef TO_REALS
#define TO_REALS(x) __builtin_convertvector(x, reals)
#undef TO_WHOLES
#define TO_WHOLES(x) __builtin_convertvector(x, wholes)
#endif

// The compiler makes no gather of single loads; its own builtins are named after the processor's
// instructions.
#if defined(GATHERS) && PRECISION == 32 && LANES == 16 && defined(__AVX512F__)
#undef GATHER
#define GATHER(p, i) __builtin_ia32_gathersiv16sf((float16)0, p, as_int16(i), (short)-1, 4)
#elif defined(GATHERS) && PRECISION == 32 && LANES == 8 && defined(__AVX2__)
#undef GATHER
#define GATHER(p, i) \
    __builtin_ia32_gatherd_ps256((float8)0, p, as_int8(i), as_float8((int8)-1), 4)
#endif
