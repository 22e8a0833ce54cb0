// Free flight until the first impact. A step whose only resistance is a bounce flies with vf for as long as it takes to get
// there, and everything that the step looks at, rows, inertia and forces, is that of the place of impact: the point, the normal
// and the lever arms at which the impulse acts. What the place is by the step's start is folded into the matrices of impact.hpp.
#pragma once
#include "step/parameters.hpp"

namespace cmbrl::CMBRL_ISA {

// F: dvf = Fq dq + Fv dv + Fu du + Fp dtheta of a velocity without contact. Twists under vf are left in w.tn.
template <class G>
static void free_terms(const Model& m, const Options& o, Work<G>& w, T* vf, T* Fq, T* Fv, T* Fu, T* Fp) {
  int nv = m.nv;
  smooth_terms(m, o, w, vf, Fq, Fv, Fu);
  solve_many(w.free_factor, nv, m.mass, Fq, nv);
  solve_many(w.free_factor, nv, m.mass, Fv, nv);
  solve_many(w.free_factor, nv, m.mass, Fu, m.nu);
  if (w.np == 0) return;
  T* vn = w.vn;
  w.vn = vf;
  parameter_terms(m, o, w, Fp, Part::free);
  w.vn = vn;
  solve_many(w.free_factor, nv, m.mass, Fp, w.np);
}

// B of a midpoint step: vb is half way to the free velocity that the bias at v leads to.
template <class G>
static void bias_terms(const Model& m, const Options& o, Work<G>& w) {
  int nv = m.nv;
  T* vf = w.pvec;
  for (int i = 0; i < nv; ++i) vf[i] = 2.0 * w.vb[i] - w.v[i];
  free_terms(m, o, w, vf, w.Bq, w.Bv, w.Bu, w.Bp);
  for (int i = 0; i < nv * nv; ++i) { w.Bq[i] *= 0.5; w.Bv[i] *= 0.5; }
  for (int i = 0; i < nv; ++i) w.Bv[i * (nv + 1)] += 0.5;
  for (int i = 0; i < nv * m.nu; ++i) w.Bu[i] *= 0.5;
  for (int i = 0; i < nv * w.np; ++i) w.Bp[i] *= 0.5;
}

// z += j . dvf for a covector j (nv); z = (q, v, u, theta).
template <class G>
static void through_free_velocity(const Model& m, const Work<G>& w, const T* j, T* z) {
  int nv = m.nv;
  for (int i = 0; i < nv; ++i) {
    for (int k = 0; k < nv; ++k) { z[k] += j[i] * w.Fq[i * nv + k]; z[nv + k] += j[i] * w.Fv[i * nv + k]; }
    for (int k = 0; k < m.nu; ++k) z[2 * nv + k] += j[i] * w.Fu[i * m.nu + k];
    for (int k = 0; k < w.np; ++k) z[2 * nv + m.nu + k] += j[i] * w.Fp[i * w.np + k];
  }
}

// d(J vf + c0) of a contact, with twists under vf in w.tn.
template <class G>
static void closing_row(const Model& m, Work<G>& w, const Contact<G>& c, T* z) {
  int nv = m.nv;
  for (int k = 0; k < columns_of_step(m, w); ++k) z[k] = T{};
  for (int k = 0; k < nv; ++k) w.tmp[k] = T{};
  int group = m.con_group[c.index], A = m.con_bodyA[c.index], B = m.con_bodyB[c.index];
  Vec<G::N> relative = passing_twist(m, w, w.tn, c) - c.carry * passing_twist(m, w, w.vel, c);
  for (int a = m.grp_dptr[group]; a < m.grp_dptr[group + 1]; ++a) {
    int d = m.grp_dof[a], sign = m.grp_sign[a], side = sign > 0 ? A : B;
    Shift<G> s = shift_by_dof(m, w, c, w.S[d], sign);
    T swing = dot(c.Wr[0], cross_motion<G>(w.S[d], w.tn[side] - w.tnlam[d] - c.carry * (w.vel[side] - w.vlam[d])));
    T column = dot(c.Wr[0], w.S[d]);
    z[d] = dot(wrench_shift(c, s, 0), relative) + (sign > 0 ? swing : -swing) + c.dc_dphi * s.dphi;
    if (glides(m, c)) z[d] += (1.0 - c.carry) * dot(c.Wr[0], glide_by_dof(m, w, c, s, w.S[d], sign));
    w.tmp[d] = sign > 0 ? column : -column;
    z[nv + d] = -c.carry * w.tmp[d];
  }
  through_free_velocity(m, w, w.tmp, z);
}

// dphi of a contact.
template <class G>
static void gap_row(const Model& m, const Work<G>& w, const Contact<G>& c, T* row) {
  for (int k = 0; k < columns_of_step(m, w); ++k) row[k] = T{};
  int group = m.con_group[c.index];
  for (int a = m.grp_dptr[group]; a < m.grp_dptr[group + 1]; ++a)
    row[m.grp_dof[a]] = shift_by_dof(m, w, c, w.S[m.grp_dof[a]], m.grp_sign[a]).dphi;
  for (int k = 0; k < w.np; ++k) row[2 * m.nv + m.nu + k] = gap_of_parameter(m, c, w.parameter[k]);
}

// A covector of the place of impact (zq) becomes one of the step's start, with what it finds there of v, u and theta.
template <class G>
static void through_leap(const Model& m, const Work<G>& w, T* zq, T* zv, T* zu, T* zp) {
  int nv = m.nv;
  T* y = w.pvec;
  for (int i = 0; i < nv; ++i) y[i] = T{};
  pull_cotangent(m, w.leap, zq, y, splat(1));
  for (int i = 0; i < nv; ++i) {
    for (int k = 0; k < nv; ++k) { zq[k] += y[i] * w.Lq[i * nv + k]; zv[k] += y[i] * w.Lv[i * nv + k]; }
    for (int k = 0; k < m.nu; ++k) zu[k] += y[i] * w.Lu[i * m.nu + k];
    for (int k = 0; k < w.np; ++k) zp[k] += y[i] * w.Lp[i * w.np + k];
  }
}
template <class G>
static void row_through_leap(const Model& m, const Work<G>& w, T* z) {
  if (w.leapt) through_leap(m, w, z, z + m.nv, z + 2 * m.nv, z + 2 * m.nv + m.nu);
}
template <class G>
static void rows_through_leap(const Model& m, const Work<G>& w, T* Aq, T* Av, T* Au, T* Ap) {
  for (int i = 0; w.leapt && i < m.nv; ++i) through_leap(m, w, Aq + i * m.nv, Av + i * m.nv, Au + i * m.nu, Ap + i * w.np);
}

// dleap = flown dvf + vf dflown and dflown = (dphi + flown d(J vf)) / speed of the first contact; the mean of those that are
// first at once. At the step's start.
template <class G>
static void leap_terms(const Model& m, const Options& o, Work<G>& w) {
  more_columns(m, w);
  int nv = m.nv, nu = m.nu, ncol = columns_of_step(m, w);
  w.ahead = false;
  if (o.midpoint) bias_terms(m, o, w);
  w.ahead = o.midpoint;
  free_terms(m, o, w, w.vf, w.Fq, w.Fv, w.Fu, w.Fp);
  T *z = w.Z, *row = w.Z + ncol, count = T{};
  for (int k = 0; k < ncol; ++k) w.dflown[k] = T{};
  for (int i = 0; i < w.ncon; ++i) {
    const Contact<G>& c = w.con[i];
    Mask first = c.bounce & (w.flown > 0.0) & (c.time <= (1 + 1e-12) * w.flown);
    if (!any(first)) continue;
    count += keep(first, splat(1));
    closing_row(m, w, c, z);
    gap_row(m, w, c, row);
    for (int k = 0; k < ncol; ++k) w.dflown[k] += keep(first, (row[k] + w.flown * z[k]) / c.speed);
  }
  for (int k = 0; k < ncol; ++k) w.dflown[k] /= vmax(count, splat(1));
  auto fill = [&](T* L, const T* F, const T* d, int n) {
    for (int i = 0; i < nv; ++i)
      for (int k = 0; k < n; ++k) L[i * n + k] = w.flown * F[i * n + k] + w.vf[i] * d[k];
  };
  fill(w.Lq, w.Fq, w.dflown, nv);
  fill(w.Lv, w.Fv, w.dflown + nv, nv);
  fill(w.Lu, w.Fu, w.dflown + 2 * nv, nu);
  fill(w.Lp, w.Fp, w.dflown + 2 * nv + nu, w.np);
}

template <class G>
static void find_step(const Model& m, const Options& o, Work<G>& w, const Mask* given) {
  prepare(m, o, w, given);
  eliminate_untouched(m, w);
  bias_at_midpoint(m, o, w);
}

// What a step looks at: rows and free velocity, at its start or, after a flight, at its first impact, where w.q is then. recorded:
// the time of flight of a step that is read back from its tape, with its rows (given: as in prepare).
template <class G>
static void set_up_step(const Model& m, const Options& o, Work<G>& w, const Mask* given = nullptr, const T* recorded = nullptr) {
  w.flown = T{};
  find_step(m, o, w, given);
  T flight = find_bounces(m, o, w);
  w.flown = recorded ? *recorded : flight;
  w.leapt = any(w.flown > 0.0);
  if (!w.leapt) return;
  if (w.Gq) leap_terms(m, o, w);
  for (int i = 0; i < m.nq; ++i) w.began[i] = w.q[i];
  for (int i = 0; i < m.nv; ++i) w.leap[i] = w.flown * w.vf[i];
  integrate(m, w.q, w.leap);
  find_step(m, o, w, given);
  find_bounces(m, o, w);
}

}  // namespace cmbrl::CMBRL_ISA
