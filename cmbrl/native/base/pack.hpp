// A pack: W doubles that run through the same arithmetic in lock-step, one environment (or parameter candidate) a lane.
// GCC/Clang vector extensions, so the same source serves SSE2, AVX2 and AVX-512; the width follows the target,
// unless CMBRL_WIDTH sets it.
#pragma once
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>

namespace cmbrl::CMBRL_ISA {

#if defined(CMBRL_WIDTH)
constexpr int W = CMBRL_WIDTH;
#elif defined(__AVX512F__)
constexpr int W = 8;
#else
constexpr int W = 4;
#endif

typedef double T __attribute__((vector_size(W * 8)));
typedef int64_t Mask __attribute__((vector_size(W * 8)));

static inline T splat(double x) { return T{} + x; }
static inline T select(Mask m, T a, T b) { return m ? a : b; }
static inline T keep(Mask m, T a) { return (T)((Mask)a & m); }  // a where m, else +0
static inline T vmin(T a, T b) { return a < b ? a : b; }
static inline T vmax(T a, T b) { return a > b ? a : b; }
static inline T vabs(T a) { return (T)((Mask)a & (Mask{} + INT64_MAX)); }
static inline Mask none() { return Mask{}; }
static inline Mask all() { return ~Mask{}; }
static inline bool any(Mask m) {
  int64_t r = 0;
  for (int i = 0; i < W; ++i) r |= m[i];
  return r != 0;
}
static inline int count_of(Mask lanes) {
  int n = 0;
  for (int lane = 0; lane < W; ++lane) n += lanes[lane] != 0;
  return n;
}
static inline int first_of(Mask lanes) {
  for (int lane = 0; lane < W; ++lane)
    if (lanes[lane]) return lane;
  return -1;
}
static inline Mask up_to(int last) {  // lanes 0 to last; all, if there is no last
  Mask lanes = all();
  for (int lane = last + 1; last >= 0 && lane < W; ++lane) lanes[lane] = 0;
  return lanes;
}
static inline void copy_lane(Mask from_good, int good, int n, T* x) {  // lane `good` into those lanes
  for (int i = 0; i < n; ++i) x[i] = select(from_good, splat(x[i][good]), x[i]);
}
static inline T vsqrt(T a) {
  T r;
  for (int i = 0; i < W; ++i) r[i] = __builtin_sqrt(a[i]);
  return r;
}
template <class F>
static inline T each(T a, F f) {
  T r;
  for (int i = 0; i < W; ++i) r[i] = f(a[i]);
  return r;
}

// sin and cos by three-part reduction modulo pi/2 and Taylor polynomials on [-pi/4, pi/4]; error below 2 ulp for |x| < 1e5.
static inline void sincos(T x, T& s, T& c) {
  const double magic = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds to an integer kept in the low mantissa bits
  T shifted = x * 0.63661977236758134308 + magic;
  Mask k = (Mask)shifted;
  T n = shifted - magic;
  T r = x - n * 1.57079632673412561417e+00;
  r = r - n * 6.07710050630396597660e-11;
  r = r - n * 2.02226624879595063154e-21;
  T z = r * r;
  T sp = r + r * z * (-1.0 / 6 + z * (1.0 / 120 + z * (-1.0 / 5040 + z * (1.0 / 362880 + z * (-1.0 / 39916800 +
         z * (1.0 / 6227020800.0 - z * (1.0 / 1307674368000.0)))))));
  T cp = 1.0 - 0.5 * z + z * z * (1.0 / 24 + z * (-1.0 / 720 + z * (1.0 / 40320 + z * (-1.0 / 3628800 +
         z * (1.0 / 479001600.0 + z * (-1.0 / 87178291200.0 + z * (1.0 / 20922789888000.0)))))));
  Mask swap = (k & 1) != 0;
  T ss = select(swap, cp, sp), cc = select(swap, sp, cp);
  s = select((k & 2) != 0, -ss, ss);
  c = select(((k + 1) & 2) != 0, -cc, cc);
}

// W packs as a matrix, transposed in place: afterwards x[lane] holds what lane `lane` of the packs held, one after the other.
template <int S, int... L>
static inline void transpose_pairs(T* x) {
  for (int i = 0; i < W; ++i) {
    if (i & S) continue;
    T low = x[i], high = x[i + S];
#if defined(__has_builtin) && __has_builtin(__builtin_shufflevector)
    x[i] = __builtin_shufflevector(low, high, (L & S ? W + L - S : L)...);
    x[i + S] = __builtin_shufflevector(low, high, (L & S ? W + L : L + S)...);
#else
    ((x[i][L] = L & S ? high[L & S ? L - S : 0] : low[L], x[i + S][L] = L & S ? high[L] : low[L & S ? 0 : L + S]), ...);
#endif
  }
}
template <int... L>
static inline void transpose(T* x) {
  if constexpr (sizeof...(L) < W) {
    transpose<L..., int(sizeof...(L))>(x);
  } else {
    transpose_pairs<1, L...>(x);
    if constexpr (W > 2) transpose_pairs<2, L...>(x);
    if constexpr (W > 4) transpose_pairs<4, L...>(x);
  }
}

struct Lanes { int64_t at[W]; int n; };  // the last pack of a batch repeats its last element
static inline Lanes lanes_from(int64_t begin, int64_t end, const int64_t* elements = nullptr) {
  Lanes l;
  l.n = int(end - begin < W ? end - begin : W);
  for (int i = 0; i < W; ++i) {
    int64_t k = begin + (i < l.n ? i : l.n - 1);
    l.at[i] = elements ? elements[k] : k;
  }
  return l;
}

}  // namespace cmbrl::CMBRL_ISA
