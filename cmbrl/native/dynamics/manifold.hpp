// Integration on the configuration manifold, and how tangents pass through it.
#pragma once
#include "base/algebra.hpp"
#include "scene/model.hpp"

namespace cmbrl::CMBRL_ISA {

static inline void quat_mul(const T* a, const T* b, T* r) {
  r[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
  r[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
  r[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
  r[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
}

// q <- q (+) d, d in the tangent space (rotations in body axes).
static inline void integrate(const Model& m, T* q, const T* d) {
  for (int j = 0; j < m.njoint; ++j) {
    T* x = q + m.jnt_qadr[j];
    const T* t = d + m.jnt_vadr[j];
    if (m.jnt_type[j] != kBall) { x[0] += t[0]; continue; }
    T angle2 = t[0] * t[0] + t[1] * t[1] + t[2] * t[2], angle = vsqrt(angle2), s, c;
    sincos(0.5 * angle, s, c);
    T k = select(angle > 1e-8, s / vmax(angle, splat(1e-30)), splat(0.5));
    T e[4] = {c, k * t[0], k * t[1], k * t[2]}, r[4];
    quat_mul(x, e, r);
    T n = 1.0 / vsqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2] + r[3] * r[3]);
    CMBRL_FOR(i, 4) x[i] = n * r[i];
  }
}

// Of q' = q (+) d at a ball joint: dq' = A dq + B dd, A = exp(-[t]x), B = right Jacobian of SO(3) (Sola et al., arXiv 1812.01537).
static inline void ball_jacobians(const T* t, T A[9], T B[9]) {
  T a2 = t[0] * t[0] + t[1] * t[1] + t[2] * t[2], a = vsqrt(a2), s, c;
  sincos(a, s, c);
  Mask small = a < 1e-4;
  T safe = select(small, splat(1), a), safe2 = safe * safe;
  T k1 = select(small, 1.0 - a2 / 6.0, s / safe);
  T k2 = select(small, 0.5 - a2 / 24.0, (1.0 - c) / safe2);
  T k3 = select(small, 1.0 / 6 - a2 / 120.0, (safe - s) / (safe2 * safe));
  T K[9] = {T{}, -t[2], t[1], t[2], T{}, -t[0], -t[1], t[0], T{}};
  CMBRL_FOR(i, 3) CMBRL_FOR(j, 3) {
    T KK = t[i] * t[j] - (i == j ? a2 : T{}), one = splat(i == j);
    A[3 * i + j] = one - k1 * K[3 * i + j] + k2 * KK;
    B[3 * i + j] = one - k2 * K[3 * i + j] + k3 * KK;
  }
}

// Tangents of q' = q (+) d: rows of dq' from dq and dd, for ncol columns (in place in dq)
static void push_tangent(const Model& m, const T* d, T* dq, const T* dd, T scale, int ncol) {
  for (int j = 0; j < m.njoint; ++j) {
    int i = m.jnt_vadr[j];
    if (m.jnt_type[j] != kBall) {
      for (int c = 0; c < ncol; ++c) dq[i * ncol + c] += scale * dd[i * ncol + c];
      continue;
    }
    T A[9], B[9];
    ball_jacobians(d + i, A, B);
    for (int c = 0; c < ncol; ++c) {
      T x[3], y[3];
      CMBRL_FOR(r, 3) { x[r] = dq[(i + r) * ncol + c]; y[r] = scale * dd[(i + r) * ncol + c]; }
      CMBRL_FOR(r, 3) {
        T s = T{};
        CMBRL_FOR(k, 3) s += A[3 * r + k] * x[k] + B[3 * r + k] * y[k];
        dq[(i + r) * ncol + c] = s;
      }
    }
  }
}
// The transpose: cotangent lq of q' becomes that of q; that of d (times scale) is added to ld.
static void pull_cotangent(const Model& m, const T* d, T* lq, T* ld, T scale) {
  for (int j = 0; j < m.njoint; ++j) {
    int i = m.jnt_vadr[j];
    if (m.jnt_type[j] != kBall) { ld[i] += scale * lq[i]; continue; }
    T A[9], B[9], x[3];
    ball_jacobians(d + i, A, B);
    CMBRL_FOR(r, 3) x[r] = lq[i + r];
    CMBRL_FOR(r, 3) {
      T a = T{}, b = T{};
      CMBRL_FOR(k, 3) { a += A[3 * k + r] * x[k]; b += B[3 * k + r] * x[k]; }
      lq[i + r] = a;
      ld[i + r] += scale * b;
    }
  }
}

}  // namespace cmbrl::CMBRL_ISA
