// Rotation vectors: of quaternions and matrices, and how they change.
#pragma once
#include <cmath>

#include "base/algebra.hpp"

namespace cmbrl::CMBRL_ISA {

// The inverse right Jacobian of SO(3) at the rotation vector t, less the unit matrix: how t changes with a turn in its body's axes.
static inline void rotation_slopes(const T* t, T rest[9]) {
  T a2 = t[0] * t[0] + t[1] * t[1] + t[2] * t[2], a = vsqrt(a2), sine, cosine;
  sincos(0.5 * a, sine, cosine);
  Mask small = a < 1e-3;
  T safe = select(small, splat(1), a);
  T second = select(small, 1.0 / 12 + a2 / 720.0, 1.0 / (safe * safe) - cosine / (2.0 * safe * select(small, splat(1), sine)));
  T K[9] = {T{}, -t[2], t[1], t[2], T{}, -t[0], -t[1], t[0], T{}};
  CMBRL_FOR(r, 3) CMBRL_FOR(c, 3) rest[3 * r + c] = 0.5 * K[3 * r + c] + second * (t[r] * t[c] - (r == c ? a2 : T{}));
}

// The rotation vector of a unit quaternion, of the turn that is the shorter.
static inline void rotation_vector(const T* r, T* out) {
  T sine = vsqrt(r[1] * r[1] + r[2] * r[2] + r[3] * r[3]), scale;
  for (int i = 0; i < W; ++i) {
    double angle = 2 * __builtin_atan2(sine[i], r[0][i]);
    if (angle > 3.14159265358979323846) angle -= 6.28318530717958647692;
    scale[i] = sine[i] > 1e-12 ? angle / sine[i] : r[0][i] < 0 ? -2 : 2;
  }
  CMBRL_FOR(k, 3) out[k] = scale * r[1 + k];
}

// A unit quaternion of a rotation matrix, from its largest component on.
static inline void matrix_quaternion(const T* m, T* q) {
  for (int i = 0; i < W; ++i) {
    auto e = [&](int r, int c) { return m[3 * r + c][i]; };
    double square[4] = {1 + e(0, 0) + e(1, 1) + e(2, 2), 1 + e(0, 0) - e(1, 1) - e(2, 2), 1 - e(0, 0) + e(1, 1) - e(2, 2),
                        1 - e(0, 0) - e(1, 1) + e(2, 2)};
    double twice[4][4] = {{0, e(2, 1) - e(1, 2), e(0, 2) - e(2, 0), e(1, 0) - e(0, 1)}, {0, 0, e(1, 0) + e(0, 1), e(0, 2) + e(2, 0)},
                          {0, 0, 0, e(2, 1) + e(1, 2)}};
    int best = 0;
    for (int k = 1; k < 4; ++k) if (square[k] > square[best]) best = k;
    double size = std::sqrt(square[best]);
    for (int k = 0; k < 4; ++k) q[k][i] = 0.5 * (k == best ? size : twice[k < best ? k : best][k < best ? best : k] / size);
  }
}

}  // namespace cmbrl::CMBRL_ISA
