// What acts in a step: forces along lines, what of them is implicit, and the rows of contacts, limits and dry friction.
#pragma once
#include "collision/candidates.hpp"
#include "dynamics/dry_friction.hpp"
#include "dynamics/fluid.hpp"
#include "collision/glide.hpp"
#include "dynamics/gravcomp.hpp"
#include "dynamics/gyro.hpp"
#include "dynamics/servo.hpp"
#include "solver/split.hpp"
#include "dynamics/springs.hpp"
#include "step/ties.hpp"
#include "step/wide.hpp"

namespace cmbrl::CMBRL_ISA {

// f(line, entry of its covector) of the lines that pull at a dof: its own, and tendons.
template <class F>
static void for_lines_of(const Model& m, int dof, F f) {
  f(dof, m.line_ptr[dof]);
  for (int line = m.nv; line < m.nline; ++line)
    for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k)
      if (m.line_dof[k] == dof) f(line, k);
}

// Clamps the sum of the actuators of a joint, by a force of its own. Their velocity gains stay in M~, as in MuJoCo; the force
// does not change.
template <class G>
static void clamp_joint_forces(const Model& m, Work<G>& w) {
  for (int k = 0; k < m.nforcerange; ++k) {
    int d = m.frc_dof[k];
    T lo = splat(m.frc_range[2 * k]), hi = splat(m.frc_range[2 * k + 1]), sum = T{};
    for_lines_of(m, d, [&](int line, int k) { sum += w.line_c[k] * w.drive[line]; });
    w.yields[d] = (sum >= lo) & (sum <= hi);
    w.tau[d] += vmin(vmax(sum, lo), hi) - sum;
    w.drive_kp[d] = keep(w.yields[d], w.drive_kp[d]);
  }
}

// What the actuators' gains are in the rows of joints that clamp them: nothing.
template <class G>
static void clamped_rows(const Model& m, const Work<G>& w, double h, T* Gq, T* Gv) {
  for (int k = 0; k < m.nforcerange; ++k) {
    int d = m.frc_dof[k];
    Mask clamped = ~w.yields[d];
    for_lines_of(m, d, [&](int line, int own) {
      T by_q = keep(clamped, h * w.line_c[own] * w.drive_kp[line]), by_v = keep(clamped, h * w.line_c[own] * w.kd[line]);
      for (int e = m.line_ptr[line]; e < m.line_ptr[line + 1]; ++e) {
        T& q = Gq[d * m.nv + m.line_dof[e]];
        q += slope_of_length(m, w, e) * by_q;
        Gv[d * m.nv + m.line_dof[e]] += w.line_c[e] * by_v;
        if (!bends(m, line)) continue;
        q += by_v * bent_rate(m, w, line, e, splat(1), w.v, T{}, w.v);
        q -= keep(clamped, h * w.drive[line] * bend_of(m, w, line, own, e));
      }
    });
  }
}

// Of the actuators along the lines: force into drive, gains by velocity, position and control into kd, drive_kp and open.
template <class G>
static void actuator_forces(const Model& m, const Options& o, Work<G>& w) {
  if (m.nstate > 0) advance_inputs(m, o, w);
  for (int i = 0; i < m.nline; ++i) w.drive[i] = w.kd[i] = w.drive_kp[i] = T{};
  for (int i = 0; i < m.nv; ++i) w.yields[i] = all();
  for (int a = 0; a < m.nact; ++a) {
    const T* p = w.P + m.oAct + a * kActuatorFields;
    int line = m.act_line[a];
    if (line < 0) continue;
    Input input = input_of(m, w, a);
    Servo s = servo_of(m, w, a, input, w.line_length[line], along(m, w, line, w.v));
    w.drive[line] += p[kGear] * s.force;
    w.kd[line] -= keep(s.free, p[kGear] * p[kGear] * s.gains.drag) - keep(s.fades, p[kGear] * p[kGear] * p[kLimitSlope]);
    w.drive_kp[line] -= p[kGear] * p[kGear] * (keep(s.free & s.pulls, s.gains.stiff) + s.ripple);
    note_gain(m, w, a, input, s.gains.input, s.free & s.pulls);
  }
  wide_forces(m, o, w);
  if (m.nlift > 0) {
    gravity_compensation(m, w);
    for (int i = 0; i < m.nv; ++i) if (m.dof_lift[i] == kActuatorLift) w.drive[i] += w.lift[i];
  }
}

// Adds what a change of the controls does to the velocity gains in M~ (or D) that change with them, times -x, by h.
template <class G>
static void gain_terms(const Model& m, const Options& o, const Work<G>& w, const T* x, T* Gu) {
  if (!m.implicit_gains || o.rk4) return;
  for (int a = 0; a < m.nact; ++a) {
    int line = m.act_line[a];
    if (line < 0 || m.act_gain[2 * a + 1] == 0) continue;
    const T* p = w.P + m.oAct + a * kActuatorFields;
    Input input = input_of(m, w, a);
    Servo s = servo_of(m, w, a, input, w.line_length[line], along(m, w, line, w.v));
    T by = keep(s.free, (o.h * m.act_gain[2 * a + 1]) * (p[kGear] * p[kGear]));
    for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k) {
      T change = w.line_c[k] * by * (o.split ? chain_rate(m, w, line, k, x) : along(m, w, line, x)), *row = Gu + m.line_dof[k] * m.nu;
      row[a] += change * input.by_command;
      if (m.nstate > 0 && m.act_state[a] >= 0) row[m.nact + m.act_state[a]] += change * input.by_activation;
    }
  }
}

// Pulls along the lines, and what of them is taken implicitly: M~ = M + armature + h (D [+ kd]) [+ h^2 (K + kp)].
template <class G>
static void line_forces(const Model& m, const Options& o, Work<G>& w) {
  for (int i = 0; o.split && i < m.mass.row(m.nv); ++i) w.D[i] = T{};
  actuator_forces(m, o, w);
  for (int i = 0; i < m.nline; ++i) w.tau[i] = w.drive[i];
  clamp_joint_forces(m, w);
  for (int i = 0; i < m.nline; ++i) {
    Spring spring = spring_of(m, w, i);
    w.kp[i] = w.drive_kp[i] + spring.stiffness;
    w.tau[i] -= w.P[m.oDof + i * kDofFields + kDamping] * along(m, w, i, w.v) + spring.stiffness * spring.stretch;
  }
  for (int i = 0; i < m.nv && m.nlift > 0; ++i) if (m.dof_lift[i] == kPassiveLift) w.tau[i] += w.lift[i];
  ball_springs(m, w);
  power_forces(m, o, w);
  if (m.in_fluid()) fluid_forces(m, o, w);
  for (int i = 0; i < m.nv; ++i) w.rhs[i] = -o.h * w.bias[i];
  for (int i = 0; i < m.nline; ++i) {
    const T* p = w.P + m.oDof + i * kDofFields;
    T pull = o.h * w.tau[i], mass = p[kArmature];
    T damping = implicit_damping(m, o, w, i);
    if (o.split) add_drag(m, w, i, damping);
    else mass += damping;
    if (o.implicit_springs) {
      mass += o.h * o.h * w.kp[i];
      pull -= o.h * o.h * w.kp[i] * along(m, w, i, w.v);
    }
    w.line_pull[i] = pull;
    w.line_mass[i] = mass;
    add_pull(m, w, i, pull, w.rhs);
    add_square(m, w, i, mass, w.M, m.mass);
  }
}

// The nearer limit of a line: how far it is, and how that changes.
template <class G>
static T line_limit(const Model& m, const Work<G>& w, int i, Direction& d) {
  int line = m.lim_line[i];
  T x = w.line_length[line], wider = w.P[m.oDof + line * kDofFields + kWider];
  T below = x - m.lim_lo[i] + wider, above = m.lim_hi[i] - x + wider;
  Mask lower = below < above;
  d.line = line;
  d.round = false;
  d.sign = select(lower, splat(1), splat(-1));
  return select(lower, below, above);
}

// The law of a limit at a distance phi, with its time constant, damping ratio and softness that many times those of the file: as
// MuJoCo's solreflimit has them, whether it is written as a time constant or, below 0, as a stiffness.
template <class G>
static Law stop_law(const Model& m, const Options& o, const Work<G>& w, int i, T phi, const T* scale) {
  const double* s = m.lim_soft + 7 * i;
  T time = scale[0], damping = scale[1];
  T ref0 = s[0] > 0 ? s[0] * time : s[0] / (time * time * damping * damping);
  T ref1 = s[0] > 0 ? s[1] * damping : s[1] / time;
  return soft_law(phi, m.lim_margin[i], o.h, m.least_time(o.h), ref0, ref1, splat(s[2]), splat(s[3]), splat(s[4]), s[5], s[6],
                  m.lim_invweight[i] * weight_of(w, m.lim_weight[i]) * scale[2]);
}

template <class G>
static void find_limits(const Model& m, const Options& o, Work<G>& w, const Mask* given) {
  bool prune = o.prune < 1e300 && !given;
  w.nlim = w.ndry = w.nleft_lim = 0;
  for (int i = 0; i < m.nlimit; ++i) {
    Direction way;
    T phi = m.lim_ball[i] < 0 ? line_limit(m, w, i, way) : ball_limit(m, w, i, way);
    T speed = along(m, w, way, w.v), slack = (phi - m.lim_margin[i]) * (1 / o.h) - vabs(speed);
    Mask acts = given ? given[i] : o.look_ahead ? all() : phi < m.lim_margin[i], on = acts, wide = acts;
    if (!any(acts)) continue;
    double enough = speed_that_matters(o, o.forward, m.lim_invweight[i]), most = speed_that_matters(o, o.backward, m.lim_invweight[i]);
    T closing = speed;
    for (int k = 0; k < w.nguess; ++k) closing = vmin(closing, along(m, w, way, w.guess + k * m.nv));
    if (prune) on = wide = acts & (slack + vmin(closing, -vabs(speed)) < __builtin_fmax(enough, most));
    Limit& l = w.lim[w.nlim];
    if (any(on)) {
      Law L = stop_law(m, o, w, i, phi, w.P + m.oDof + way.line * kDofFields + kStopTime);
      static_cast<Direction&>(l) = way;
      l.index = i;
      l.root = vsqrt(m.lim_invweight[i] + L.R);
      l.phi = phi; l.R = L.R; l.dR_dphi = L.dR; l.carry = L.carry; l.dc_dphi = L.dc0;
      l.c0 = L.c0 - L.carry * speed;
      slack = select(on, l.c0, slack);
      if (prune) { on &= slack + closing < enough; wide &= slack + closing < most; }
    }
    if (Mask left = acts & ~on; prune && any(left)) w.left_lim[w.nleft_lim++] = {left, way, slack, enough};
    if (!any(on | wide)) continue;
    l.on = on;
    l.wide = wide;
    ++w.nlim;
  }
  for (int i = 0; i < m.nline; ++i) {
    T loss = friction_limit(m, w, i).limit;
    Mask on = loss > 0.0;
    if (!any(on)) continue;
    const double* s = m.line_soft + 7 * i;
    Law L = soft_law(T{}, 0, o.h, m.least_time(o.h), splat(s[0]), splat(s[1]), splat(s[2]), splat(s[3]), splat(s[4]), s[5], s[6],
                     m.line_invweight[i] * weight_of(w, m.line_weight[i]));
    DryFriction& d = w.dry[w.ndry++];
    d.on = on; d.line = i; d.R = L.R; d.carry = L.carry;
    d.b0 = select(on, o.h * loss, splat(1));
    d.ib0 = 1.0 / d.b0;
    d.root = vsqrt(m.line_invweight[i] + L.R);
    d.c0 = -L.carry * along(m, w, i, w.v);
  }
}

// The factor of M~, and the velocity without rows.
template <class G>
static void free_velocity(const Model& m, Work<G>& w) {
  T* H = w.free_factor;
  for (int i = 0; i < m.mass.row(m.nv); ++i) H[i] = w.M[i];
  factorise<true>(H, m.mass, m.nv);
  for (int i = 0; i < m.nv; ++i) w.vf[i] = w.rhs[i];
  solve(H, m.nv, m.mass, w.vf);
  for (int i = 0; i < m.nv; ++i) w.vf[i] += w.v[i];
}

// Rows are left out by it first: forces may well change the velocity at the start by more than they may. And by what an earlier
// attempt has led to.
template <class G>
static void guess_velocities(const Model& m, Work<G>& w) {
  auto guess = [&](int k, const T* v) {
    std::memcpy(w.guess + k * m.nv, v, m.nv * sizeof(T));
    twists_under(m, w, w.guess + k * m.nv, w.guess_twist + k * m.nbody);
    if (w.nguess == k) ++w.nguess;
  };
  guess(0, w.vf);
  if (w.tried && w.nguess == 1) guess(1, w.tried);
}

// Kinematics, forces, M~ and active rows at (q, v, u) in w; given: lanes of each limit, and w.given the contacts, of a step read
// back from its tape.
template <class G>
static void prepare(const Model& m, const Options& o, Work<G>& w, const Mask* given = nullptr) {
  kinematics(m, w, w.q);
  find_lines(m, w);
  inertias(m, w);
  inverse_dynamics<G>(m, w, w.v, nullptr, w.bias);
  mass_matrix(m, w);
  line_forces(m, o, w);
  if (gyroscopic(m, o)) add_gyroscopic(m, o, w);
  if (o.split) split_factor(m, w);
  tie_forces(m, o, w);
  free_velocity(m, w);
  if (o.prune < 1e300 && !given && m.ncontact + m.nlimit > 0) guess_velocities(m, w);
  find_contacts(m, o, w, given != nullptr);
  find_limits(m, o, w, given);
  w.make_rows(m);
  for (int i = 0; i < w.ncon; ++i) {
    Contact<G>& c = w.con[i];
    Vec<G::N> t = relative_twist<G>(m, w.vel, c.index);
    c.cn0 -= c.carry * dot(c.Wr[0], t);
    for (int r = 1; r < c.rows; ++r) c.ct0[r - 1] = -c.carry * dot(c.Wr[r], t);
    if (glides(m, c)) {
      t = (1.0 - c.carry) * glide_of(m, w, c);
      c.cn0 += dot(c.Wr[0], t);  // of an edge
      for (int r = 1; r < c.rows; ++r) c.ct0[r - 1] += dot(c.Wr[r], t);
    }
    c.bounce = none();
    c.time = T{};
  }
}

}  // namespace cmbrl::CMBRL_ISA
