// One physics step of a pack: smooth forces, active rows, free velocity, contact solve, displacement.
#pragma once
#include "solver/ladder.hpp"
#include "dynamics/manifold.hpp"
#include "step/rows.hpp"
#include "solver/smoothing.hpp"

namespace cmbrl::CMBRL_ISA {

// A midpoint step takes centrifugal and gyroscopic forces half way to where those of its start lead without contact (explicit
// midpoint rule: second order).
template <class G>
static void bias_at_midpoint(const Model& m, const Options& o, Work<G>& w) {
  if (!o.midpoint) return;
  int nv = m.nv;
  for (int i = 0; i < nv; ++i) w.vb[i] = 0.5 * (w.v[i] + w.vf[i]);
  w.swap_velocity();
  inverse_dynamics<G>(m, w, w.v, nullptr, w.tmp);
  w.swap_velocity();
  for (int i = 0; i < nv; ++i) w.tmp[i] = o.h * (w.bias[i] - w.tmp[i]);
  solve(w.free_factor, nv, m.mass, w.tmp);
  for (int i = 0; i < nv; ++i) w.vf[i] += w.tmp[i];
}

// Restitution of a contact; only rigid ones have it.
template <class G>
static T restitution(const Model& m, const Contact<G>& c) {
  return m.con_law[c.index] == kRigid ? c.P[kRestitution] : T{};
}

// Lanes in which a limit opposes vf.
template <class G>
static Mask held_by_limits(const Model& m, const Work<G>& w) {
  Mask held = none();
  for (int i = 0; i < w.nlim; ++i) {
    const Limit& l = w.lim[i];
    held |= l.on & (along(m, w, l, w.vf) + l.c0 < 0.0);
  }
  return held;
}

// Approach speeds under vf, and the lanes in which vf violates some row: in the others no impulse is to be expected.
template <class G>
static Mask closing_lanes(const Model& m, const Options& o, Work<G>& w) {
  InteriorPoint<G> ip(m, o, w);
  T left = 1.0 - w.flown * (1 / o.h);
  Mask closing = none();
  for (int g = 0; g < w.ngroups; ++g) {
    Vec<G::N> t = ip.twist(w.groups[g].group, w.vf);
    for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
      Contact<G>& c = w.con[i];
      c.speed = -dot(c.Wr[0], t);
      closing |= c.on & (c.cn0 < c.speed * left);
    }
  }
  return closing | held_by_limits(m, w);
}

// Newton restitution of rigid contacts that close within the step, at their time of impact: with s the approach speed then,
// the speed after it is e s, and J v' = e s - (J v's loss from then on). vf is the speed in the middle of the way from q to
// q', so that s = speed + (share - 1/2) gain; without the gain a bounce under gravity has a derivative of the wrong sign.
// A bounce that is still to come leaves its row out, which would brake without restitution at a distance, unless other
// impulses of this step may bring it about early.
// Returns how long vf carries a lane freely: until the first impact, or not at all where something else holds it.
template <class G>
static T find_bounces(const Model& m, const Options& o, Work<G>& w) {
  bool any_bounce = false;
  for (int i = 0; i < w.ncon; ++i) any_bounce |= any(restitution(m, w.con[i]) > 0.0);
  if (!any_bounce) return T{};
  Mask closing = closing_lanes(m, o, w), held_back = held_by_limits(m, w);
  for (int i = 0; i < w.ndry; ++i) held_back |= w.dry[i].on;
  T left = o.h - w.flown, first = splat(o.h);
  for (int i = 0; i < w.ncon; ++i) {
    Contact<G>& c = w.con[i];
    T e = restitution(m, c);
    Mask fast = (c.on | c.wide) & (e > 0.0) & (c.speed > o.rest_speed), hits = fast & (c.phi < c.speed * left);
    Mask takes_part = hits | ~fast | closing;
    c.on &= takes_part;
    c.wide &= takes_part;
    held_back |= c.on & ~hits & (c.cn0 < c.speed);
    T gain = c.speed + dot(c.Wr[0], relative_twist<G>(m, w.vel, c.index));
    c.bounce = hits;
    c.time = keep(hits, vmax(c.phi, T{}) / select(hits, c.speed, splat(1)));
    first = select(hits, vmin(first, c.time), first);
    T share = (w.flown + c.time) * (1 / o.h);  // of the step until the impact
    T target = c.speed - (1.0 + e) * (c.speed + (share - 0.5) * gain);
    Mask held = hits & (target < 0.0), open = held & (c.phi > 0.0);  // never may the row let the gap close on
    c.cn0 = select(hits, vmin(target, T{}), c.cn0);
    c.dc_dphi = select(hits, T{}, c.dc_dphi);
    c.by_e = -keep(held, c.speed + (share - 0.5) * gain);
    c.by_flight = -keep(held, (1.0 + e) * gain * (1 / o.h));
    c.by_gap = keep(open, c.by_flight / select(open, c.speed, splat(1)));
    c.by_start = keep(held, (1.0 + e) * (0.5 - share));
    c.by_free = keep(held, (1.0 + e) * (0.5 + share) - 1.0) + c.by_gap * c.time;
  }
  return keep((first < o.h) & ~held_back, first);
}

// What impacts inside the step lose of the way h v' by acting late, M~^-1 sum t_i J_i^T x_i, into w.shift.
template <class G>
static void late_shift(const Model& m, const Options& o, Work<G>& w) {
  for (int i = 0; i < m.nv; ++i) w.shift[i] = T{};
  bool late = false;
  InteriorPoint<G> ip(m, o, w);
  for (int g = 0; g < w.ngroups; ++g)
    for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
      const Contact<G>& c = w.con[i];
      if (!any(c.bounce)) continue;
      Vec<G::N> F = keep(c.bounce, c.time * c.gam) * c.Wr[0];
      for (int k = 1; k < c.rows; ++k) F += keep(c.bounce & c.rub, c.time * c.b[k - 1]) * c.Wr[k];
      ip.add_wrench(w.groups[g].group, F, w.shift);
      late = true;
    }
  if (!late) return;
  solve(w.free_factor, m.nv, m.mass, w.shift);
}

// Next velocity, and the tangent displacement of one step, from where its rows are.
template <class G>
static void displacement(const Model& m, const Options& o, Work<G>& w) {
  if (o.split) damped_away(m, w, w.shift);
  for (int i = 0; i < m.nv; ++i) w.vstep[i] = o.split ? w.vn[i] - w.shift[i] : w.vn[i];
  late_shift(m, o, w);
  for (int i = 0; i < m.nv; ++i) w.qtan[i] = (o.h - w.flown) * w.vstep[i] - w.shift[i];
}

}  // namespace cmbrl::CMBRL_ISA
