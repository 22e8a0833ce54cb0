// The implicit system of a step, with the parts that look at the free velocity vf or act late in the step: adaptive kappa(z),
// Newton restitution at the time of impact, impulses that act then. Folded into the matrices of derivative.hpp, so that
// Jacobians and vector-Jacobian products need not know:
//   H dv' = Gq dq + Gv dv + Gu du + Gp dtheta,    dqtan = h dv' - (Sq dq + Sv dv + Su du + Sp dtheta + Sn dv').
#pragma once
#include "step/flight.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G>
static void smooth_and_rows(const Model& m, const Options& o, Work<G>& w) {
  smooth_terms(m, o, w, w.vn, w.Gq, w.Gv, w.Gu);
  InteriorPoint<G> ip(m, o, w);
  ip.rho = T{};
  ip.linearise_all(T{}, none());
  ip.factorise();
  contact_terms(m, o, w, w.Gq, w.Gv, false);
  parameter_terms(m, o, w, w.Gp);
  rows_through_leap(m, w, w.Gq, w.Gv, w.Gu, w.Gp);
}

template <class G>
static T* row_of_Z(const Model& m, const Work<G>& w, int row) { return w.Z + row * columns_of_step(m, w); }
// The same of cn0 of a bounce.
template <class G>
static T* row_of_bounce(const Model& m, const Work<G>& w, int row) { return row_of_Z(m, w, w.ncon + w.nlim + row); }

// d cn0 = by_free d(J vf) + by_start d(J v) + by_gap dphi + by_flight dflown; z: the row of d(J vf).
template <class G>
static void bounce_terms(const Model& m, Work<G>& w, int i, const T* z) {
  const Contact<G>& c = w.con[i];
  int group = m.con_group[c.index], A = m.con_bodyA[c.index], B = m.con_bodyB[c.index];
  T* t = row_of_bounce(m, w, i);
  for (int k = 0; k < columns_of_step(m, w); ++k) t[k] = c.by_free * z[k];
  Vec<G::N> relative = relative_twist<G>(m, w.vel, c.index);
  for (int a = m.grp_dptr[group]; a < m.grp_dptr[group + 1]; ++a) {
    int d = m.grp_dof[a], sign = m.grp_sign[a];
    Shift<G> s = shift_by_dof(m, w, c, w.S[d], sign);
    T swing = dot(c.Wr[0], cross_motion<G>(w.S[d], w.vel[sign > 0 ? A : B] - w.vlam[d])), column = dot(c.Wr[0], w.S[d]);
    t[d] += c.by_start * (dot(wrench_shift(c, s, 0), relative) + (sign > 0 ? swing : -swing)) + c.by_gap * s.dphi;
    t[m.nv + d] += c.by_start * (sign > 0 ? column : -column);
  }
  for (int k = 0; k < w.np; ++k) t[2 * m.nv + m.nu + k] += c.by_gap * gap_of_parameter(m, c, w.parameter[k]);
  row_through_leap(m, w, t);
  for (int k = 0; w.leapt && k < columns_of_step(m, w); ++k) t[k] += c.by_flight * w.dflown[k];
}

// Sensitivities of the free closing coordinate J vf + c0 of contact rows and limits that need it.
template <class G>
static void closing_terms(const Model& m, Work<G>& w) {
  int nv = m.nv, ncol = columns_of_step(m, w);
  for (int i = 0; i < w.ncon; ++i) {
    T* z = row_of_Z(m, w, i);
    closing_row(m, w, w.con[i], z);
    if (any(w.con[i].bounce)) bounce_terms(m, w, i, z);
    row_through_leap(m, w, z);
  }
  for (int i = 0; i < w.nlim; ++i) {
    Limit& l = w.lim[i];
    T* z = row_of_Z(m, w, w.ncon + i);
    for (int k = 0; k < ncol; ++k) z[k] = T{};
    for (int k = 0; k < nv; ++k) w.tmp[k] = T{};
    add_pull(m, w, l, splat(1), w.tmp);
    add_pull(m, w, l, l.dc_dphi, z);
    add_pull(m, w, l, -l.carry, z + nv);
    if (l.round) add_turn(m, w, l, w.vf, z);
    for (int k = m.line_ptr[l.line]; !l.round && bends(m, l.line) && k < m.line_ptr[l.line + 1]; ++k)
      z[m.line_dof[k]] += l.sign * bent_rate(m, w, l.line, k, splat(1), w.vf, -l.carry, w.v);
    through_free_velocity(m, w, w.tmp, z);
    row_through_leap(m, w, z);
  }
}

// A += g z over the blocks of z.
template <class G>
static void add_outer(const Model& m, const Work<G>& w, const T* g, const T* z, T* Aq, T* Av, T* Au, T* Ap) {
  int nv = m.nv;
  for (int i = 0; i < nv; ++i) {
    for (int k = 0; k < nv; ++k) { Aq[i * nv + k] += g[i] * z[k]; Av[i * nv + k] += g[i] * z[nv + k]; }
    for (int k = 0; k < m.nu; ++k) Au[i * m.nu + k] += g[i] * z[2 * nv + k];
    for (int k = 0; k < w.np; ++k) Ap[i * w.np + k] += g[i] * z[2 * nv + m.nu + k];
  }
}

// What a change of the closing coordinate does to the momentum of one contact, through kappa; and one of its cn0.
template <class G> static Vec<G::N> closing_response(const Contact<G>& c) { return kappa_response(c, c.slope); }
template <class G>
static Vec<G::N> bounce_response(const Contact<G>& c) {
  T E[1 + G::MT] = {};
  E[0] = keep(c.bounce, splat(1));
  return response(c, E) + kappa_response(c, keep(c.bounce, c.slope));
}

template <class G>
static void fold_closing_terms(const Model& m, const Options& o, Work<G>& w) {
  InteriorPoint<G> ip(m, o, w);
  T* g = w.rhs;
  for (int i = 0; i < w.ncon + w.nlim; ++i) {
    for (int k = 0; k < m.nv; ++k) g[k] = T{};
    if (i < w.ncon) {
      ip.add_wrench(m.con_group[w.con[i].index], closing_response(w.con[i]), g);
    } else {
      const Limit& l = w.lim[i - w.ncon];
      add_pull(m, w, l, keep(l.on, l.slope / (l.s + l.gam * l.R)), g);
    }
    add_outer(m, w, g, row_of_Z(m, w, i), w.Gq, w.Gv, w.Gu, w.Gp);
    if (i >= w.ncon || !any(w.con[i].bounce)) continue;
    for (int k = 0; k < m.nv; ++k) g[k] = T{};
    ip.add_wrench(m.con_group[w.con[i].index], bounce_response(w.con[i]), g);
    add_outer(m, w, g, row_of_bounce(m, w, i), w.Gq, w.Gv, w.Gu, w.Gp);
  }
}

template <class G>
static void clear_late(const Model& m, Work<G>& w) {
  int nv = m.nv;
  for (int i = 0; i < nv * nv; ++i) w.Sq[i] = w.Sv[i] = T{};
  for (int i = 0; i < nv * m.nu; ++i) w.Su[i] = T{};
  for (int i = 0; i < nv * w.np; ++i) w.Sp[i] = T{};
}

// Adds -dM~ shift to S, of what damps -dD eased, without ties.
template <class G>
static void inertia_terms(const Model& m, const Options& o, Work<G>& w) {
  int nv = m.nv;
  late_power_terms(m, o, w, w.Sq, w.Sv);
  if (m.in_fluid() && m.implicit_gains) {
    for (int k = 0; k < nv; ++k) w.pvec[k] = w.v[k] + w.eased[k];
    accelerations_and_twists(m, o, w, w.pvec);
    fluid_terms(m, o, w, true, w.Sq, w.Sv, true);
    fluid_columns(m, o, w, true, w.Sp, true);
  }
  inertia_derivatives(m, w, w.shift, -1.0, w.Sq);
  for (int i = m.nv; i < m.nline; ++i) {
    add_bend(m, w, i, -w.line_mass[i] * along(m, w, i, w.shift), T{}, w.shift, -w.line_mass[i], w.shift, w.Sq);
    if (o.split) add_bent_drag(m, w, i, implicit_damping(m, o, w, i), w.eased, w.Sq);
  }
  gain_terms(m, o, w, w.eased, w.Su);
  parameter_terms(m, o, w, w.Sp, Part::late_inertia);
}

// S of M~ shift = sum t_i J_i^T x_i with t_i = phi_i / speed_i: the part of a place and parameters at fixed t_i and x_i.
template <class G>
static void late_smooth_terms(const Model& m, const Options& o, Work<G>& w) {
  clear_late(m, w);
  for (int i = 0; i < m.nv * m.nv; ++i) w.Sn[i] = T{};
  contact_terms(m, o, w, w.Sq, w.Sv, true);
  parameter_terms(m, o, w, w.Sp, Part::late_rows);
  w.eased = w.shift;
  inertia_terms(m, o, w);
  tie_terms(m, o, w, w.shift, nullptr, w.Sq, nullptr);
  rows_through_leap(m, w, w.Sq, w.Sv, w.Su, w.Sp);
}
// The rest of S, dx = -Theta (J dv' + E) + ... and dt_i; ends by solving with M~. What is left of the step after a flight is
// shorter: flown dv' + v' dflown.
template <class G>
static void late_terms(const Model& m, const Options& o, Work<G>& w) {
  int nv = m.nv;
  InteriorPoint<G> ip(m, o, w);
  T *g = w.rhs, *row = row_of_Z(m, w, 2 * w.ncon + w.nlim);
  late_smooth_terms(m, o, w);
  auto add = [&](const Contact<G>& c, const Vec<G::N>& F, const T* z) {
    for (int k = 0; k < nv; ++k) g[k] = T{};
    ip.add_wrench(m.con_group[c.index], F, g);
    add_outer(m, w, g, z, w.Sq, w.Sv, w.Su, w.Sp);
  };
  for (int i = 0; i < w.ncon; ++i) {
    Contact<G>& c = w.con[i];
    if (!any(c.bounce)) continue;
    T weight = late_weight(c), K[G::N][G::N] = {};
    Vec<G::N> F = zero<G::N>();
    CMBRL_FOR(r, c.rows) {
      F += impulse(c, r) * c.Wr[r];
      Vec<G::N> back = (-weight * c.Th[r][0]) * c.Wr[0];
      for (int k = 1; k < c.rows && (r > 0 || o.convex); ++k) back -= (weight * c.Th[r][k]) * c.Wr[k];
      CMBRL_FOR(a, G::N) CMBRL_FOR(b, G::N) K[a][b] += c.Wr[r][a] * back[b];
    }
    ip.add_group_matrix(m.con_group[c.index], K, w.Sn);
    const T* z = row_of_Z(m, w, i);
    add(c, weight * closing_response(c), z);
    add(c, weight * bounce_response(c), row_of_bounce(m, w, i));
    gap_row(m, w, c, row);
    row_through_leap(m, w, row);
    Mask open = c.bounce & (c.phi > 0.0);
    T per_speed = keep(open, 1.0 / select(open, c.speed, splat(1)));
    for (int k = 0; k < columns_of_step(m, w); ++k) row[k] = per_speed * (row[k] + c.time * z[k]);  // dt
    add(c, F, row);
  }
  solve_many(w.free_factor, nv, m.mass, w.Sq, nv);
  solve_many(w.free_factor, nv, m.mass, w.Sv, nv);
  solve_many(w.free_factor, nv, m.mass, w.Sn, nv);
  solve_many(w.free_factor, nv, m.mass, w.Su, m.nu);
  solve_many(w.free_factor, nv, m.mass, w.Sp, w.np);
  if (!w.leapt) return;
  for (int i = 0; i < nv; ++i) w.Sn[i * (nv + 1)] += w.flown;
  add_outer(m, w, w.vn, w.dflown, w.Sq, w.Sv, w.Su, w.Sp);
}

// S of split damping (split.hpp) with y = shift: K dy = Sq dq + Sv dv + Sp dtheta + D du.
template <class G>
static void split_terms(const Model& m, const Options& o, Work<G>& w) {
  clear_late(m, w);
  damped_away(m, w, w.shift);
  w.eased = w.leap;  // steps with split damping do not fly
  for (int i = 0; i < m.nv; ++i) w.eased[i] = w.v[i] - w.vn[i] + w.shift[i];
  inertia_terms(m, o, w);
  for_drags(m, w, [&](int i, int k, T damping) { w.Sv[i * m.nv + k] -= damping; });
  if (!gyroscopic(m, o)) return;
  gyroscopic_terms(m, o, w, w.eased, w.Sq, w.Sv);
  for_polarised(m, w, w.eased, [&](double weight) {
    w.gyro_weight = weight;
    parameter_terms(m, o, w, w.Sp, Part::gyroscopic);
  });
}

// G, S and the factor H at the solution in w (rows, vn).
template <class G>
static void implicit_system(const Model& m, const Options& o, Work<G>& w) {
  int flown = w.np;
  more_columns(m, w);
  if (w.leapt) {
    widen(w.Lp, m.nv, flown, w.np);
    widen(w.dflown, 1, columns_of_step(m, w) + flown - w.np, columns_of_step(m, w));
  }
  w.late = w.leapt;
  w.early = w.ahead = false;
  if (o.midpoint) bias_terms(m, o, w);
  w.ahead = o.midpoint;
  for (int i = 0; i < w.ncon; ++i) {
    w.late |= any(w.con[i].bounce);
    w.early |= any(w.con[i].slope != 0.0);
  }
  for (int i = 0; i < w.nlim; ++i) w.early |= any(w.lim[i].slope != 0.0);
  w.early |= w.late;
  if (w.early) {
    free_terms(m, o, w, w.vf, w.Fq, w.Fv, w.Fu, w.Fp);
    closing_terms(m, w);
  }
  smooth_and_rows(m, o, w);
  if (w.early) fold_closing_terms(m, o, w);
  if (w.late) late_terms(m, o, w);
  if (o.split) split_terms(m, o, w);
}

}  // namespace cmbrl::CMBRL_ISA
