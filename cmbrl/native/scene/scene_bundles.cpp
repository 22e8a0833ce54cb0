// Shapes of the world that one body may touch, where they are many: bundles of neighbours, and boxes around them (bundles.hpp).
#include <algorithm>
#include <cmath>
#include <numeric>

#include "scene/scene_data.hpp"

namespace cmbrl {

namespace {

constexpr int kMany = 16, kFew = 4;  // clusters of a group that is bundled, and of the smallest bundle

int middle_of(int begin, int end) { return begin + (end - begin) / 2; }

// Candidates of one pair of geoms that touch in one way: a cluster to be, and where its shape of the world is.
struct Run { std::vector<int> candidates; double place[3] = {}; };

// So that neighbours stand together in each half, and in halves of halves.
void order_by_place(std::vector<Run>& runs, int begin, int end, int D) {
  if (end - begin <= kFew) return;
  int axis = 0;
  double widest = -1;
  for (int k = 0; k < D; ++k) {
    auto [low, high] = std::minmax_element(runs.begin() + begin, runs.begin() + end, [&](auto& x, auto& y) { return x.place[k] < y.place[k]; });
    if (high->place[k] - low->place[k] > widest) { widest = high->place[k] - low->place[k]; axis = k; }
  }
  std::stable_sort(runs.begin() + begin, runs.begin() + end, [&](auto& x, auto& y) { return x.place[axis] < y.place[axis]; });
  int middle = middle_of(begin, end);
  order_by_place(runs, begin, middle, D);
  order_by_place(runs, middle, end, D);
}

}  // namespace

// Whether candidate c belongs to a bundle where there are many: planes and height fields are everywhere.
bool SceneData::of_a_bundle(int c) const {
  int hull = model.con_hullB[c];
  bool field = hull >= 0 && model.con_type[c] == kHulls && model.hull_field[hull] >= 0;
  return model.con_plane[c] < 0 && !field && (model.con_bodyA[c] < 0 || model.con_bodyB[c] < 0);
}

// Of groups with many shapes of the world, in grp_con: first what belongs to no bundle, then neighbours together.
void SceneData::order_groups() {
  Model& m = model;
  std::vector<int>& con = ints_["grp_con"];
  for (int g = 0; g < m.ngroup; ++g) {
    if (m.grp_A[g] >= 0 && m.grp_B[g] >= 0) continue;
    std::vector<int> alone;
    std::vector<Run> runs;
    int before = -1;
    for (int k = m.grp_cptr[g]; k < m.grp_cptr[g + 1]; before = con[k++]) {
      int c = con[k];
      if (!of_a_bundle(c)) { alone.push_back(c); continue; }
      if (before < 0 || m.con_pair[c] != m.con_pair[before] || m.con_when[c] != m.con_when[before]) {
        runs.emplace_back();
        const double* place = m.con_bodyA[c] < 0 ? m.con_posA : m.con_posB;
        std::copy_n(place + c * m.D, m.D, runs.back().place);
      }
      runs.back().candidates.push_back(c);
    }
    if (int(runs.size()) < kMany) continue;
    order_by_place(runs, 0, int(runs.size()), m.D);
    auto to = std::copy(alone.begin(), alone.end(), con.begin() + m.grp_cptr[g]);
    for (const Run& run : runs) to = std::copy(run.candidates.begin(), run.candidates.end(), to);
  }
}

// Each bundle is followed by its halves, and next says what comes after these.
struct SceneData::Bundles {
  std::vector<int> begin, end, next, of_group{0};
  std::vector<double> box, round, weight;
};

int SceneData::bundle(Bundles& b, int begin, int end) const {
  const Model& m = model;
  int D = m.D, own = int(b.begin.size()), size = (2 + D) * D;
  b.begin.push_back(begin);
  b.end.push_back(end);
  b.next.push_back(0);
  double low[3] = {1e300, 1e300, 1e300}, high[3] = {-1e300, -1e300, -1e300}, round = 0, weight = 0;
  for (int k = begin; k < end; ++k) {
    const double* box = (m.con_bodyA[m.grp_con[m.cluster_begin[k]]] < 0 ? m.cluster_boxA : m.cluster_boxB) + k * size;
    for (int r = 0; r < D; ++r) {
      double half = 0;
      for (int axis = 0; axis < D; ++axis) half += std::abs(box[(1 + axis) * D + r]) * box[(1 + D) * D + axis];
      low[r] = std::min(low[r], box[r] - half);
      high[r] = std::max(high[r], box[r] + half);
    }
    round = std::max(round, cluster_reach_[k]);
    weight = std::max(weight, m.cluster_invweight[k]);
  }
  for (int r = 0; r < D; ++r) b.box.push_back(0.5 * (low[r] + high[r]));
  for (int r = 0; r < D; ++r) b.box.push_back(0.5 * (high[r] - low[r]) * (1 + 1e-9) + 1e-12);  // round-off of the test itself
  b.round.push_back(round);
  b.weight.push_back(weight);
  if (end - begin > kFew) {
    bundle(b, begin, middle_of(begin, end));
    bundle(b, middle_of(begin, end), end);
  }
  return b.next[own] = int(b.begin.size());
}

void SceneData::derive_bundles() {
  Model& m = model;
  Bundles b;
  for (int g = 0; g < m.ngroup; ++g) {
    int begin = m.grp_clusters[g], end = m.grp_clusters[g + 1];
    while (begin < end && !of_a_bundle(m.grp_con[m.cluster_begin[begin]])) ++begin;
    if (end - begin >= kMany) bundle(b, begin, end);
    b.of_group.push_back(int(b.begin.size()));
  }
  m.sifted |= !b.begin.empty();
  m.grp_bundles = keep_ints("grp_bundles", std::move(b.of_group));
  m.bundle_begin = keep_ints("bundle_begin", std::move(b.begin)); m.bundle_end = keep_ints("bundle_end", std::move(b.end));
  m.bundle_next = keep_ints("bundle_next", std::move(b.next));
  m.bundle_box = keep_doubles("bundle_box", std::move(b.box));
  m.bundle_round = keep_doubles("bundle_round", std::move(b.round));
  m.bundle_invweight = keep_doubles("bundle_invweight", std::move(b.weight));
}

}  // namespace cmbrl
