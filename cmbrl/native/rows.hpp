// What acts in a step: joint forces, what of them is implicit, and the rows of contacts, limits and dry friction.
#pragma once
#include "candidates.hpp"
#include "fluid.hpp"
#include "gravcomp.hpp"
#include "springs.hpp"
#include "wide.hpp"

namespace cmbrl::CMBRL_ISA {

// Clamps the sum of the actuators of a joint. Their velocity gains stay in M~, as in MuJoCo; the force does not change.
template <class G>
static void clamp_joint_forces(const Model& m, Work<G>& w) {
  for (int k = 0; k < m.nforcerange; ++k) {
    int d = m.frc_dof[k];
    T lo = splat(m.frc_range[2 * k]), hi = splat(m.frc_range[2 * k + 1]);
    w.yields[d] = (w.tau[d] >= lo) & (w.tau[d] <= hi);
    w.tau[d] = vmin(vmax(w.tau[d], lo), hi);
    w.kp[d] = keep(w.yields[d], w.kp[d]);
  }
  for (int a = 0; a < m.nact && m.nforcerange > 0; ++a)
    if (m.act_dof[a] >= 0) w.open[a] = keep(w.yields[m.act_dof[a]], w.open[a]);
}

// Into tau; and their gains kd, kp and open, by velocity, position and control.
template <class G>
static void actuator_forces(const Model& m, Work<G>& w) {
  for (int i = 0; i < m.nv; ++i) {
    w.tau[i] = w.kd[i] = w.kp[i] = T{};
    w.yields[i] = all();
  }
  for (int a = 0; a < m.nact; ++a) {
    const T* p = w.P + m.oAct + a * kActuatorFields;
    int d = m.act_dof[a];
    if (d < 0) continue;
    T lo = splat(m.act_ctrl[2 * a]), hi = splat(m.act_ctrl[2 * a + 1]);
    T flo = splat(m.act_force[2 * a]), fhi = splat(m.act_force[2 * a + 1]);
    T ctrl = vmin(vmax(w.u[a], lo), hi);
    T force = p[kGain] * ctrl + p[kBias0] + p[kGear] * (p[kBias1] * w.q[m.act_qadr[a]] + p[kBias2] * w.v[d]);
    Mask free = (force >= flo) & (force <= fhi);
    w.tau[d] += p[kGear] * vmin(vmax(force, flo), fhi);
    w.kd[d] -= keep(free, p[kGear] * p[kGear] * p[kBias2]);
    w.kp[d] -= keep(free, p[kGear] * p[kGear] * p[kBias1]);
    w.open[a] = keep(free & (w.u[a] >= lo) & (w.u[a] <= hi), p[kGear] * p[kGain]);
  }
  wide_forces(m, w);
  if (m.nlift > 0) {
    gravity_compensation(m, w);
    for (int i = 0; i < m.nv; ++i) if (m.dof_lift[i] == kActuatorLift) w.tau[i] += w.lift[i];
  }
  clamp_joint_forces(m, w);
}

// tau, and what of the joint forces is taken implicitly: M~ = M + armature + h (D [+ kd]) [+ h^2 (K + kp)].
template <class G>
static void joint_forces(const Model& m, const Options& o, Work<G>& w) {
  actuator_forces(m, w);
  ball_springs(m, w);
  power_forces(m, o, w);
  if (m.nbox > 0) fluid_forces(m, o, w);
  for (int i = 0; i < m.nv; ++i) {
    const T* p = w.P + m.oDof + i * kDofFields;
    w.tau[i] -= p[kDamping] * w.v[i];
    if (m.dof_qadr[i] >= 0) w.tau[i] -= p[kStiffness] * (w.q[m.dof_qadr[i]] - p[kSpringref]);
    if (m.nlift > 0 && m.dof_lift[i] == kPassiveLift) w.tau[i] += w.lift[i];
    T spring = w.kp[i] + (m.dof_qadr[i] >= 0 ? p[kStiffness] : T{});
    w.kp[i] = spring;
    T diag = p[kArmature] + o.h * (m.implicit_gains ? p[kDamping] + w.kd[i] : p[kDamping]);
    w.rhs[i] = o.h * (w.tau[i] - w.bias[i]);
    if (o.implicit_springs) {
      diag += o.h * o.h * spring;
      w.rhs[i] -= o.h * o.h * spring * w.v[i];
    }
    w.M[m.tree().row(i)] += diag;
  }
}

template <class G>
static void find_limits(const Model& m, const Options& o, Work<G>& w, const Mask* given) {
  bool prune = o.prune < 1e300 && !given;
  w.nlim = w.ndry = w.nleft_lim = 0;
  for (int i = 0; i < m.nlimit; ++i) {
    T q = w.q[m.lim_qadr[i]], below = q - m.lim_lo[i], above = m.lim_hi[i] - q;
    Mask lower = below < above;
    T phi = select(lower, below, above), sign = select(lower, splat(1), splat(-1));
    T speed = sign * w.v[m.lim_dof[i]], slack = phi * (1 / o.h) - vabs(speed);
    Mask on = given ? given[i] : all(), wide = on;
    if (given && !any(on)) continue;
    double enough = speed_that_matters(o, o.forward, m.lim_invweight[i]), most = speed_that_matters(o, o.backward, m.lim_invweight[i]);
    if (prune) on = wide = slack - vabs(speed) < __builtin_fmax(enough, most);
    Limit& l = w.lim[w.nlim];
    if (any(on)) {
      const double* s = m.lim_soft + 7 * i;
      Law L = soft_law(phi, m.lim_margin[i], o.h, splat(s[0]), splat(s[1]), splat(s[2]), splat(s[3]), splat(s[4]), s[5], s[6],
                       splat(m.lim_invweight[i]));
      l.index = i; l.dof = m.lim_dof[i];
      l.root = vsqrt(m.lim_invweight[i] + L.R);
      l.sign = sign; l.phi = phi; l.R = L.R; l.dR_dphi = L.dR; l.carry = L.carry; l.dc_dphi = L.dc0;
      l.c0 = L.c0 - L.carry * speed;
      slack = select(on, l.c0, slack);
      if (prune) { on &= slack + speed < enough; wide &= slack + speed < most; }
    }
    if (Mask left = ~on; prune && any(left)) w.left_lim[w.nleft_lim++] = {left, m.lim_dof[i], sign, slack, enough};
    if (!any(on | wide)) continue;
    l.on = on;
    l.wide = wide;
    ++w.nlim;
  }
  for (int i = 0; i < m.nv; ++i) {
    T loss = w.P[m.oDof + i * kDofFields + kFrictionloss];
    Mask on = loss > 0.0;
    if (!any(on)) continue;
    const double* s = m.dof_soft + 7 * i;
    Law L = soft_law(T{}, 0, o.h, splat(s[0]), splat(s[1]), splat(s[2]), splat(s[3]), splat(s[4]), s[5], s[6], splat(m.dof_invweight[i]));
    DryFriction& d = w.dry[w.ndry++];
    d.on = on; d.dof = i; d.R = L.R; d.carry = L.carry;
    d.b0 = select(on, o.h * loss, splat(1));
    d.root = vsqrt(m.dof_invweight[i] + L.R);
    d.c0 = -L.carry * w.v[i];
  }
}

template <class G>
static Vec<G::N> relative_twist(const Model& m, const Vec<G::N>* twist, int index) {
  Vec<G::N> t = twist[m.con_bodyA[index]];
  if (m.con_bodyB[index] >= 0) t -= twist[m.con_bodyB[index]];
  return t;
}

// Kinematics, forces, M~ and active rows at (q, v, u) in w; given_*: the rows of a step read back from its tape.
template <class G>
static void prepare(const Model& m, const Options& o, Work<G>& w, const Mask* given_contacts = nullptr, const Mask* given_limits = nullptr) {
  kinematics(m, w, w.q);
  inertias(m, w);
  inverse_dynamics<G>(m, w, w.v, nullptr, w.bias);
  mass_matrix(m, w);
  joint_forces(m, o, w);
  find_contacts(m, o, w, given_contacts);
  find_limits(m, o, w, given_limits);
  w.make_rows(m);
  for (int i = 0; i < w.ncon; ++i) {
    Contact<G>& c = w.con[i];
    Vec<G::N> t = relative_twist<G>(m, w.vel, c.index);
    c.cn0 -= c.carry * dot(c.Wr[0], t);
    for (int r = 1; r < c.rows; ++r) c.ct0[r - 1] = -c.carry * dot(c.Wr[r], t);
    c.bounce = none();
    c.time = T{};
  }
}

}  // namespace cmbrl::CMBRL_ISA
