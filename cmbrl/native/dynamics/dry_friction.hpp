// How much a joint loses to dry friction, by its state at the step's start: max(0, f0 + f1 (q - q0) + f2 exp(-|v|/vs)), with its
// place q0 in the file. MuJoCo has f0 alone; f1 (friction that grows towards one end) and f2 (Stribeck's, which speed takes away)
// are 0 unless a fit moves them.
#pragma once
#include "dynamics/lines.hpp"

namespace cmbrl::CMBRL_ISA {

struct FrictionLimit {
  T limit;       // before it is cut off at 0
  T by_q, by_v;  // by the line's length and rate
  T place, fade, by_speed;  // by f1, f2 and vs; by f0 it is 1
};

// whole: of parameters that are 0 too.
template <class G>
static FrictionLimit friction_limit(const Model& m, const Work<G>& w, int line, bool whole = false) {
  const T* p = w.P + m.oDof + line * kDofFields;
  FrictionLimit f{p[kFrictionloss], T{}, T{}, T{}, T{}, T{}};
  if (line >= m.nv || m.dof_qadr[line] < 0) return f;
  if (!whole && !any((p[kFrictionSlope] != 0.0) | (p[kStribeck] != 0.0))) return f;
  T v = along(m, w, line, w.v), speed = vmax(p[kStribeckSpeed], splat(1e-9)), fast = vabs(v) / speed;
  f.place = w.line_length[line] - m.jnt_q0[m.dof_jnt[line]];
  CMBRL_FOR(i, W) f.fade[i] = __builtin_exp(-fast[i]);
  T lost = p[kStribeck] * f.fade / speed;
  f.limit += p[kFrictionSlope] * f.place + p[kStribeck] * f.fade;
  f.by_q = p[kFrictionSlope];
  f.by_v = select(v > 0.0, -lost, keep(v < 0.0, lost));
  f.by_speed = lost * fast;
  return f;
}

// The impulse of a row by its limit b0. yields: the speed at which dry friction yields, kappa by b0.
static inline T impulse_by_limit(const DryFriction& d, double yields) {
  T inv = 1.0 / (d.eta0 - d.b * d.eta / d.b0 + d.R * (d.b0 - d.b * d.b / d.b0));
  return keep(d.on, inv * (d.b * (d.eta0 - yields) / d.b0 - d.eta));
}

// The same where the limit is 0 and there is no row. As the limit leaves 0, the impulse is the share x of it that the smoothed
// law gives at the velocity z of the row:  s x/(1 - x^2) = -z  with the speed s at which it yields.
template <class G>
static T impulse_by_limit_at_zero(const Model& m, const Work<G>& w, int line, double h, double yields) {
  const double* s = m.line_soft + 7 * line;
  T K, B;
  stiffness_damping(splat(s[0]), splat(s[1]), splat(s[3]), m.least_time(h), K, B);
  T z = (2 / yields) * (along(m, w, line, w.vn) - (1.0 - h * B) * along(m, w, line, w.v));
  return -z / (1.0 + vsqrt(1.0 + z * z));
}

}  // namespace cmbrl::CMBRL_ISA
