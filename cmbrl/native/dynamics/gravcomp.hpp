// Gravity compensation: each body carries a share of its weight itself, at a point that moves with its centre of mass.
#pragma once
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

// How the compensation of a dof acts: as a passive force, as one of its actuators, or not at all.
enum Lift { kPassiveLift = 0, kActuatorLift = 1, kNoLift = 2 };

// Lanes in which a change of the compensation is a change of the force.
template <class G> static inline Mask lifted(const Model& m, const Work<G>& w, int dof) {
  return m.dof_lift[dof] == kPassiveLift ? all() : m.dof_lift[dof] == kActuatorLift ? w.yields[dof] : none();
}

template <class G> static inline typename G::V upwards(const Model& m, const Work<G>& w) {
  typename G::V up;
  CMBRL_FOR(i, G::D) up[i] = -w.P[m.oGravity + i];
  return up;
}

// The wrench about O of masses that are lifted, from their sum and their first moment.
template <class G> static inline Vec<G::N> lift(T mass, const typename G::V& moment, const typename G::V& up) {
  return join<G>(G::moment(moment, up), mass * up);
}

template <class G> static inline typename G::V lift_point(const Model& m, const Work<G>& w, int b) {  // from the centre of mass
  return G::rotate(w.R[b], load<G::D>(m.body_lift_pos + b * G::D));
}

// Into w.lift by dof; lifted masses and first moments of the bodies with all that they carry.
template <class G>
static void gravity_compensation(const Model& m, Work<G>& w) {
  typename G::V up = upwards(m, w);
  for (int b = 0; b < m.nbody; ++b) {
    w.lift_mass[b] = m.body_lift[b] * w.I[b].m;
    w.lift_moment[b] = m.body_lift[b] * (w.I[b].h + w.I[b].m * lift_point(m, w, b));
  }
  for (int b = m.nbody - 1; b >= 0; --b)
    if (int p = m.body_parent[b]; p >= 0) { w.lift_mass[p] += w.lift_mass[b]; w.lift_moment[p] += w.lift_moment[b]; }
  for (int i = 0; i < m.nv; ++i) w.lift[i] = dot(w.S[i], lift<G>(w.lift_mass[m.dof_body[i]], w.lift_moment[m.dof_body[i]], up));
}

// Adds h d lift/dq. A dof moves what its body carries, and the columns of dofs after it.
template <class G>
static void gravity_compensation_terms(const Model& m, const Work<G>& w, double h, T* Gq) {
  typename G::V up = upwards(m, w);
  int nv = m.nv;
  for (int i = 0; i < nv; ++i) {
    int b = m.dof_body[i];
    T mass = w.lift_mass[b];
    typename G::V moment = w.lift_moment[b];
    Vec<G::N> F = lift<G>(mass, moment, up);
    auto moved = [&](int j) {  // the change of F with dof j
      return join<G>(G::moment(mass * lin<G>(w.S[j]) + G::turn(ang<G>(w.S[j]), moment), up), zero<G::D>());
    };
    Vec<G::N> own = moved(i);
    Mask free = lifted(m, w, i);
    Gq[i * (nv + 1)] += keep(free, h * dot(w.S[i], own));
    for (int a = m.anc_ptr[i]; a < m.anc_ptr[i + 1]; ++a) {
      int j = m.anc_idx[a];
      T by_j = dot(w.S[i], moved(j)) + dot(cross_motion<G>(w.S[j], w.S[i]), F), by_i = dot(w.S[j], own);
      if (m.dof_jnt[j] == m.dof_jnt[i]) by_i += dot(cross_motion<G>(w.S[i], w.S[j]), F);  // dofs of one ball joint turn together
      Gq[i * nv + j] += keep(free, h * by_j);
      Gq[j * nv + i] += keep(lifted(m, w, j), h * by_i);
    }
  }
}

}  // namespace cmbrl::CMBRL_ISA
