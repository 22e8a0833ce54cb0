// Clusters of a body with many shapes of the world, as of a terrain of boxes, in bundles of neighbours and bundles of those: one
// that is far from the body's sphere is passed over as a whole (scene_bundles.cpp). So a step costs what is near.
#pragma once
#include "collision/near.hpp"

namespace cmbrl::CMBRL_ISA {

// The gap of all candidates of a bundle with a body is at least this.
template <class G>
static T least_gap_of_bundle(const Model& m, const Work<G>& w, int body, int bundle) {
  const double* box = m.bundle_box + bundle * 2 * G::D;  // along the axes of the world
  typename G::V apart = w.centre[body] + w.O - load<G::D>(box);
  T square = T{};
  CMBRL_FOR(k, G::D) {
    T beyond = vmax(vabs(apart[k]) - box[G::D + k], T{});
    square += beyond * beyond;
  }
  return vsqrt(square) - (m.sphere_radius[body] * (1 + 1e-9) + m.bundle_round[bundle]) - w.radius_slack;
}

// Calls look(cluster) for those of a group whose bodies are so fast against each other, and far(gap) for bundles that are too far
// to be looked at.
template <class G, class Look, class Far>
static void for_clusters(const Model& m, const Options& o, const Work<G>& w, int g, T fast, Look look, Far far) {
  int bundle = m.grp_bundles[g], last = m.grp_bundles[g + 1], end = m.grp_clusters[g + 1];
  bool bundled = w.sift && bundle < last;
  for (int c = m.grp_clusters[g], alone = bundled ? m.bundle_begin[bundle] : end; c < alone; ++c) look(c);
  if (!bundled) return;
  int body = m.grp_A[g] < 0 ? m.grp_B[g] : m.grp_A[g];
  while (bundle < last) {
    T gap = least_gap_of_bundle(m, w, body, bundle);
    if (!any(gap < o.h * (speed_of_far(o, m.bundle_invweight[bundle]) + 2.0 * fast))) {
      far(gap);
      bundle = m.bundle_next[bundle];
      continue;
    }
    bool smallest = m.bundle_next[bundle] == bundle + 1;
    for (int c = m.bundle_begin[bundle]; smallest && c < m.bundle_end[bundle]; ++c) look(c);
    ++bundle;  // else to its halves, which follow
  }
}

}  // namespace cmbrl::CMBRL_ISA
