// Surfaces that move while their geoms stay: belts, treadmills, turntables. Of each geom a field v + w x (x - p) that its body
// carries, which is a twist; a contact sees both geoms' difference, without what is along its normal and what would roll.
#pragma once
#include "collision/contact.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G> static inline bool glides(const Model& m, const Contact<G>& c) { return G::D == 3 && m.con_glide[c.index] >= 0; }

// The twist about O of the surface of the contact's A (side 0) or B (side 1), in the world.
template <class G>
static Vec<G::N> surface_twist(const Model& m, const Work<G>& w, const Contact<G>& c, int side) {
  if constexpr (G::D == 3) {
    const double* local = m.glide_twist + 12 * m.con_glide[c.index] + 6 * side;
    int body = side ? m.con_bodyB[c.index] : m.con_bodyA[c.index];
    Vec<3> turn = load<3>(local), v = load<3>(local + 3);
    if (body < 0) return join<G>(turn, v + cross(turn, w.O));
    turn = G::rotate(w.R[body], turn);
    return join<G>(turn, G::rotate(w.R[body], v) + cross(w.pos[body], turn));
  } else {
    return zero<G::N>();
  }
}

// What the rows of contact c see of it, as a twist: A against B. To be asked only where it glides.
template <class G>
static Vec<G::N> glide_of(const Model& m, const Work<G>& w, const Contact<G>& c) {
  if constexpr (G::D == 3) {
    Vec<6> s = surface_twist(m, w, c, 0) - surface_twist(m, w, c, 1);
    Vec<3> n = normal_of(c), turn = dot(n, ang<G>(s)) * n, v = point_velocity<G>(s, c.p);
    v -= dot(n, v) * n;
    return join<G>(turn, v - cross(turn, c.p));
  } else {
    return zero<G::N>();
  }
}

// How that changes with a change ds of the difference of both fields, dp of the contact point, and dn of its normal.
template <class G>
static Vec<G::N> glide_shift(const Model& m, const Work<G>& w, const Contact<G>& c, const Vec<G::N>& ds, const typename G::V& dp,
                             const typename G::V& dn) {
  if constexpr (G::D == 3) {
    Vec<6> s = surface_twist(m, w, c, 0) - surface_twist(m, w, c, 1);
    Vec<3> n = normal_of(c), a = ang<G>(s), v = point_velocity<G>(s, c.p), dv = point_velocity<G>(ds, c.p) + cross(a, dp);
    Vec<3> turn = dot(n, a) * n, dturn = (dot(dn, a) + dot(n, ang<G>(ds))) * n + dot(n, a) * dn;
    dv = dv - (dot(dn, v) + dot(n, dv)) * n - dot(n, v) * dn;
    return join<G>(dturn, dv - cross(dturn, c.p) - cross(turn, dp));
  } else {
    return zero<G::N>();
  }
}

// The same for a dof with column S, which moves A (sign +1) or B (sign -1) and its surface with it.
template <class G>
static Vec<G::N> glide_by_dof(const Model& m, const Work<G>& w, const Contact<G>& c, const Shift<G>& s, const Vec<G::N>& S, int sign) {
  Vec<G::N> carried = cross_motion<G>(S, surface_twist(m, w, c, sign > 0 ? 0 : 1));
  return glide_shift(m, w, c, sign > 0 ? carried : zero<G::N>() - carried, s.dp, s.dn);
}

template <class G>
static Vec<G::N> relative_twist(const Model& m, const Vec<G::N>* twist, int index) {
  int A = m.con_bodyA[index];
  Vec<G::N> t = A >= 0 ? twist[A] : zero<G::N>();
  if (m.con_bodyB[index] >= 0) t -= twist[m.con_bodyB[index]];
  return t;
}

// What the rows of contact c see of the twists of bodies: how its surfaces pass each other.
template <class G>
static Vec<G::N> passing_twist(const Model& m, const Work<G>& w, const Vec<G::N>* twist, const Contact<G>& c) {
  Vec<G::N> t = relative_twist<G>(m, twist, c.index);
  if (glides(m, c)) t += glide_of(m, w, c);
  return t;
}

}  // namespace cmbrl::CMBRL_ISA
