// How many rows states are likely to have, by the boxes around what may touch alone: packs take the time of their slowest lane,
// so a batch is stepped in order of it (attempts.hpp).
#pragma once
#include "step/bodies.hpp"
#include "collision/candidates.hpp"

namespace cmbrl::CMBRL_ISA {

// Candidates of clusters whose boxes are near, where bodies are and move as in w. Those of few candidates have no box.
template <class G>
static T near_candidates(const Model& m, const Options& o, Work<G>& w) {
  T count = T{};
  w.nguess = 0;
  find_near(m, o, w);
  if (!w.sift) return count;
  for_near(m, w, [&](int g) {
    int A = m.grp_A[g], B = m.grp_B[g];
    T fast = fastest_of_pair(m, o, w, A, B);
    for_clusters(m, o, w, g, fast, [&](int c) {
      if (m.cluster_round[c] < 0 || idle(m, o, c)) return;
      constexpr int of_a_field = 4;  // of all that its candidates are for
      T size = splat(of_field(m, m.grp_con[m.cluster_begin[c]]) ? of_a_field : m.cluster_begin[c + 1] - m.cluster_begin[c]);
      count += keep(least_gap(m, w, A, B, c) < far_from(m, o, c, fast), size);
    }, [](T) {});
  });
  return count;
}

// Of elements begin to end, into b.iterations. The order of those that are not finite does not matter.
template <class G>
static void survey(const Model& m, const Options& o, const Batch& b, int64_t begin, int64_t end, StepMemory& memory) {
  for_moving_bodies<G>(m, b, begin, end, memory, [&](const Lanes& l, Mask, Work<G>& w) {
    gather_parameters(m, b, l, w, l.at[0] == begin);
    T count = near_candidates(m, o, w);
    for (int lane = 0; lane < l.n; ++lane) b.iterations[l.at[lane]] = int32_t(count[lane]);
  });
}

}  // namespace cmbrl::CMBRL_ISA
