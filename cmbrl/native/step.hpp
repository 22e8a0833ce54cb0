// One physics step of a pack: smooth forces, active rows, free velocity, contact solve, displacement.
#pragma once
#include "ladder.hpp"
#include "manifold.hpp"
#include "rows.hpp"
#include "smoothing.hpp"

namespace cmbrl::CMBRL_ISA {

// H becomes a factor of M~ itself; vf the free velocity.
template <class G>
static void free_velocity(const Model& m, Work<G>& w) {
  int nv = m.nv;
  Pattern pat = pattern_of(m, w);
  eliminate_untouched(m, w);
  for (int i = 0; i < w.ndyn; ++i) copy_row(w.H, w.H0, nv, pat, w.dyn_list[i]);
  for (int i = 0; i < w.ndyn; ++i) eliminate(w.H, nv, pat, w.dyn_list[i]);
  for (int i = 0; i < nv; ++i) w.vf[i] = w.rhs[i];
  solve(w.H, nv, pat, w.vf);
  for (int i = 0; i < nv; ++i) w.vf[i] += w.v[i];
}

// Newton restitution of rigid contacts that close within the step: J v' + e J vf >= 0, the impulse acting at the time of impact.
template <class G>
static void find_bounces(const Model& m, const Options& o, Work<G>& w) {
  for (int g = 0; g < w.ngroups; ++g)
    for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
      Contact<G>& c = w.con[i];
      if (m.con_law[c.index] != kRigid) continue;
      T e = w.P[m.oContact + c.index * kContactFields + kRestitution];
      if (!any(e > 0.0)) continue;
      InteriorPoint<G> ip(m, o, w);
      T speed = -dot(c.Wr[0], ip.twist(w.groups[g].group, w.vf));
      Mask hits = c.on & (e > 0.0) & (speed > o.rest_speed) & (c.phi < speed * o.h);
      c.bounce = keep(hits, e);
      c.time = keep(hits, vmax(c.phi, T{}) / select(hits, speed, splat(1)));
      c.cn0 = select(hits, -e * speed, c.cn0);
      c.dc_dphi = select(hits, T{}, c.dc_dphi);
      c.speed = speed;
    }
}

// Whole step: from (w.q, w.v, w.u) to w.vn; the caller integrates.
template <class G>
static Outcome solve_step(const Model& m, const Options& o, Work<G>& w) {
  prepare(m, o, w);
  free_velocity(m, w);
  find_bounces(m, o, w);
  set_kappa(m, o, w, o.forward);
  return contact_solve(m, o, w);
}

// Tangent displacement of one step: h v' less what impacts inside the step lose by acting late (M~^-1 sum t_i J_i^T x_i).
template <class G>
static void displacement(const Model& m, const Options& o, Work<G>& w) {
  for (int i = 0; i < m.nv; ++i) { w.qtan[i] = o.h * w.vn[i]; w.shift[i] = T{}; }
  bool late = false;
  InteriorPoint<G> ip(m, o, w);
  for (int g = 0; g < w.ngroups; ++g)
    for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
      const Contact<G>& c = w.con[i];
      if (!any(c.bounce > 0.0)) continue;
      Vec<G::N> F = keep(c.bounce > 0.0, c.time * c.gam) * c.Wr[0];
      for (int k = 1; k < c.rows; ++k) F += keep((c.bounce > 0.0) & c.rub, c.time * c.b[k - 1]) * c.Wr[k];
      ip.add_wrench(w.groups[g].group, F, w.shift);
      late = true;
    }
  if (!late) return;
  for (int i = 0; i < w.ndyn; ++i) copy_row(w.H, w.H0, m.nv, ip.pat, w.dyn_list[i]);
  for (int i = 0; i < w.ndyn; ++i) eliminate(w.H, m.nv, ip.pat, w.dyn_list[i]);
  solve(w.H, m.nv, ip.pat, w.shift);
  for (int i = 0; i < m.nv; ++i) w.qtan[i] -= w.shift[i];
}

}  // namespace cmbrl::CMBRL_ISA
