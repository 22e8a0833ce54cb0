// dJ/dt v of a tie, what its rows accelerate by where no joint does, and how that changes with velocities and coordinates.
#pragma once
#include "step/tie_columns.hpp"

namespace cmbrl::CMBRL_ISA {

// Accelerations of all bodies under w.v if no joint accelerates, without gravity.
template <class G>
static void drifts(const Model& m, Work<G>& w) {
  for (int b = 0; b < m.nbody; ++b) {
    Vec<G::N> a = m.body_parent[b] >= 0 ? w.drift[m.body_parent[b]] : zero<G::N>();
    for (int j = m.body_jadr[b]; j < m.body_jadr[b] + m.body_jnum[b]; ++j) {
      int d = m.jnt_vadr[j], n = m.jnt_type[j] == kBall ? 3 : 1;
      Vec<G::N> own = zero<G::N>();
      for (int k = d; k < d + n; ++k) {
        w.drift_before[k] = a;
        own += w.v[k] * w.S[k];
      }
      a += cross_motion<G>(w.vlam[d], own);
    }
    w.drift[b] = a;
  }
}

// How the end of a tie moves: twist and acceleration of its body.
template <class G> struct Sway { Vec<G::N> vel, acc; };
template <class G>
static Sway<G> sway_of(const Work<G>& w, int body) {
  if (body < 0) return {zero<G::N>(), zero<G::N>()};
  return {w.vel[body], w.drift[body]};
}
// Its change with the velocity of a dof that carries it, or with its coordinate: what stands behind a joint turns with it.
template <class G>
static Sway<G> change_of_sway(const Model& m, const Work<G>& w, const Sway<G>& s, int d, bool by_velocity) {
  const Vec<G::N>&S = w.S[d], &before = w.vlam[d];
  Vec<G::N> turned = cross_motion<G>(before, S);
  if (by_velocity) {
    int joint = m.dof_jnt[d], first = m.jnt_vadr[joint], n = m.jnt_type[joint] == kBall ? 3 : 1;
    Vec<G::N> beyond = s.vel - before;
    for (int k = first; k < first + n; ++k) beyond -= w.v[k] * w.S[k];
    return {S, turned + cross_motion<G>(S, beyond)};
  }
  Vec<G::N> beyond = s.vel - before;
  return {cross_motion<G>(S, beyond), cross_motion<G>(S, s.acc - w.drift_before[d]) + cross_motion<G>(turned, beyond)};
}

template <class G>
static typename G::V point_acceleration(const Sway<G>& s, const typename G::V& p) {
  return point_velocity<G>(s.acc, p) + G::turn(ang<G>(s.vel), point_velocity<G>(s.vel, p));
}
// The same of a change of the sway, and of the point by dp.
template <class G>
static typename G::V change_of_acceleration(const Sway<G>& s, const Sway<G>& ds, const typename G::V& p, const typename G::V& dp) {
  typename G::Ang turn = ang<G>(s.vel);
  return point_velocity<G>(ds.acc, p) + G::turn(ang<G>(s.acc), dp) + G::turn(ang<G>(ds.vel), point_velocity<G>(s.vel, p)) +
         G::turn(turn, point_velocity<G>(ds.vel, p) + G::turn(turn, dp));
}

// dJ/dt v of a tie.
template <class G>
static void tie_sway(const Model& m, const Work<G>& w, int i, const Tie<G>& t, T* out) {
  CMBRL_FOR(r, t.rows) out[r] = T{};
  if (m.tie_type[i] == kPolynomial) return;
  Sway<G> a = sway_of(w, m.tie_A[i]), b = sway_of(w, m.tie_B[i]);
  typename G::V apart = point_acceleration(a, t.a) - point_acceleration(b, t.b);
  CMBRL_FOR(r, G::D) out[r] = apart[r];
  if (t.rows == G::D) return;
  double scale = m.tie_scale[i];
  typename G::Ang turn_a = ang<G>(a.vel), turn_b = ang<G>(b.vel), turn = turn_a - turn_b;
  typename G::Ang rate = half_rate(t, scale, ang<G>(a.acc) - ang<G>(b.acc) + G::cross_ang(turn_a, turn_b));
  CMBRL_FOR(r, G::A) out[G::D + r] = rate[r] - (0.25 * scale) * dot(turn, turn) * t.v[r];
}
// Its change with the velocity of the l-th of the tie's dofs, or with its coordinate.
template <class G>
static void tie_sway_change(const Model& m, const Work<G>& w, int i, const Tie<G>& t, int l, bool by_velocity, T* out) {
  CMBRL_FOR(r, t.rows) out[r] = T{};
  if (m.tie_type[i] == kPolynomial) return;
  int d = m.tie_dof[l];
  bool moves_a = m.tie_side[l] & kCarriesA, moves_b = m.tie_side[l] & kCarriesB;
  Sway<G> a = sway_of(w, m.tie_A[i]), b = sway_of(w, m.tie_B[i]), still = {zero<G::N>(), zero<G::N>()};
  Sway<G> da = moves_a ? change_of_sway(m, w, a, d, by_velocity) : still, db = moves_b ? change_of_sway(m, w, b, d, by_velocity) : still;
  typename G::V none = zero<G::D>();
  typename G::V at_a = moves_a && !by_velocity ? point_velocity<G>(w.S[d], t.a) : none;
  typename G::V at_b = moves_b && !by_velocity ? point_velocity<G>(w.S[d], t.b) : none;
  typename G::V apart = change_of_acceleration(a, da, t.a, at_a) - change_of_acceleration(b, db, t.b, at_b);
  CMBRL_FOR(r, G::D) out[r] = apart[r];
  if (t.rows == G::D) return;
  double scale = m.tie_scale[i];
  typename G::Ang turn_a = ang<G>(a.vel), turn_b = ang<G>(b.vel), turn = turn_a - turn_b, dturn = ang<G>(da.vel) - ang<G>(db.vel);
  typename G::Ang change = ang<G>(da.acc) - ang<G>(db.acc) + G::cross_ang(ang<G>(da.vel), turn_b) + G::cross_ang(turn_a, ang<G>(db.vel));
  typename G::Ang rate = half_rate(t, scale, change);
  CMBRL_FOR(r, G::A) out[G::D + r] = rate[r] - (0.5 * scale) * dot(turn, dturn) * t.v[r];
  if (by_velocity) return;
  typename G::Ang S = ang<G>(w.S[d]), z = ang<G>(a.acc) - ang<G>(b.acc) + G::cross_ang(turn_a, turn_b), spin = zero<G::A>();
  double towards = double(moves_a) - double(moves_b);
  if (moves_a) spin += G::cross_ang(z, S);  // the half angle's own axes turn
  if (moves_b) spin += G::cross_ang(z, S);
  rate = half_rate(t, scale, spin);
  typename G::Ang half = half_rate(t, scale, S);
  CMBRL_FOR(r, G::A)
    out[G::D + r] += 0.5 * rate[r] - (0.25 * towards) * (scale * dot(z, S) * t.v[r] + dot(turn, turn) * half[r]);
}

}  // namespace cmbrl::CMBRL_ISA
