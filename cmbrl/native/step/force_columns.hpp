// What the named parameters of bodies, lines and actuators do to a step: entries of the physical vector P that they move.
#pragma once
#include "step/derivative.hpp"
#include "dynamics/inertia_change.hpp"

namespace cmbrl::CMBRL_ISA {

// Of the step's equation; of the same without rows, for a free velocity; or of that of late impulses, M~ shift = sum t_i J_i^T x_i
// (impact.hpp): its rows, its left side, which split damping has too; of one of the biases of implicit Coriolis forces (gyro.hpp).
enum class Part { step, free, late_rows, late_inertia, gyroscopic };

template <class G>
struct ForceColumns {
  const Model& m;
  const Options& o;
  Work<G>& w;
  T* out;      // nv values, stride
  int stride;
  Part part;
  T& at(int dof) { return out[dof * stride]; }
  bool forces() const { return part == Part::step || part == Part::free; }
  double inertial() const { return forces() ? o.h : part == Part::gyroscopic ? o.h * w.gyro_weight : 1; }

  void compensation(int b, const Inertia<G>& dI) {
    if (!forces() || m.body_lift[b] == 0) return;
    double share = m.body_lift[b] * o.h;
    Vec<G::N> f = lift<G>(share * dI.m, share * (dI.h + dI.m * lift_point(m, w, b)), upwards(m, w));
    for (int d = m.body_lastdof[b]; d >= 0; d = m.above(d)) at(d) += keep(lifted(m, w, d), dot(w.S[d], f));
  }
  void body(int b, const Inertia<G>& dI) {  // inverse dynamics is linear in the inertia
    if (m.nlift > 0) compensation(b, dI);
    bool ahead = forces() && w.ahead;
    const Vec<G::N> &acc = (ahead ? w.bacc : w.acc)[b], &vel = (ahead ? w.bvel : w.vel)[b];
    Vec<G::N> f = dI * acc + cross_force<G>(vel, dI * vel);
    double scale = inertial();
    for (int d = m.body_lastdof[b]; d >= 0; d = m.above(d)) at(d) -= scale * dot(w.S[d], f);
  }

  // Parameter k of a shape, or the mass that it goes with.
  void shape(int k) {
    T world[G::SYM];
    if (!shape_change(m, w, k, world)) return;
    int b = m.shape_body[m.par_shape[k]];
    bool ahead = forces() && w.ahead;
    auto turn = ang<G>((ahead ? w.bvel : w.vel)[b]), acceleration = ang<G>((ahead ? w.bacc : w.acc)[b]);
    auto moment = G::sym_mul(world, acceleration) + G::cross_ang(turn, G::sym_mul(world, turn));  // as body(), without mass
    T scale = splat(inertial());
    for (int d = m.body_lastdof[b]; d >= 0; d = m.above(d)) at(d) -= scale * dot(ang<G>(w.S[d]), moment);
  }

  void add_along(int line, T x) {
    for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k) at(m.line_dof[k]) += w.line_c[k] * x;
  }
  void add_eased(int line, T x) {  // of what damps in M~
    for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k)
      at(m.line_dof[k]) += w.line_c[k] * x * (o.split ? chain_rate(m, w, line, k, w.eased) : along(m, w, line, w.eased));
  }
  void dry(int i, int field, double coef) {
    if (part != Part::step) return;
    FrictionLimit f = friction_limit(m, w, i, field != kFrictionloss);
    T by = field == kFrictionloss ? splat(1) : field == kFrictionSlope ? f.place : field == kStribeck ? f.fade : f.by_speed;
    by *= coef * o.h;
    for (int k = 0; k < w.ndry; ++k)
      if (w.dry[k].line == i) add_along(i, by * impulse_by_limit(w.dry[k], o.backward.dry));
    Mask none = f.limit == 0.0;
    if (any(none)) add_along(i, keep(none, by * impulse_by_limit_at_zero(m, w, i, o.h, o.backward.dry)));
  }
  void line(int i, int field, double coef) {
    bool late = part == Part::late_inertia;
    if (late && field != kArmature && (field != kDamping || !damps_implicitly(m, i))) return;
    if (late && field == kDamping) return add_eased(i, splat(-coef * o.h));
    T before = late ? T{} : along(m, w, i, w.v), after = along(m, w, i, late ? w.shift : w.vn);
    Spring spring = spring_of(m, w, i);
    switch (field) {
      case kArmature: add_along(i, -coef * (after - before)); break;
      case kDamping: add_along(i, -coef * o.h * (damps_implicitly(m, i) && !o.apart() ? after : before)); break;
      case kStiffness: {
        if (i < m.nv && m.dof_qadr[i] < 0 && m.nballspring > 0) spring.stretch = w.stretch[i];
        Mask stretched = spring.stiffness != 0.0;
        if (o.implicit_springs) spring.stretch += keep(stretched, o.h * after);
        add_along(i, -coef * o.h * spring.stretch);
        break;
      }
      case kSpringref: add_along(i, coef * o.h * spring.stiffness); break;
      default: dry(i, field, coef);
    }
  }

  void wide(int a, int field, double coef) {
    const T* p = w.P + m.oAct + a * kActuatorFields;
    if (!forces() || (field != kGear && field != kGain && field != kBias0 && field != kTime)) return;
    int k = 0;
    while (m.wide_act[k] != a) ++k;
    Drive drive = wide_drive(m, w, a);
    const Input& input = drive.input;
    T push = field == kGear ? drive.force : keep(drive.free, p[kGear]);
    if (field == kGain || field == kTime) push *= field == kGain ? input.value : p[kGain] * input.by_time;
    for_arms(m, w, k, [&](int d, T arm) { at(d) += keep(w.yields[d], coef * o.h * arm * push); });
  }

  // M~ keeps the velocity gains of a joint that clamps its actuators, and their force does not change there.
  void actuator(int a, int field, double coef) {
    const T* p = w.P + m.oAct + a * kActuatorFields;
    int line = m.act_line[a];
    if (line < 0) return wide(a, field, coef);
    T q = w.line_length[line], v = along(m, w, line, w.v), after = along(m, w, line, w.vn);
    T dv = m.implicit_gains && !o.apart() ? after - v : T{}, g = p[kGear];
    Input input = input_of(m, w, a);
    Servo s = servo_of(m, w, a, input, q, v);
    T stiff = s.gains.stiff, drag = s.gains.drag;
    T by_time = m.act_gain[2 * a + 1] * input.by_time;  // of a velocity gain that follows the activation
    Mask free = s.free, pulls = s.free & s.pulls, fades = s.fades;
    T spring = o.implicit_springs ? o.h * after : T{};
    T own = keep(pulls, stiff * (s.place + 2.0 * spring)) + keep(free, drag * (v + 2.0 * dv));  // of a free force, by the gear
    own += s.ripple * (q + 2.0 * spring) - keep(fades, p[kLimitSlope] * (v + 2.0 * dv));
    if (part == Part::late_inertia) {
      if (!m.implicit_gains) return;
      if (field == kGear) add_eased(line, coef * o.h * 2.0 * g * (keep(free, drag) - keep(fades, p[kLimitSlope])));
      if (field == kBias2) add_eased(line, keep(free, coef * o.h * g * g));
      if (field == kTime) add_eased(line, keep(free, coef * o.h * g * g * by_time));
      if (field == kLimitSlope) add_eased(line, -keep(fades, coef * o.h * g * g));
      return;
    }
    T r, held = T{};  // held: through M~ alone
    if (field == kGear) held = 2.0 * g * (keep(free, drag * dv) - keep(fades, p[kLimitSlope] * dv));
    if (field == kBias2) held = keep(free, g * g * dv);
    if (field == kTime) held = keep(free, g * g * by_time * dv);
    if (field == kLimitSlope) held = -keep(fades, g * g * dv);
    if (line >= m.nv && field == kGear) held += 2.0 * g * (keep(pulls, stiff) + s.ripple) * spring;
    if (line >= m.nv && field == kBias1) held = keep(pulls, g * g * spring);
    switch (field) {
      case kGear: r = s.force + g * own; break;
      case kGain: r = keep(pulls, g * s.input); break;
      case kTime: r = keep(pulls, g * s.gains.input * input.by_time) + held; break;
      case kBias0: r = keep(pulls, g); break;
      case kBias1: r = keep(pulls, g * g * (s.place + spring)); break;
      case kLimit: r = g * s.limited; break;
      case kLimitSlope: r = -keep(fades, g * g * (v + dv)); break;
      case kGap: r = -keep(pulls, s.side * vmax(g * stiff, -g * stiff) * g); break;
      default: r = keep(free, g * g * (v + dv));
    }
    for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k)
      at(m.line_dof[k]) += coef * o.h * w.line_c[k] * select(w.yields[m.line_dof[k]], r, held);
  }

  void gravity(int axis, double coef) {
    if (!forces()) return;
    Vec<G::N> fall = zero<G::N>();
    fall[G::A + axis] = splat(coef * o.h);
    for (int i = 0; i < m.nv; ++i) at(i) += dot(w.S[i], w.Ic[m.dof_body[i]] * fall);
    if (m.nlift == 0) return;
    typename G::V down = lin<G>(fall);
    for (int i = 0; i < m.nv; ++i) {
      int b = m.dof_body[i];
      at(i) -= keep(lifted(m, w, i), dot(w.S[i], lift<G>(w.lift_mass[b], w.lift_moment[b], down)));
    }
  }
};

}  // namespace cmbrl::CMBRL_ISA
