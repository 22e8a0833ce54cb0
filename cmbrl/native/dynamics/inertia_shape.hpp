// Shapes of inertias, as parameters that no value makes unphysical: the second moments of a body's mass about its centre are
//   mu B U U^T B^T,  U = [sqrt(d_x) t_xy t_xz; 0 sqrt(d_y) t_yz; 0 0 sqrt(d_z)],
// with B B^T those of the file, mu the scale of mass, d the scales along the axes and t the tilts. With mass and centre that is
// the log-Cholesky factor of the pseudo-inertia (Rucker & Wensing, RA-L 2022) by the file's, so it stays positive definite, which
// is the triangle inequality too. A planar body has one moment: mu d I.
// P holds mu I; what the shape adds is mu (tr(E) 1 - E), E = B (U U^T - 1) B^T, exactly zero at the file's values.
#pragma once
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G> constexpr int kShape = G::D == 2 ? 1 : 6;  // parameters: d; or d_x, d_y, d_z, t_xy, t_xz, t_yz

// The values of a body's shape parameters; those that are not offered keep the file's.
template <class G>
static inline void shape_of(const Model& m, const Work<G>& w, int s, T* x) {
  CMBRL_FOR(j, kShape<G>) {
    int k = m.shape_par[s * kShape<G> + j];
    x[j] = k < 0 ? splat(j < G::D ? 1 : 0) : m.par_nominal[k] + w.dtheta[k];
  }
}

// tr(E) 1 - E, in the order of an inertia, for E = B X B^T.
static inline void unfold(const Planar&, const double* root, const T* X, T* dI) { dI[0] = root[0] * X[0]; }
static inline void unfold(const Spatial&, const double* root, const T* X, T* dI) {
  auto at = [&](int i, int j) { return X[i == j ? i : 2 + i + j]; };
  T E[3][3];
  CMBRL_FOR(r, 3) CMBRL_FOR(c, 3) {
    E[r][c] = T{};
    CMBRL_FOR(i, 3) CMBRL_FOR(j, 3) E[r][c] += root[3 * r + i] * root[3 * c + j] * at(i, j);
  }
  dI[0] = E[1][1] + E[2][2]; dI[1] = E[0][0] + E[2][2]; dI[2] = E[0][0] + E[1][1];
  dI[3] = -E[0][1]; dI[4] = -E[0][2]; dI[5] = -E[1][2];
}

// What the shape adds to the inertia of a body of the file's mass.
template <class G>
static inline void shape_inertia(const Model& m, const Work<G>& w, int s, T* dI) {
  T x[kShape<G>], X[G::SYM];
  shape_of(m, w, s, x);
  X[0] = x[0] - 1.0;
  if constexpr (G::D == 3) {
    T y = vsqrt(vmax(x[1], T{})), z = vsqrt(vmax(x[2], T{}));
    X[0] += x[3] * x[3] + x[4] * x[4];
    X[1] = x[1] - 1.0 + x[5] * x[5];
    X[2] = x[2] - 1.0;
    X[3] = x[3] * y + x[4] * x[5]; X[4] = x[4] * z; X[5] = x[5] * z;
  }
  unfold(G{}, m.shape_root + s * G::D * G::D, X, dI);
}

// Its derivative by shape parameter j.
template <class G>
static inline void shape_derivative(const Model& m, const Work<G>& w, int s, int j, T* dI) {
  T X[G::SYM] = {};
  X[j % G::D] = splat(1);
  if constexpr (G::D == 3) {
    T x[6], one = splat(1);
    shape_of(m, w, s, x);
    T y = vsqrt(vmax(x[1], splat(1e-12))), z = vsqrt(vmax(x[2], splat(1e-12))), none = T{};
    const T by[6][6] = {
        {one, none, none, none, none, none},
        {none, one, none, 0.5 * x[3] / y, none, none},
        {none, none, one, none, 0.5 * x[4] / z, 0.5 * x[5] / z},
        {2.0 * x[3], none, none, y, none, none},
        {2.0 * x[4], none, none, x[5], z, none},
        {none, 2.0 * x[5], none, x[4], none, z},
    };
    CMBRL_FOR(i, 6) X[i] = by[j][i];
  }
  unfold(G{}, m.shape_root + s * G::D * G::D, X, dI);
}

// Scale of a body's mass: mu.
template <class G>
static inline T mass_scale(const Model& m, const Work<G>& w, int k) { return m.par_nominal[k] + w.dtheta[k]; }

// Whether the shape is not the file's, in some lane.
template <class G>
static bool reshaped(const Model& m, const Work<G>& w, int s) {
  bool moved = false;
  CMBRL_FOR(j, kShape<G>) if (int k = m.shape_par[s * kShape<G> + j]; k >= 0) moved |= any(w.dtheta[k] != 0.0);
  return moved;
}

template <class G>
static void load_shapes(const Model& m, Work<G>& w) {
  for (int s = 0; s < m.nshape; ++s) {
    if (!reshaped(m, w, s)) continue;
    T dI[G::SYM], mu = mass_scale(m, w, m.shape_mass[s]);
    shape_inertia(m, w, s, dI);
    CMBRL_FOR(i, G::SYM) w.P[m.shape_body[s] * m.body_fields + 1 + G::D + i] += mu * dI[i];
  }
}

}  // namespace cmbrl::CMBRL_ISA
