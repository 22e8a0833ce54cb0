// The implicit system of a step, with the parts that look at the free velocity vf or act late in the step: adaptive kappa(z),
// Newton restitution at the time of impact, impulses that act then. Folded into the matrices of derivative.hpp, so that
// Jacobians and vector-Jacobian products need not know:
//   H dv' = Gq dq + Gv dv + Gu du + Gp dtheta,    dqtan = h dv' - (Sq dq + Sv dv + Su du + Sp dtheta + Sn dv').
#pragma once
#include "parameters.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G>
static void smooth_and_rows(const Model& m, const Options& o, Work<G>& w, bool theta) {
  smooth_terms(m, o, w, w.vn, w.Gq, w.Gv, w.Gu);
  InteriorPoint<G> ip(m, o, w);
  ip.rho = T{};
  ip.linearise_all(T{}, none());
  ip.factorise();
  contact_terms(m, w, w.Gq, w.Gv, false);
  if (theta) parameter_terms(m, o, w, w.Gp);
}

// F: dvf = Fq dq + Fv dv + Fu du + Fp dtheta of a velocity without contact; HF: the factor of M~. Twists under vf are left
// in w.tn.
template <class G>
static void free_terms(const Model& m, const Options& o, Work<G>& w, bool theta, T* vf, T* Fq, T* Fv, T* Fu, T* Fp) {
  int nv = m.nv;
  Pattern pat = pattern_of(m, w);
  for (int i = 0; i < w.ndyn; ++i) copy_row(w.H, w.H0, pat, w.dyn_list[i]);
  for (int i = 0; i < w.ndyn; ++i) eliminate(w.H, pat, w.dyn_list[i]);
  for (int i = 0; i < nv; ++i) copy_row(w.HF, w.H, pat, i);
  smooth_terms(m, o, w, vf, Fq, Fv, Fu);
  solve_many(w.HF, nv, pat, Fq, nv);
  solve_many(w.HF, nv, pat, Fv, nv);
  solve_many(w.HF, nv, pat, Fu, m.nu);
  if (!theta) return;
  int ncon = w.ncon, ndry = w.ndry;
  T* vn = w.vn;
  w.ncon = w.ndry = 0;
  w.vn = vf;
  parameter_terms(m, o, w, Fp);
  w.vn = vn;
  w.ncon = ncon;
  w.ndry = ndry;
  solve_many(w.HF, nv, pat, Fp, m.ntheta);
}

// B of a midpoint step: vb is half way to the free velocity that the bias at v leads to.
template <class G>
static void bias_terms(const Model& m, const Options& o, Work<G>& w, bool theta) {
  int nv = m.nv;
  T* vf = w.pvec;
  for (int i = 0; i < nv; ++i) vf[i] = 2.0 * w.vb[i] - w.v[i];
  free_terms(m, o, w, theta, vf, w.Bq, w.Bv, w.Bu, w.Bp);
  for (int i = 0; i < nv * nv; ++i) { w.Bq[i] *= 0.5; w.Bv[i] *= 0.5; }
  for (int i = 0; i < nv; ++i) w.Bv[i * (nv + 1)] += 0.5;
  for (int i = 0; i < nv * m.nu; ++i) w.Bu[i] *= 0.5;
  for (int i = 0; theta && i < nv * m.ntheta; ++i) w.Bp[i] *= 0.5;
}

// z += j . dvf for a covector j (nv); z = (q, v, u, theta).
template <class G>
static void through_free_velocity(const Model& m, const Work<G>& w, const T* j, bool theta, T* z) {
  int nv = m.nv;
  for (int i = 0; i < nv; ++i) {
    for (int k = 0; k < nv; ++k) { z[k] += j[i] * w.Fq[i * nv + k]; z[nv + k] += j[i] * w.Fv[i * nv + k]; }
    for (int k = 0; k < m.nu; ++k) z[2 * nv + k] += j[i] * w.Fu[i * m.nu + k];
    for (int k = 0; theta && k < m.ntheta; ++k) z[2 * nv + m.nu + k] += j[i] * w.Fp[i * m.ntheta + k];
  }
}
template <class G>
static T* row_of_Z(const Model& m, const Work<G>& w, int row) { return w.Z + row * (2 * m.nv + m.nu + m.ntheta); }
// The same of cn0 of a bounce.
template <class G>
static T* row_of_bounce(const Model& m, const Work<G>& w, int row) { return row_of_Z(m, w, w.ncon + w.nlim + row); }

// d cn0 = by_free d(J vf) + by_start d(J v) + by_gap dphi; z: the row of d(J vf).
template <class G>
static void bounce_terms(const Model& m, Work<G>& w, int i, const T* z, bool theta) {
  const Contact<G>& c = w.con[i];
  int group = m.con_group[c.index], A = m.con_bodyA[c.index], B = m.con_bodyB[c.index];
  T* t = row_of_bounce(m, w, i);
  for (int k = 0; k < 2 * m.nv + m.nu + m.ntheta; ++k) t[k] = c.by_free * z[k];
  Feature<G> feature = find_feature(m, w, c.index);
  Vec<G::N> relative = relative_twist<G>(m, w.vel, c.index);
  for (int a = m.grp_dptr[group]; a < m.grp_dptr[group + 1]; ++a) {
    int d = m.grp_dof[a], sign = m.grp_sign[a];
    Shift<G> s = shift_by_dof(m, w, c, feature, w.S[d], sign);
    T swing = dot(c.Wr[0], cross_motion<G>(w.S[d], w.vel[sign > 0 ? A : B] - w.vlam[d])), column = dot(c.Wr[0], w.S[d]);
    t[d] += c.by_start * (dot(wrench_shift(c, s, 0), relative) + (sign > 0 ? swing : -swing)) + c.by_gap * s.dphi;
    t[m.nv + d] += c.by_start * (sign > 0 ? column : -column);
  }
  for (int k = 0; theta && k < m.ntheta; ++k) t[2 * m.nv + m.nu + k] += c.by_gap * gap_of_parameter(m, c, k);
}

// Sensitivities of the free closing coordinate J vf + c0 of contact rows and limits that need it.
template <class G>
static void closing_terms(const Model& m, Work<G>& w, bool theta) {
  int nv = m.nv, ncol = 2 * nv + m.nu + m.ntheta;
  for (int i = 0; i < w.ncon; ++i) {
    Contact<G>& c = w.con[i];
    T* z = row_of_Z(m, w, i);
    for (int k = 0; k < ncol; ++k) z[k] = T{};
    for (int k = 0; k < nv; ++k) w.tmp[k] = T{};
    int group = m.con_group[c.index], A = m.con_bodyA[c.index], B = m.con_bodyB[c.index];
    Feature<G> feature = find_feature(m, w, c.index);
    Vec<G::N> relative = relative_twist<G>(m, w.tn, c.index) - c.carry * relative_twist<G>(m, w.vel, c.index);
    for (int a = m.grp_dptr[group]; a < m.grp_dptr[group + 1]; ++a) {
      int d = m.grp_dof[a], sign = m.grp_sign[a], side = sign > 0 ? A : B;
      Shift<G> s = shift_by_dof(m, w, c, feature, w.S[d], sign);
      T swing = dot(c.Wr[0], cross_motion<G>(w.S[d], w.tn[side] - w.tnlam[d] - c.carry * (w.vel[side] - w.vlam[d])));
      T column = dot(c.Wr[0], w.S[d]);
      z[d] = dot(wrench_shift(c, s, 0), relative) + (sign > 0 ? swing : -swing) + c.dc_dphi * s.dphi;
      w.tmp[d] = sign > 0 ? column : -column;
      z[nv + d] = -c.carry * w.tmp[d];
    }
    through_free_velocity(m, w, w.tmp, theta, z);
    if (any(c.bounce > 0.0)) bounce_terms(m, w, i, z, theta);
  }
  for (int i = 0; i < w.nlim; ++i) {
    Limit& l = w.lim[i];
    T* z = row_of_Z(m, w, w.ncon + i);
    for (int k = 0; k < ncol; ++k) z[k] = T{};
    for (int k = 0; k < nv; ++k) w.tmp[k] = T{};
    w.tmp[l.dof] = l.sign;
    z[l.dof] = l.sign * l.dc_dphi;
    z[nv + l.dof] = -l.carry * l.sign;
    through_free_velocity(m, w, w.tmp, theta, z);
  }
}

// A += g z over the blocks of z.
template <class G>
static void add_outer(const Model& m, const T* g, const T* z, bool theta, T* Aq, T* Av, T* Au, T* Ap) {
  int nv = m.nv;
  for (int i = 0; i < nv; ++i) {
    for (int k = 0; k < nv; ++k) { Aq[i * nv + k] += g[i] * z[k]; Av[i * nv + k] += g[i] * z[nv + k]; }
    for (int k = 0; k < m.nu; ++k) Au[i * m.nu + k] += g[i] * z[2 * nv + k];
    for (int k = 0; theta && k < m.ntheta; ++k) Ap[i * m.ntheta + k] += g[i] * z[2 * nv + m.nu + k];
  }
}

// What a change of the closing coordinate does to the momentum of one contact, through kappa; and one of its cn0.
template <class G> static Vec<G::N> closing_response(const Contact<G>& c) { return kappa_response(c, c.slope); }
template <class G>
static Vec<G::N> bounce_response(const Contact<G>& c) {
  T E[1 + G::NT] = {};
  E[0] = keep(c.bounce > 0.0, splat(1));
  return response(c, E) + kappa_response(c, keep(c.bounce > 0.0, c.slope));
}

template <class G>
static void fold_closing_terms(const Model& m, const Options& o, Work<G>& w, bool theta) {
  InteriorPoint<G> ip(m, o, w);
  T* g = w.rhs;
  for (int i = 0; i < w.ncon + w.nlim; ++i) {
    for (int k = 0; k < m.nv; ++k) g[k] = T{};
    if (i < w.ncon) {
      ip.add_wrench(m.con_group[w.con[i].index], closing_response(w.con[i]), g);
    } else {
      const Limit& l = w.lim[i - w.ncon];
      g[l.dof] = keep(l.on, l.sign * l.slope / (l.s + l.gam * l.R));
    }
    add_outer<G>(m, g, row_of_Z(m, w, i), theta, w.Gq, w.Gv, w.Gu, w.Gp);
    if (i >= w.ncon || !any(w.con[i].bounce > 0.0)) continue;
    for (int k = 0; k < m.nv; ++k) g[k] = T{};
    ip.add_wrench(m.con_group[w.con[i].index], bounce_response(w.con[i]), g);
    add_outer<G>(m, g, row_of_bounce(m, w, i), theta, w.Gq, w.Gv, w.Gu, w.Gp);
  }
}

// S of M~ shift = sum t_i J_i^T x_i with t_i = phi_i / speed_i, dx = -Theta (J dv' + E) + ...; ends by solving with HF.
template <class G>
static void late_terms(const Model& m, const Options& o, Work<G>& w, bool theta) {
  int nv = m.nv;
  InteriorPoint<G> ip(m, o, w);
  T* g = w.rhs;
  for (int i = 0; i < nv * nv; ++i) w.Sq[i] = w.Sv[i] = w.Sn[i] = T{};
  for (int i = 0; i < nv * m.nu; ++i) w.Su[i] = T{};
  for (int i = 0; i < nv * m.ntheta; ++i) w.Sp[i] = T{};
  contact_terms(m, w, w.Sq, w.Sv, true);
  if (theta) parameter_terms(m, o, w, w.Sp, Part::late_rows);
  for (int i = 0; i < w.ncon; ++i) {
    Contact<G>& c = w.con[i];
    if (!any(c.bounce > 0.0)) continue;
    int group = m.con_group[c.index];
    T weight = late_weight(c), K[G::N][G::N] = {};
    Vec<G::N> F = zero<G::N>();
    CMBRL_FOR(r, c.rows) {
      F += impulse(c, r) * c.Wr[r];
      Vec<G::N> back = (-weight * c.Th[r][0]) * c.Wr[0];
      for (int k = 1; k < c.rows && r > 0; ++k) back -= (weight * c.Th[r][k]) * c.Wr[k];
      CMBRL_FOR(a, G::N) CMBRL_FOR(b, G::N) K[a][b] += c.Wr[r][a] * back[b];
    }
    ip.add_group_matrix(group, K, w.Sn);
    // dt = (dphi + t dz) / speed while the contact is still open
    Mask open = (c.bounce > 0.0) & (c.phi > 0.0);
    T per_speed = 1.0 / select(open, c.speed, splat(1));
    for (int k = 0; k < nv; ++k) g[k] = T{};
    ip.add_wrench(group, keep(open, c.time * per_speed) * F + weight * closing_response(c), g);
    add_outer<G>(m, g, row_of_Z(m, w, i), theta, w.Sq, w.Sv, w.Su, w.Sp);
    for (int k = 0; k < nv; ++k) g[k] = T{};
    ip.add_wrench(group, weight * bounce_response(c), g);
    add_outer<G>(m, g, row_of_bounce(m, w, i), theta, w.Sq, w.Sv, w.Su, w.Sp);
    for (int k = 0; k < nv; ++k) g[k] = T{};
    ip.add_wrench(group, keep(open, per_speed) * F, g);
    Feature<G> feature = find_feature(m, w, c.index);
    for (int a = m.grp_dptr[group]; a < m.grp_dptr[group + 1]; ++a) {
      int d = m.grp_dof[a];
      T dphi = shift_by_dof(m, w, c, feature, w.S[d], m.grp_sign[a]).dphi;
      for (int k = 0; k < nv; ++k) w.Sq[k * nv + d] += g[k] * dphi;
    }
    for (int k = 0; theta && k < m.ntheta; ++k) {  // parameters that move the gap itself
      T moved = gap_of_parameter(m, c, k);
      for (int j = 0; j < nv; ++j) w.Sp[j * m.ntheta + k] += g[j] * moved;
    }
  }
  typename G::V gravity;  // - dM~ shift: inverse dynamics of the acceleration `shift`, at rest, without gravity
  CMBRL_FOR(k, G::D) { gravity[k] = w.P[m.oGravity + k]; w.P[m.oGravity + k] = T{}; }
  for (int k = 0; k < nv; ++k) g[k] = T{};
  T* v = w.v;
  w.v = g;
  inverse_dynamics(m, w, w.v, w.shift, w.tmp);
  for (int i = 0; i < nv * nv; ++i) w.Fq[i] = T{};  // scratch: the velocity part is of no use
  inverse_dynamics_derivatives(m, w, -1.0, w.Sq, w.Fq);
  w.v = v;
  if (theta) parameter_terms(m, o, w, w.Sp, Part::late_inertia);
  CMBRL_FOR(k, G::D) w.P[m.oGravity + k] = gravity[k];
  Pattern pat = pattern_of(m, w);
  solve_many(w.HF, nv, pat, w.Sq, nv);
  solve_many(w.HF, nv, pat, w.Sv, nv);
  solve_many(w.HF, nv, pat, w.Sn, nv);
  solve_many(w.HF, nv, pat, w.Su, m.nu);
  if (theta) solve_many(w.HF, nv, pat, w.Sp, m.ntheta);
}

// G, S and the factor H at the solution in w (rows, vn).
template <class G>
static void implicit_system(const Model& m, const Options& o, Work<G>& w, bool theta) {
  w.late = w.early = w.ahead = false;
  if (o.midpoint) bias_terms(m, o, w, theta);
  w.ahead = o.midpoint;
  for (int i = 0; i < w.ncon; ++i) {
    w.late |= any(w.con[i].bounce > 0.0);
    w.early |= any(w.con[i].slope != 0.0);
  }
  for (int i = 0; i < w.nlim; ++i) w.early |= any(w.lim[i].slope != 0.0);
  w.early |= w.late;
  if (w.early) {
    free_terms(m, o, w, theta, w.vf, w.Fq, w.Fv, w.Fu, w.Fp);
    closing_terms(m, w, theta);
  }
  smooth_and_rows(m, o, w, theta);
  if (w.early) fold_closing_terms(m, o, w, theta);
  if (w.late) late_terms(m, o, w, theta);
}

}  // namespace cmbrl::CMBRL_ISA
