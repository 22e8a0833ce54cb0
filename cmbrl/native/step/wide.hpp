// Actuators that push a body at a site, or all dofs of a ball or free joint, or pull a body at its contacts: they act on several
// dofs at once. They have neither position nor velocity gains.
#pragma once
#include "dynamics/activation.hpp"
#include "collision/adhesion.hpp"

namespace cmbrl::CMBRL_ISA {

// f(dof, moment arm) of actuator k among these.
template <class G, class F>
static void for_arms(const Model& m, const Work<G>& w, int k, F f) {
  for (int e = m.wide_ptr[k]; e < m.wide_ptr[k + 1]; ++e) f(m.wide_dof[e], splat(m.wide_coef[e]));
  if (m.grip_ptr[k] < m.grip_ptr[k + 1]) return for_grip_arms(m, w, k, f);
  if (m.wide_body[k] < 0) return;
  for (int d = m.body_lastdof[m.wide_body[k]]; d >= 0; d = m.above(d)) f(d, dot(w.S[d], w.wide_wrench[k]));
}

struct Drive { T force; Mask free; Input input; };  // before the gear; lanes in which it is not clamped; what the gain multiplies
template <class G>
static Drive wide_drive(const Model& m, const Work<G>& w, int a) {
  const T* p = w.P + m.oAct + a * kActuatorFields;
  T flo = splat(m.act_force[2 * a]), fhi = splat(m.act_force[2 * a + 1]);
  Input input = input_of(m, w, a);
  T force = p[kGain] * input.value + p[kBias0];
  Mask free = (force >= flo) & (force <= fhi);
  return {vmin(vmax(force, flo), fhi), free, input};
}

template <class G>
static void wide_forces(const Model& m, const Options& o, Work<G>& w) {
  w.ngrips = 0;
  if (m.grip_ptr[m.nwide] > 0) look_afresh(o, w);
  for (int k = 0; k < m.nwide; ++k) {
    int a = m.wide_act[k], b = m.wide_body[k];
    const T* p = w.P + m.oAct + a * kActuatorFields;
    find_grips(m, o, w, k);
    if (b >= 0) {
      Vec<G::N> local = load<G::N>(m.wide_local + k * G::N);
      typename G::V force = G::rotate(w.R[b], lin<G>(local));
      w.wide_wrench[k] = join<G>(rotate_moment(G{}, w.R[b], ang<G>(local)) + G::moment(w.pos[b], force), force);
    }
    Drive drive = wide_drive(m, w, a);
    T push = w.wide_push[k] = p[kGear] * drive.force;
    note_gain(m, w, a, drive.input, p[kGain], drive.free);
    for_arms(m, w, k, [&](int d, T arm) { w.drive[d] += arm * push; });
  }
}

// Adds h dtau/dq and h dtau/du. A wrench turns with its body; the columns of dofs below a joint turn with them.
template <class G>
static void wide_terms(const Model& m, const Work<G>& w, double h, T* Gq, T* Gu) {
  for (int k = 0; k < m.nwide; ++k) {
    int a = m.wide_act[k];
    for_arms(m, w, k, [&](int d, T arm) { add_inputs(m, w, a, h * arm, w.yields[d], Gu + d * m.nu); });
    grip_terms(m, w, k, h * w.wide_push[k], Gq);
    if (m.wide_body[k] < 0) continue;
    for (int j = m.body_lastdof[m.wide_body[k]]; j >= 0; j = m.above(j)) {
      Vec<G::N> turned = cross_force<G>(w.S[j], (h * w.wide_push[k]) * w.wide_wrench[k]);
      for (int i = m.above(j); i >= 0; i = m.above(i))
        if (m.dof_jnt[i] != m.dof_jnt[j]) Gq[i * m.nv + j] += keep(w.yields[i], dot(w.S[i], turned));
    }
  }
}

}  // namespace cmbrl::CMBRL_ISA
