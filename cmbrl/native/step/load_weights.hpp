// MuJoCo's inverse weights, those of qpos0: w = tr(J M^-1 J^T) with the rows J of a joint, of a tendon's length, or of the centre
// of mass of a body, by what the file has. With parameters of inertia and armature,
//   dw = 2 tr(dJ Y) - tr(Y^T dM Y),  Y = M^-1 J^T,
// where tr(Y^T dM Y) is twice the kinetic energy of a change of inertia under the velocities Y.
#pragma once
#include "dynamics/inertia_change.hpp"
#include "dynamics/inverse_weight.hpp"
#include "solver/factor.hpp"
#include "step/columns.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr double kMostSoftened = 1e9;  // a weightless robot leaves numbers finite

// Bodies as they are at qpos0, and the factor of M there.
template <class G>
static void find_rest(const Model& m, Work<G>& w) {
  for (int i = 0; i < m.nq; ++i) w.q[i] = splat(m.q0[i]);
  kinematics(m, w, w.q);
  find_lines(m, w);
  inertias(m, w);
  mass_matrix(m, w);
  for (int i = 0; i < m.nline; ++i) add_square(m, w, i, w.P[m.oDof + i * kDofFields + kArmature], w.M, m.mass);
  factorise<true>(w.M, m.mass, m.nv);
}

template <class G>
static void weight_row(const Model& m, const Work<G>& w, int j, int r, T* J) {
  for (int d = 0; d < m.nv; ++d) J[d] = T{};
  int b = m.weight_body[j];
  if (b < 0) {
    int row = m.weight_ptr[j] + r;
    for (int e = m.weight_row_ptr[row]; e < m.weight_row_ptr[row + 1]; ++e) J[m.weight_dof[e]] = splat(m.weight_coef[e]);
    return;
  }
  typename G::V p = load<G::D>(m.weight_point + j * G::D);
  if (m.weight_carried[j]) CMBRL_FOR(i, G::D) p[i] += w.P[b * m.body_fields + 1 + i];
  p = w.pos[b] + G::rotate(w.R[b], p);
  for (int d = m.body_lastdof[b]; d >= 0; d = m.above(d)) J[d] = (lin<G>(w.S[d]) + G::turn(ang<G>(w.S[d]), p))[r];
}

// Adds to the slopes of weight j what its row r does under y = M^-1 J^T, before they are divided by the file's weight.
template <class G>
static void add_slopes(const Model& m, Work<G>& w, int j, int r, const T* y) {
  twists_under(m, w, y, w.vel);
  T* slope = w.weight_slope + m.weight_slopes[j];
  for (int i = m.weight_span[2 * j]; i < m.weight_span[2 * j + 1]; ++i, ++slope) {
    int k = m.inertial_par[i], b = w.inertia_body[i];
    if (w.column[k] == kUnwanted) continue;
    if (b >= 0) *slope -= dot(w.vel[b], w.inertia_change[i] * w.vel[b]);
    bool carried = b >= 0 && b == m.weight_body[j] && m.weight_carried[j];
    for (int e = m.par_ptr[k]; e < m.par_ptr[k + 1]; ++e) {
      int line = (m.par_idx[e] - m.oDof) / kDofFields, axis = m.par_idx[e] % m.body_fields - 1;
      if (m.par_idx[e] >= m.oDof) {
        if (line >= m.nline || (m.par_idx[e] - m.oDof) % kDofFields != kArmature) continue;
        T rate = along(m, w, line, y);
        *slope -= m.par_coef[e] * rate * rate;
      } else if (carried && axis >= 0 && axis < G::D) {
        typename G::V moved = zero<G::D>();
        moved[axis] = splat(2.0 * m.par_coef[e]);
        *slope += G::turn(ang<G>(w.vel[b]), G::rotate(w.R[b], moved))[r];
      }
    }
  }
}

// Where nothing moved, the weight is exactly the file's.
template <class G>
static void load_weight(const Model& m, Work<G>& w, int j, Mask moved) {
  T *J = w.delta, *y = w.rhs, *slope = w.weight_slope + m.weight_slopes[j], total = T{};
  int slopes = w.softens ? m.weight_slopes[j + 1] - m.weight_slopes[j] : 0;
  for (int i = 0; i < slopes; ++i) slope[i] = T{};
  for (int r = 0, rows = m.weight_body[j] < 0 ? m.weight_ptr[j + 1] - m.weight_ptr[j] : G::D; r < rows; ++r) {
    weight_row(m, w, j, r, J);
    for (int d = 0; d < m.nv; ++d) y[d] = J[d];
    solve(w.M, m.nv, m.mass, y);
    for (int d = 0; d < m.nv; ++d) total += J[d] * y[d];
    if (slopes > 0) add_slopes(m, w, j, r, y);
  }
  T factor = total / m.weight_nominal[j];
  Mask known = factor <= kMostSoftened;
  w.weight[j] = select(moved, select(known, factor, splat(kMostSoftened)), splat(1));
  for (int i = 0; i < slopes; ++i) slope[i] = keep(known, slope[i] / m.weight_nominal[j]);
}

template <class G>
static void load_weights(const Model& m, Work<G>& w) {
  Mask moved = none();
  w.softens = false;
  for (int i = 0; i < m.ninertial; ++i) {
    moved |= w.dtheta[m.inertial_par[i]] != 0.0;
    w.softens |= w.Gq && w.column[m.inertial_par[i]] != kUnwanted;
  }
  for (int j = 0; j < m.nweight; ++j) w.weight[j] = splat(1);
  if (m.nweight == 0 || !(any(moved) || w.softens)) return;
  find_rest(m, w);
  for (int i = 0; i < m.ninertial && w.softens; ++i) w.inertia_body[i] = inertia_change(m, w, m.inertial_par[i], w.inertia_change[i]);
  for (int j = 0; j < m.nweight; ++j) load_weight(m, w, j, moved);
}

}  // namespace cmbrl::CMBRL_ISA
