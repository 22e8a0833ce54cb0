// Actuators that pull a body towards what it touches: along the mean of the normals of its contacts, as MuJoCo's adhesion does.
// Contacts count from a gap on at which they need not act yet, whatever the solver makes of their rows; how many there are
// changes by jumps.
#pragma once
#include "collision/candidates.hpp"

namespace cmbrl::CMBRL_ISA {

// Contacts that actuator k on several dofs pulls at, into w.grips, with their shares.
template <class G>
static void find_grips(const Model& m, const Options& o, Work<G>& w, int k) {
  int first = w.ngrips;
  T count = T{};
  for (int e = m.grip_ptr[k]; e < m.grip_ptr[k + 1]; ++e) {
    int cluster = m.grip_cluster[e], begin = m.cluster_begin[cluster], end = m.cluster_begin[cluster + 1], i = m.grp_con[begin];
    if (idle(m, o, cluster)) continue;
    double reach = m.con_reach[i];
    w.may_touch = all();
    if (m.cluster_round[cluster] >= 0) {
      T gap = least_gap(m, w, m.con_bodyA[i], m.con_bodyB[i], cluster);
      if (!any(gap < reach)) continue;
      w.may_touch = within_reach(m, i, gap);
    }
    if (corners_on_plane(m, w, i)) end = begin + kCorners;
    for (int x = begin; x < end; ++x) {
      i = m.grp_con[x];
      Feature<G> F;
      Mask on = look_at(m, o, w, i, F);
      if (!any(on)) continue;
      T radius = load_radius(m, w, i), phi = F.dist - radius;
      on &= phi < reach;
      if (!any(on)) continue;
      Grip<G>& grip = w.add_grip();
      place_contact(m, i, F, phi, radius, grip.contact);
      grip.actuator = k;
      grip.share = keep(on, splat(m.con_points[i]));
      count += grip.share;
    }
  }
  for (int g = first; g < w.ngrips; ++g) w.grips[g].share /= vmax(count, splat(1));
}

// f(dof, moment arm) of actuator k.
template <class G, class F>
static void for_grip_arms(const Model& m, const Work<G>& w, int k, F f) {
  for (int g = 0; g < w.ngrips; ++g) {
    const Grip<G>& grip = w.grips[g];
    if (grip.actuator != k) continue;
    int group = m.con_group[grip.contact.index];
    for (int a = m.grp_dptr[group]; a < m.grp_dptr[group + 1]; ++a)
      f(m.grp_dof[a], (-m.grp_sign[a] * grip.share) * dot(w.S[m.grp_dof[a]], grip.contact.Wr[0]));
  }
}

// Adds h dtau/dq of actuator k, whose force times gear is `push`: contacts and their normals move, and dofs below others turn.
template <class G>
static void grip_terms(const Model& m, const Work<G>& w, int k, T push, T* Gq) {
  for (int g = 0; g < w.ngrips; ++g) {
    const Grip<G>& grip = w.grips[g];
    if (grip.actuator != k) continue;
    const Contact<G>& c = grip.contact;
    int group = m.con_group[c.index], begin = m.grp_dptr[group], end = m.grp_dptr[group + 1];
    T pull = -push * grip.share;
    for (int a = begin; a < end; ++a) {
      int j = m.grp_dof[a];
      Vec<G::N> moved = pull * wrench_shift(c, shift_by_dof(m, w, c, w.S[j], m.grp_sign[a]), 0);
      Vec<G::N> turned = moved - cross_force<G>(w.S[j], pull * c.Wr[0]);
      for (int b = begin; b < end; ++b) {
        int i = m.grp_dof[b];
        T x = dot(w.S[i], turns_with(m, b, a) ? turned : moved);
        Gq[i * m.nv + j] += keep(w.yields[i], m.grp_sign[b] * x);
      }
    }
  }
}

}  // namespace cmbrl::CMBRL_ISA
