// The corners of a box against another box. Boxes of one size in a stack meet corner on corner, where the nearest side of B to a
// single corner says nothing; so both boxes choose: B's side that lies farthest outside all of A, or is least inside of it. It is
// the same for all corners, and found once for them.
#pragma once
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr double kBeside = 1e-6;  // m, how far beside the side a corner still touches it
constexpr double kAway = 1e3;     // m, the gap of a corner that is not over the side

// A frame on B as that of A's body sees it. centre and axes, the k-th with entries axes[k + r D] if `columns`: in the frame of B's body.
template <class G>
static FrameInA<G> frame_in_A(const Work<G>& w, int A, int B, const double* centre, const double* axes, bool columns) {
  constexpr int D = G::D;
  FrameInA<G> f;
  typename G::V x = load<D>(centre), apart = (A >= 0 ? w.pos[A] : zero<D>() - w.O) - (B >= 0 ? w.pos[B] + G::rotate(w.R[B], x) : x - w.O);
  CMBRL_FOR(k, D) {
    double e[D];
    CMBRL_FOR(r, D) e[r] = columns ? axes[r * D + k] : axes[k * D + r];
    f.axis[k] = B >= 0 ? G::rotate(w.R[B], load<D>(e)) : load<D>(e);
    f.up[k] = A >= 0 ? G::unrotate(w.R[A], f.axis[k]) : f.axis[k];
    f.base[k] = dot(f.axis[k], apart);
  }
  return f;
}

// That of candidate i's two boxes.
template <class G>
static const SideUnderCorners<G>& side_under_corners(const Model& m, Work<G>& w, int i) {
  constexpr int D = G::D;
  SideUnderCorners<G>& s = w.under;
  if (s.pair == m.con_pair[i] && s.A == m.con_bodyA[i]) return s;
  s.pair = m.con_pair[i];
  s.A = m.con_bodyA[i];
  s.half = m.con_halfB + i * D;
  s.frame = frame_in_A(w, s.A, m.con_bodyB[i], m.con_posB + i * D, m.con_rotB + i * D * D, true);
  typename G::V offset = load<D>(m.con_axisA + i * D), centre = load<D>(m.con_posA + i * D) - offset;
  T apart[D], best = splat(-1e300);
  CMBRL_FOR(k, D) {
    T extent = T{}, place = s.frame.along(k, centre);
    CMBRL_FOR(j, D) {
      double e[D];
      CMBRL_FOR(r, D) e[r] = m.con_rotA[i * D * D + r * D + j];
      typename G::V of_a = load<D>(e);
      extent += vabs(dot(s.frame.up[k], of_a) * dot(of_a, offset));
    }
    apart[k] = vabs(place) - s.half[k] - extent;
    best = vmax(best, apart[k]);
    s.side[k] = select(place < 0.0, splat(-1), splat(1));
  }
  Mask rest = all();
  s.normal = zero<D>();
  CMBRL_FOR(k, D) {
    s.chosen[k] = rest & (apart[k] == best);
    CMBRL_FOR(x, D) s.normal[x] = select(s.chosen[k], s.side[k] * s.frame.axis[k][x], s.normal[x]);
    rest &= ~s.chosen[k];
  }
  return s;
}

// How far A's corner x is away from it.
template <class G>
static T corner_distance(const SideUnderCorners<G>& s, const typename G::V& x) {
  T distance = T{};
  Mask beside = none();
  CMBRL_FOR(k, G::D) {
    T place = s.frame.along(k, x);
    distance = select(s.chosen[k], s.side[k] * place - s.half[k], distance);
    beside |= ~s.chosen[k] & (vabs(place) > s.half[k] + kBeside);
  }
  return distance + select(beside, splat(kAway), T{});
}

// Candidate i's closest feature but for its point.
template <class G>
static void over_side(const Model& m, Work<G>& w, int i, Feature<G>& F) {
  constexpr int D = G::D;
  const SideUnderCorners<G>& s = side_under_corners(m, w, i);
  F.dist = corner_distance(s, load<D>(m.con_posA + i * D));
  F.n = s.normal;
  CMBRL_FOR(r, D) CMBRL_FOR(c, D) F.slide[r * D + c] = (r == c ? 1.0 : 0.0) - s.normal[r] * s.normal[c];
}

}  // namespace cmbrl::CMBRL_ISA
