// The force of an actuator along a line, before its gear: a gain on its input and on position and velocity, within limits. Backlash
// is a gap in the position's part, which nothing pulls in; the limit falls with the speed that the force drives.
// A gain that changes with length or velocity is one on position or velocity that changes with the input.
#pragma once
#include "dynamics/activation.hpp"

namespace cmbrl::CMBRL_ISA {

// pulls, free, fades: lanes in which the position's part, the whole force, and the limit's fall with speed count. place: of the
// line, less the gap. limited: the direction in which P's limit holds the force, or 0.
struct Gains { T input, stiff, drag; };  // on the input, and on place and speed, times the gear
struct Servo { T force, place, side, limited, input, ripple; Mask pulls, free, fades; Gains gains; };  // ripple: the slope of what limits do not clamp

// What of x, x + period, ... is nearest to `to`: where a rotation is to go.
static inline T wrapped(T x, T to, double period) {
  for (int i = 0; i < W; ++i) x[i] -= period * std::floor((x[i] - to[i]) / period + 0.5);
  return x;
}

template <class G>
static inline Gains gains_of(const Model& m, const Work<G>& w, int a, const Input& input, T place, T speed) {
  const T* p = w.P + m.oAct + a * kActuatorFields;
  double by_length = m.act_gain[2 * a], by_speed = m.act_gain[2 * a + 1];
  return {p[kGain] + p[kGear] * (by_length * place + by_speed * speed), p[kBias1] + by_length * input.value, p[kBias2] + by_speed * input.value};
}

template <class G>
static Servo servo_of(const Model& m, const Work<G>& w, int a, Input input, T place, T speed) {
  const T* p = w.P + m.oAct + a * kActuatorFields;
  if (m.nperiod > 0 && m.act_period[a] > 0) input.value = wrapped(input.value, p[kGear] * place, m.act_period[a]);
  T half = p[kGap], turn = p[kGear] * speed;
  Servo s;
  s.input = input.value;
  s.gains = gains_of(m, w, a, input, place, speed);
  T stiff = s.gains.stiff, drag = s.gains.drag;
  T given = p[kGain] * input.value + p[kBias0];
  if (m.nfeed > 0) for_feeds(m, w, a, [&](int, T value, T) { given += value; });
  T spring = given + p[kGear] * stiff * place;
  T slack = -p[kGear] * stiff * half;  // force of the gap's half
  slack = vmax(slack, -slack);
  s.pulls = (spring >= slack) | (spring <= -slack);
  s.side = select(spring < 0.0, splat(-1), splat(1));
  T force = given + p[kGear] * (stiff * place + drag * speed);
  force -= vmin(vmax(spring, -slack), slack);
  s.place = place + select(p[kGear] * stiff < 0.0, s.side, -s.side) * half;
  T fade = p[kLimitSlope], most = p[kLimit];
  T up = vmax(most - fade * vmax(turn, T{}), T{}), down = vmin(fade * vmax(-turn, T{}) - most, T{});
  T flo = splat(m.act_force[2 * a]), fhi = splat(m.act_force[2 * a + 1]);
  Mask high = (force > vmin(fhi, up)) & (up <= fhi), low = (force < vmax(flo, down)) & (down >= flo);
  s.free = (force >= vmax(flo, down)) & (force <= vmin(fhi, up));
  s.limited = select(high & (up > 0.0), splat(1), select(low & (down < 0.0), splat(-1), T{}));
  s.fades = s.limited * turn > 0.0;
  s.force = vmin(vmax(force, vmax(flo, down)), vmin(fhi, up));
  s.ripple = T{};
  if (m.nripple == 0) return s;
  const double* ripple = m.act_ripple + 3 * a;
  T sine, cosine;
  sincos(ripple[1] * p[kGear] * place + ripple[2], sine, cosine);
  s.force += ripple[0] * sine;
  s.ripple = (ripple[0] * ripple[1]) * cosine;
  return s;
}

}  // namespace cmbrl::CMBRL_ISA
