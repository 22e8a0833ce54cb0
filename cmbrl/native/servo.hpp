// The force of an actuator along a line, before its gear: a gain on its input and on position and velocity, within limits. Backlash
// is a gap in the position's part, which nothing pulls in; the limit falls with the speed that the force drives.
#pragma once
#include "activation.hpp"

namespace cmbrl::CMBRL_ISA {

// pulls, free, fades: lanes in which the position's part, the whole force, and the limit's fall with speed count. place: of the
// line, less the gap. limited: the direction in which P's limit holds the force, or 0.
struct Servo { T force, place, side, limited; Mask pulls, free, fades; };

template <class G>
static Servo servo_of(const Model& m, const Work<G>& w, int a, const Input& input, T place, T speed) {
  const T* p = w.P + m.oAct + a * kActuatorFields;
  T half = p[kGap], turn = p[kGear] * speed;
  T spring = p[kGain] * input.value + p[kBias0] + p[kGear] * p[kBias1] * place;
  T slack = -p[kGear] * p[kBias1] * half;  // force of the gap's half
  slack = vmax(slack, -slack);
  Servo s;
  s.pulls = (spring >= slack) | (spring <= -slack);
  s.side = select(spring < 0.0, splat(-1), splat(1));
  T force = p[kGain] * input.value + p[kBias0] + p[kGear] * (p[kBias1] * place + p[kBias2] * speed);
  force -= vmin(vmax(spring, -slack), slack);
  s.place = place + select(p[kGear] * p[kBias1] < 0.0, s.side, -s.side) * half;
  T fade = p[kLimitSlope], most = p[kLimit];
  T up = vmax(most - fade * vmax(turn, T{}), T{}), down = vmin(fade * vmax(-turn, T{}) - most, T{});
  T flo = splat(m.act_force[2 * a]), fhi = splat(m.act_force[2 * a + 1]);
  Mask high = (force > vmin(fhi, up)) & (up <= fhi), low = (force < vmax(flo, down)) & (down >= flo);
  s.free = (force >= vmax(flo, down)) & (force <= vmin(fhi, up));
  s.limited = select(high & (up > 0.0), splat(1), select(low & (down < 0.0), splat(-1), T{}));
  s.fades = s.limited * turn > 0.0;
  s.force = vmin(vmax(force, vmax(flo, down)), vmin(fhi, up));
  return s;
}

}  // namespace cmbrl::CMBRL_ISA
