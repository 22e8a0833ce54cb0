// Actuators with a state of first order. The inputs u of a control step are the commands of all actuators, which are held, then
// the activations at its start; those at a substep follow from both, so that no state has to be carried along.
#pragma once
#include <cmath>

#include "dynamics/stages.hpp"
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

struct Share { T value, by_time; };  // of the way to the command that a filter goes in a step h, and its slope in the time constant

static inline Share share_of(int kind, double h, T time) {
  time = vmax(time, splat(1e-15));
  T rate = h / time;
  if (kind == kFilter) return {rate, -rate / time};
  T left;
  for (int lane = 0; lane < W; ++lane) left[lane] = std::exp(-rate[lane]);
  return {splat(1) - left, -left * rate / time};
}

// The same at a stage of a Runge-Kutta step, or (stage kStages) at its end, where MuJoCo takes the mean rate of the stages.
static inline Share share_at(int stage, int kind, double h, T time) {
  time = vmax(time, splat(1e-15));
  T rate = h / time, way = T{}, slope = T{}, rest = splat(kStageWeight[0]), by_rate = T{};  // slope: of the way in the rate
  for (int k = 1; k < (stage < kStages ? stage + 1 : kStages); ++k) {
    T left = 1.0 - way;
    slope = kStageAt[k] * (left - rate * slope);
    way = kStageAt[k] * rate * left;
    rest += kStageWeight[k] * (1.0 - way);
    by_rate -= kStageWeight[k] * slope;
  }
  if (stage == kStages && kind == kFilterExact) {
    Share exact = share_of(kind, h, time);
    return {rest * exact.value, rest * exact.by_time - exact.value * by_rate * rate / time};
  }
  if (stage == kStages) { way = rate * rest; slope = rest + rate * by_rate; }
  return {way, -slope * rate / time};
}

// What the gain of each of these actuators multiplies at this substep: the activation, or with `early` the next one. Steps that
// are shifted by half take the mean of both.
template <class G>
static void advance_inputs(const Model& m, const Options& o, Work<G>& w) {
  for (int k = 0; k < m.nstate; ++k) {
    int a = m.state_act[k];
    T lo = splat(m.act_ctrl[2 * a]), hi = splat(m.act_ctrl[2 * a + 1]);
    T least = splat(m.state_range[2 * k]), most = splat(m.state_range[2 * k + 1]);
    T command = vmin(vmax(w.u[a], lo), hi), told = keep((w.u[a] >= lo) & (w.u[a] <= hi), splat(1));
    int kind = m.state_kind[k], stage = o.rk4 ? w.substep % kStages : 0;
    T time = w.P[m.oAct + a * kActuatorFields + kTime];
    Share euler = share_of(kind == kFilterRk4 && o.rk4 ? kFilter : kind, o.h, time), whole = o.rk4 ? share_at(kStages, kind, o.h, time) : euler;
    auto move = [&](Input x, const Share& share, double h) {
      if (kind == kIntegrator) {
        x.value += h * command;
        x.by_command += h * told;
      } else {
        T way = command - x.value;
        x = {x.value + share.value * way, x.by_command + share.value * (told - x.by_command),
             x.by_activation - share.value * x.by_activation, x.by_time + share.by_time * way - share.value * x.by_time};
      }
      return x;
    };
    auto next = [&](Input x, const Share& share) {
      x = move(x, share, o.h);
      Mask in = (x.value >= least) & (x.value <= most);
      return Input{vmin(vmax(x.value, least), most), keep(in, x.by_command), keep(in, x.by_activation), keep(in, x.by_time)};
    };
    Input x{w.u[m.nact + k], T{}, splat(1), T{}};
    for (int s = 0; s < (o.rk4 ? w.substep / kStages : w.substep); ++s) x = next(x, whole);
    if (stage > 0) x = move(x, share_at(stage, kind, o.h, time), kStageAt[stage] * o.h);  // not within its limits, as in MuJoCo
    if (m.state_early[k]) x = next(x, euler);
    if (o.leapfrog && !m.state_early[k]) {
      Input y = next(x, whole);
      x = {0.5 * (x.value + y.value), 0.5 * (x.by_command + y.by_command), 0.5 * (x.by_activation + y.by_activation),
           0.5 * (x.by_time + y.by_time)};
    }
    w.inputs[k] = x;
  }
}

// Of any actuator: its command within bounds, or what its activation gives.
template <class G>
static inline Input input_of(const Model& m, const Work<G>& w, int a) {
  if (m.nstate > 0 && m.act_state[a] >= 0) return w.inputs[m.act_state[a]];
  T lo = splat(m.act_ctrl[2 * a]), hi = splat(m.act_ctrl[2 * a + 1]);
  return {vmin(vmax(w.u[a], lo), hi), keep((w.u[a] >= lo) & (w.u[a] <= hi), splat(1)), T{}, T{}};
}

// f(control, what it adds to the force of actuator a, how that changes with the control) of its further controls.
template <class G, class F>
static inline void for_feeds(const Model& m, const Work<G>& w, int a, F f) {
  for (int e = m.feed_ptr[a]; e < m.feed_ptr[a + 1]; ++e) {
    int c = m.feed_act[e];
    T lo = splat(m.act_ctrl[2 * c]), hi = splat(m.act_ctrl[2 * c + 1]), gain = w.P[m.oAct + c * kActuatorFields + kGain];
    f(c, gain * vmin(vmax(w.u[c], lo), hi), keep((w.u[c] >= lo) & (w.u[c] <= hi), gain));
  }
}

// Notes how the force of an actuator changes with its command, and with its activation.
template <class G>
static inline void note_gain(const Model& m, Work<G>& w, int a, const Input& x, T by_input, Mask free) {
  T gain = keep(free, w.P[m.oAct + a * kActuatorFields + kGear] * by_input);
  w.open[a] = gain * x.by_command;
  if (m.nfeed > 0) for_feeds(m, w, a, [&](int c, T, T by) { w.open[c] = keep(free, w.P[m.oAct + a * kActuatorFields + kGear] * by); });
  if (m.nstate > 0 && m.act_state[a] >= 0) w.open[m.nact + m.act_state[a]] = gain * x.by_activation;
}

// Adds the derivatives of a force that changes by `by` with the actuator's own: a row of those in u.
template <class G>
static inline void add_inputs(const Model& m, const Work<G>& w, int a, T by, Mask yields, T* row) {
  row[a] += keep(yields, by * w.open[a]);
  if (m.nfeed > 0) for (int e = m.feed_ptr[a]; e < m.feed_ptr[a + 1]; ++e) row[m.feed_act[e]] += keep(yields, by * w.open[m.feed_act[e]]);
  if (m.nstate > 0 && m.act_state[a] >= 0) row[m.nact + m.act_state[a]] += keep(yields, by * w.open[m.nact + m.act_state[a]]);
}

}  // namespace cmbrl::CMBRL_ISA
