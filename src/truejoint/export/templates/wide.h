/* A function of which GCC makes two versions; a program with glibc loads the one that its processor
 * is fit for. AVX2 rounds as SSE2 does: the bits are the same. */
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__GLIBC__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif
