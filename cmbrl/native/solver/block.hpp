// The block of one contact in Newton's matrix, Theta, which takes what its rows move to what they push; of as many tangential
// rows as it has: 2 of sliding, 3 with torsional friction, 5 with rolling friction too (turning.hpp).
#pragma once
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

template <int N> struct Count { static constexpr int value = N; };

// f(how many tangential rows c has), a number that is known to the compiler; nothing where there are none.
template <class G, class F>
static inline void with_tangents(const Contact<G>& c, F f) {
  if (c.rows == 1 + G::NT) return f(Count<G::NT>{});
  if constexpr (G::MT > G::NT) if (c.rows == 2 + G::NT) return f(Count<G::NT + 1>{});
  if constexpr (G::MT > G::NT + 1) if (c.rows == 1 + G::MT) return f(Count<G::MT>{});
}

template <class G>
static inline void linearise_normal(Contact<G>& c, T pn, T yn) {
  c.ipn = 1.0 / pn;
  c.Th[0][0] = keep(c.on, c.gam * c.ipn);
  c.w[0] = keep(c.on, yn * c.ipn);
}

// Ai = A^-1 of A = a 1 - b g^T, with a = eta0 + R b0 and g = (eta + R b) / b0.
template <int K, class G>
static inline void invert_block(Contact<G>& c, const T (*A)[K], T R, T b0, T ib0) {
  auto& Ai = c.Ai;
  if constexpr (K == 1) {
    Ai[0][0] = 1.0 / A[0][0];
  } else if constexpr (K == 2) {
    T idet = 1.0 / (A[0][0] * A[1][1] - A[0][1] * A[1][0]);
    Ai[0][0] = A[1][1] * idet; Ai[1][1] = A[0][0] * idet;
    Ai[0][1] = -A[0][1] * idet; Ai[1][0] = -A[1][0] * idet;
  } else {  // Sherman and Morrison: along b it is a - g b
    T a = c.eta0 + R * b0, ia = 1.0 / a, along = a, g[K];
    CMBRL_FOR(i, K) { g[i] = (c.eta[i] + R * c.b[i]) * ib0; along -= g[i] * c.b[i]; }
    T share = ia / along;
    CMBRL_FOR(i, K) CMBRL_FOR(j, K) Ai[i][j] = share * c.b[i] * g[j] + (i == j ? ia : T{});
  }
}

// pn dgam = yn - gamma dc_n without friction; t5: targets of the tangential products; soft: the yield of the rows.
template <int K, class G>
static inline void linearise_friction(Contact<G>& c, T pn, T yn, const T* t5, T rho, T soft, bool convex) {
  Mask on = c.on & c.rub;
  T mu = c.mu, b0 = mu * c.gam, ib0 = 1.0 / b0;
  T y[K], A[K][K], B[K][K], *a = c.ta;
  T q0 = c.t50 - b0 * c.eta0;
  CMBRL_FOR(i, K) q0 += c.b[i] * (rho * c.r2[i] - c.eta[i]);
  CMBRL_FOR(i, K) {
    y[i] = t5[i] - b0 * c.eta[i] - c.eta0 * c.b[i] + b0 * rho * c.r2[i] - c.b[i] * ib0 * q0;
    a[i] = mu * (c.eta[i] - c.b[i] * c.eta0 * ib0);
    CMBRL_FOR(j, K) {
      B[i][j] = (i == j ? b0 : T{}) - c.b[i] * c.b[j] * ib0;
      A[i][j] = (i == j ? c.eta0 : T{}) - c.b[i] * c.eta[j] * ib0 + (c.Rt + soft) * B[i][j];
    }
  }
  invert_block<K>(c, A, c.Rt + soft, b0, ib0);
  auto& Ai = c.Ai;
  if (convex) {  // b0 deta0 = q0 - ... in gamma ds
    CMBRL_FOR(i, K) {
      c.gA[i] = T{};
      CMBRL_FOR(j, K) c.gA[i] += keep(c.convex, c.eta[j] + (c.Rt + soft) * c.b[j]) * Ai[j][i];
      pn -= c.gA[i] * a[i];
      yn -= c.gA[i] * y[i];
    }
    pn += keep(c.convex, mu * c.eta0);
    yn += keep(c.convex, q0);
  }
  linearise_normal(c, pn, yn);
  CMBRL_FOR(j, K) {
    c.Th[0][1 + j] = T{};
    if (!convex) continue;
    T x = c.b[j];
    CMBRL_FOR(k, K) x -= c.gA[k] * B[k][j];
    c.Th[0][1 + j] = keep(on & c.convex, x * c.ipn);
  }
  CMBRL_FOR(i, K) {
    T wn = T{}, tn = T{};
    CMBRL_FOR(j, K) {
      wn += Ai[i][j] * (y[j] - a[j] * c.w[0]);
      tn -= Ai[i][j] * a[j];
    }
    CMBRL_FOR(j, K) {
      T x = T{};
      CMBRL_FOR(k, K) x += Ai[i][k] * B[k][j];
      if (convex) x += tn * c.Th[0][1 + j];
      c.Th[1 + i][1 + j] = keep(on, x);
    }
    c.w[1 + i] = keep(on, wn);
    c.Th[1 + i][0] = keep(on, tn * c.Th[0][0]);
  }
}

}  // namespace cmbrl::CMBRL_ISA
