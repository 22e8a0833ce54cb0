// How far each of many candidates of one pair of geoms is away at least, from what they have in common: with less than a tenth of
// the work of its closest features. Only what is near is looked at closely (candidates.hpp).
#pragma once
#include "collision/corner.hpp"

namespace cmbrl::CMBRL_ISA {

// Calls f(i, distance) for candidates begin to end: points, segments or boxes of A and B lie in boxes along the axes of the one around all
// of B's; of corners over the side of a box, the distance is their own.
template <class G, class F>
static void for_distances(const Model& m, Work<G>& w, int cluster, const int* begin, const int* end, F f) {
  constexpr int D = G::D;
  int first = *begin;
  if (m.con_type[first] == kCornerBox) {
    const SideUnderCorners<G>& side = side_under_corners(m, w, first);
    for (; begin < end; ++begin) f(*begin, corner_distance(side, load<D>(m.con_posA + *begin * D)));
    return;
  }
  const double* around = m.cluster_boxB + cluster * (2 + D) * D;
  if (w.frame_of != m.cluster_frame[cluster]) w.frame = frame_in_A(w, m.con_bodyA[first], m.con_bodyB[first], around, around + D, false);
  w.frame_of = m.cluster_frame[cluster];
  const FrameInA<G>& frame = w.frame;
  for (; begin < end; ++begin) {
    typename G::V x = load<D>(m.con_posA + *begin * D), axis = load<D>(m.con_axisA + *begin * D);
    const double* b = m.con_extentB + *begin * 2 * D;
    T most = splat(-1e300);
    CMBRL_FOR(k, D) most = vmax(most, vabs(frame.along(k, x) - b[k]) - vabs(dot(frame.up[k], axis)) - b[D + k]);
    f(*begin, most);
  }
}

}  // namespace cmbrl::CMBRL_ISA
