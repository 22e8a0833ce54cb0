// What acts in a step: joint forces, what of them is implicit, and the rows of contacts, limits and dry friction.
#pragma once
#include "contact.hpp"

namespace cmbrl::CMBRL_ISA {

// tau, and what of the joint forces is taken implicitly: M~ = M + armature + h (D [+ kd]) [+ h^2 (K + kp)].
template <class G>
static void joint_forces(const Model& m, const Options& o, Work<G>& w) {
  for (int i = 0; i < m.nv; ++i) {
    const T* p = w.P + m.oDof + i * kDofFields;
    w.kd[i] = w.kp[i] = T{};
    w.tau[i] = -p[kDamping] * w.v[i];
    if (m.dof_qadr[i] >= 0) w.tau[i] -= p[kStiffness] * (w.q[m.dof_qadr[i]] - p[kSpringref]);
  }
  for (int a = 0; a < m.nact; ++a) {
    const T* p = w.P + m.oAct + a * kActuatorFields;
    int d = m.act_dof[a];
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
  for (int i = 0; i < m.nv; ++i) {
    const T* p = w.P + m.oDof + i * kDofFields;
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
  bool keep_all = !(o.prune < 1e300);
  w.nlim = w.ndry = 0;
  for (int i = 0; i < m.nlimit; ++i) {
    T q = w.q[m.lim_qadr[i]], below = q - m.lim_lo[i], above = m.lim_hi[i] - q;
    Mask lower = below < above;
    T phi = select(lower, below, above), sign = select(lower, splat(1), splat(-1));
    Mask on = given ? given[i] : all();
    if (given && !any(on)) continue;
    if (!keep_all && !given) {
      on = phi * (1 / o.h) + sign * w.v[m.lim_dof[i]] < o.prune;
      if (!any(on)) continue;
    }
    const double* s = m.lim_soft + 7 * i;
    Law L = soft_law(phi, m.lim_margin[i], o.h, splat(s[0]), splat(s[1]), splat(s[2]), splat(s[3]), splat(s[4]), s[5], s[6],
                     splat(m.lim_invweight[i]));
    Limit& l = w.lim[w.nlim++];
    l.on = on; l.index = i; l.dof = m.lim_dof[i];
    l.root = splat(__builtin_sqrt(m.lim_invweight[i]));
    l.sign = sign; l.phi = phi; l.R = L.R; l.dR_dphi = L.dR; l.carry = L.carry; l.dc_dphi = L.dc0;
    l.c0 = L.c0 - L.carry * sign * w.v[l.dof];
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
    d.root = splat(__builtin_sqrt(m.dof_invweight[i]));
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
    c.bounce = c.time = T{};
  }
}

}  // namespace cmbrl::CMBRL_ISA
