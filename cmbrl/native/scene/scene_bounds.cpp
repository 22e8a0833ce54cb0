// What holds what may touch: spheres, of each body, and boxes, of the candidates of two geoms (near.hpp). And which candidates may share a
// row of a pack (candidates.hpp), and which of them actuators pull at (adhesion.hpp).
#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <tuple>

#include "scene/scene_data.hpp"

namespace cmbrl {

namespace {

// About the middle of the box that holds the centres of its parts. First `hold` all of them, then `reach` each.
struct Sphere {
  double low[3] = {1e300, 1e300, 1e300}, high[3] = {-1e300, -1e300, -1e300}, radius = -1;

  double centre(int k) const { return 0.5 * (low[k] + high[k]); }
  void hold(const double* x, int D) {
    for (int k = 0; k < D; ++k) {
      low[k] = std::min(low[k], x[k]);
      high[k] = std::max(high[k], x[k]);
    }
  }
  void reach(const double* x, double size, int D) {
    double away = 0;
    for (int k = 0; k < D; ++k) away += (x[k] - centre(k)) * (x[k] - centre(k));
    radius = std::max(radius, std::sqrt(away) + size);
  }
};

double length(const double* x, int D) {
  double sum = 0;
  for (int k = 0; k < D; ++k) sum += x[k] * x[k];
  return std::sqrt(sum);
}

template <class F>
void for_vertices(const Model& m, int hull, F f) {
  for (int k = hull < 0 ? 0 : m.hull_ptr[hull]; hull >= 0 && k < m.hull_ptr[hull + 1]; ++k) f(m.hull_point + 3 * k);
}
// f(point) of what candidate c has of A: of a mesh over a plane, whose point may be any corner, its hull too; and of B.
template <class F>
void for_points(const Model& m, int c, F f) {
  f(m.con_posA + c * m.D);
  for_vertices(m, m.con_hull[c], f);
}
template <class F>
void for_points_of_B(const Model& m, int c, F f) {
  f(m.con_posB + c * m.D);
  for_vertices(m, m.con_hullB[c], f);
}

// A corner of a box, on another one or on a plane: its axis only tells where its box is.
bool is_corner(const Model& m, int c) { return m.con_type[c] == kCornerBox || m.con_type[c] == kPointPlane; }
double margin_of(const Model& m, int c) { return std::max(m.con_margin[c], 0.0); }
// How far the shapes of candidate c, and the margin in which they touch already, reach from their centres. The axis of a corner only tells where its box is.
double size_of_A(const Model& m, int c) {
  double sum = m.P[m.oContact + c * kContactFields + kRadius] - m.con_radiusB[c];
  return std::abs(sum) + margin_of(m, c) + (is_corner(m, c) ? 0 : length(m.con_axisA + c * m.D, m.D));
}
double size_of_B(const Model& m, int c) {
  return std::abs(m.con_radiusB[c]) + length(m.con_axisB + c * m.D, m.D) + length(m.con_halfB + c * m.D, m.D);
}

}  // namespace

// The vertices of hulls by column, for a quick search for the farthest; and what their first eight are the corners of, if that is a box.
void SceneData::derive_hulls(int count) {
  Model& m = model;
  std::vector<int> block;
  std::vector<double> column, box, bound;
  for (int hull = 0; hull < count; ++hull) {
    auto point = [&](int k, int j) { return m.hull_point[3 * (m.hull_ptr[hull] + k) + j]; };
    int last = m.hull_ptr[hull + 1] - m.hull_ptr[hull] - 1;
    double axis[3][3], half[3];
    for (int k = 0; k < 3; ++k) {
      for (int j = 0; j < 3; ++j) axis[k][j] = point(std::min(4 >> k, last), j) - point(0, j);
      half[k] = 0.5 * length(axis[k], 3);
      for (int j = 0; j < 3; ++j) axis[k][j] /= std::max(2 * half[k], 1e-300);
    }
    for (int j = 0; j < 3; ++j) box.push_back(0.5 * (point(0, j) + point(std::min(7, last), j)));
    for (auto& x : axis) box.insert(box.end(), x, x + 3);
    box.insert(box.end(), half, half + 3);
    Sphere around;
    for_vertices(m, hull, [&](const double* x) { around.hold(x, 3); });
    for (int k = 0; k < 3; ++k) bound.push_back(around.centre(k));
    for (int k = 0; k < 3; ++k) bound.push_back(0.5 * (around.high[k] - around.low[k]) + 1e-12);  // round-off
    block.push_back(int(column.size()));
    for (int j = 0; j < 3; ++j)
      for (int k = 0; k < m.hull_count(hull); ++k) {
        int vertex = std::min(m.hull_ptr[hull] + k, m.hull_ptr[hull + 1] - 1);
        column.push_back(m.hull_point[3 * vertex + j]);
      }
  }
  m.hull_block = keep_ints("hull_block", std::move(block));
  m.hull_column = keep_doubles("hull_column", std::move(column));
  m.hull_bound = keep_doubles("hull_bound", std::move(bound));
  m.hull_box = keep_doubles("hull_box", std::move(box));
}

// Around the shapes with which a body may touch anything.
void SceneData::derive_spheres() {
  Model& m = model;
  int D = m.D;
  std::vector<Sphere> spheres(m.nbody);
  for (int c = 0; c < m.ncontact; ++c) {
    if (m.con_bodyA[c] >= 0) for_points(m, c, [&](const double* x) { spheres[m.con_bodyA[c]].hold(x, D); });
    if (m.con_bodyB[c] >= 0) for_points_of_B(m, c, [&](const double* x) { spheres[m.con_bodyB[c]].hold(x, D); });
  }
  for (int c = 0; c < m.ncontact; ++c) {
    if (m.con_bodyA[c] >= 0) for_points(m, c, [&](const double* x) { spheres[m.con_bodyA[c]].reach(x, size_of_A(m, c), D); });
    if (m.con_bodyB[c] >= 0) for_points_of_B(m, c, [&](const double* x) { spheres[m.con_bodyB[c]].reach(x, size_of_B(m, c), D); });
  }
  std::vector<double> centre, radius;
  for (const Sphere& s : spheres) {
    for (int k = 0; k < D; ++k) centre.push_back(s.radius < 0 ? 0.0 : s.centre(k));
    radius.push_back(s.radius);
  }
  m.sphere_pos = keep_doubles("sphere_pos", std::move(centre));
  m.sphere_radius = keep_doubles("sphere_radius", std::move(radius));
}

namespace {

// Along axes of its own, rows of a D x D matrix.
struct Box {
  int D;
  double axes[9], low[3] = {1e300, 1e300, 1e300}, high[3] = {-1e300, -1e300, -1e300};

  // Along the columns of `rot`, or along `axis` if there is one.
  Box(int D_, const double* rot, const double* axis) : D(D_) {
    double size = length(axis, D);
    for (int k = 0; k < D; ++k)
      for (int r = 0; r < D; ++r) axes[k * D + r] = rot[r * D + k];
    if (size == 0) return;
    for (int r = 0; r < D; ++r) axes[r] = axis[r] / size;
    if (D == 2) { axes[2] = -axes[1]; axes[3] = axes[0]; return; }
    int least = 0;
    for (int r = 1; r < 3; ++r) if (std::abs(axes[r]) < std::abs(axes[least])) least = r;
    double along = axes[least], sum = std::sqrt(1 - along * along);
    for (int r = 0; r < 3; ++r) axes[3 + r] = ((r == least) - along * axes[r]) / sum;
    for (int r = 0; r < 3; ++r) axes[6 + r] = axes[(r + 1) % 3] * axes[3 + (r + 2) % 3] - axes[(r + 2) % 3] * axes[3 + (r + 1) % 3];
  }
  double along(int k, const double* x, int stride = 1) const {
    double sum = 0;
    for (int r = 0; r < D; ++r) sum += axes[k * D + r] * x[r * stride];
    return sum;
  }
  // A segment, or with `half` a box along the columns of rot.
  void hold(const double* pos, const double* axis, const double* rot, const double* half) {
    for (int k = 0; k < D; ++k) {
      double centre = along(k, pos), size = axis ? std::abs(along(k, axis)) : 0;
      for (int j = 0; half && j < D; ++j) size += std::abs(along(k, rot + j, D)) * half[j];
      low[k] = std::min(low[k], centre - size);
      high[k] = std::max(high[k], centre + size);
    }
  }
  // Where this is in another box with these axes, from its centre; and half its size, a little more for round-off.
  void within(const Box& other, double* to) const {
    for (int k = 0; k < D; ++k) {
      to[k] = 0.5 * (low[k] + high[k] - other.low[k] - other.high[k]);
      to[D + k] = 0.5 * (high[k] - low[k]) * (1 + 1e-9) + 1e-12;
    }
  }
  void append(std::vector<double>& to) const {
    for (int r = 0; r < D; ++r) {
      double x = 0;
      for (int k = 0; k < D; ++k) x += axes[k * D + r] * 0.5 * (low[k] + high[k]);
      to.push_back(x);
    }
    to.insert(to.end(), axes, axes + D * D);
    for (int k = 0; k < D; ++k) to.push_back(0.5 * (high[k] - low[k]) * (1 + 1e-9) + 1e-12);  // round-off of the test itself
  }
};

}  // namespace

// Candidates of one pair of geoms, which stand together in their group.
void SceneData::derive_clusters() {
  constexpr int few = 3;
  Model& m = model;
  int D = m.D;
  std::vector<int> of_group{0}, begin, place(m.ncontact), touches(m.ncontact), frame;
  std::vector<double> boxA, boxB, round, weight, extent(m.ncontact * 2 * D);
  for (int g = 0; g < m.ngroup; ++g) {
    std::map<std::vector<double>, std::pair<int, int>> around;  // boxes on B: of which cluster first, of how many candidates
    for (int k = m.grp_cptr[g], end; k < m.grp_cptr[g + 1]; k = end) {
      int first = m.grp_con[k];
      auto alike = [&](int c) { return m.con_pair[c] == m.con_pair[first] && m.con_when[c] == m.con_when[first]; };
      for (end = k; end < m.grp_cptr[g + 1] && alike(m.grp_con[end]);) ++end;
      double none[3] = {}, heaviest = 0, most = 0;
      bool corner = is_corner(m, first);  // their axes only tell where the box is
      Box A(D, m.con_rotA + first * D * D, corner ? none : m.con_axisA + first * D);
      Box B(D, m.con_rotB + first * D * D, m.con_axisB + first * D);
      for (int x = k; x < end; ++x) {
        int c = m.grp_con[x];
        bool rim = m.con_type[c] == kRimPlane || m.con_type[c] == kDiscPlane || m.con_type[c] == kOvalPlane;  // or what is bent all around
        double radius = m.P[m.oContact + c * kContactFields + kRadius] + (rim ? length(m.con_axisA + c * D, D) : 0);
        const double* axis = rim || is_corner(m, c) ? nullptr : m.con_axisA + c * D;
        for_points(m, c, [&](const double* point) { A.hold(point, axis, nullptr, nullptr); });
        place[c] = x - k;
        touches[c] = end - k;
        for_points_of_B(m, c, [&](const double* point) { B.hold(point, m.con_axisB + c * D, m.con_rotB + c * D * D, m.con_halfB + c * D); });
        most = std::max(most, radius + margin_of(m, c));
        heaviest = std::max(heaviest, m.con_invweight[c]);
      }
      for (int x = k; x < end; ++x) {
        int c = m.grp_con[x];
        Box own(D, m.con_rotB + first * D * D, m.con_axisB + first * D);
        own.hold(m.con_posB + c * D, m.con_axisB + c * D, m.con_rotB + c * D * D, m.con_halfB + c * D);
        own.within(B, extent.data() + c * 2 * D);
      }
      begin.push_back(k);
      if (m.con_type[first] == kHulls) m.most_touches = std::max(m.most_touches, end - k);
      A.append(boxA);
      std::vector<double> box;
      B.append(box);
      boxB.insert(boxB.end(), box.begin(), box.end());
      auto& of_box = around.emplace(std::move(box), std::make_pair(int(begin.size()) - 1, 0)).first->second;
      frame.push_back(of_box.first);
      of_box.second += end - k;
      bool test = end - k > few || m.con_type[first] == kHulls;
      round.push_back(test ? most : -1);
      cluster_reach_.push_back(most);
      weight.push_back(heaviest);
      m.sifted |= test;
    }
    std::map<int, int> count;
    for (auto& [box, of_box] : around) count[of_box.first] = of_box.second;
    for (size_t c = of_group.back(); c < begin.size(); ++c) if (count[frame[c]] <= few) frame[c] = -1;
    of_group.push_back(int(begin.size()));
  }
  begin.push_back(m.ncontact);
  m.cluster_frame = keep_ints("cluster_frame", std::move(frame));
  m.grp_clusters = keep_ints("grp_clusters", std::move(of_group)); m.cluster_begin = keep_ints("cluster_begin", std::move(begin));
  m.cluster_boxA = keep_doubles("cluster_boxA", std::move(boxA)); m.cluster_boxB = keep_doubles("cluster_boxB", std::move(boxB));
  m.con_extentB = keep_doubles("con_extentB", std::move(extent));
  m.cluster_round = keep_doubles("cluster_round", std::move(round));
  m.con_corner = keep_ints("con_corner", std::move(place)); m.con_touches = keep_ints("con_touches", std::move(touches));
  m.cluster_invweight = keep_doubles("cluster_invweight", std::move(weight));
}

// Of one group, and alike in all that a row takes from its candidate by number.
void SceneData::derive_kins() {
  Model& m = model;
  std::vector<int> of_group{0}, kin(m.ncontact);
  for (int g = 0; g < m.ngroup; ++g) {
    std::map<std::tuple<int, int, int, int, int, int, double, double, double, double, double>, int> known;
    for (int k = m.grp_cptr[g]; k < m.grp_cptr[g + 1]; ++k) {
      int c = m.grp_con[k];
      auto key = std::make_tuple(m.con_type[c] == kRimPlane ? 1 : m.con_type[c] == kOvalPlane ? 2 : m.con_type[c] == kDiscPlane ? 3 : 0, m.con_plane[c], m.con_dim[c], m.con_law[c], m.con_pyramid[c], m.con_glide[c], m.con_impratio[c],
                                 m.con_invweight[c], m.con_margin[c], m.con_mid[c], m.con_power[c]);
      kin[c] = known.emplace(key, of_group.back() + int(known.size())).first->second;
    }
    of_group.push_back(of_group.back() + int(known.size()));
  }
  m.nkin = of_group.back();
  std::vector<int> ptr(m.nkin + 1, 0);
  for (int k : kin) ++ptr[k + 1];
  for (int k = 0; k < m.nkin; ++k) ptr[k + 1] += ptr[k];
  m.kin_ptr = keep_ints("kin_ptr", std::move(ptr));
  m.con_kin = keep_ints("con_kin", std::move(kin));
  m.grp_kin = keep_ints("grp_kin", std::move(of_group));
}

// Clusters instead of the candidates at which actuators pull: all of a pair of geoms, or none.
void SceneData::derive_grips() {
  Model& m = model;
  const std::vector<int>& con = ints_["grip_con"];
  std::vector<int> ptr{0}, cluster, of(m.ncontact);
  for (size_t k = 0; k + 1 < ints_["cluster_begin"].size(); ++k)
    for (int x = m.cluster_begin[k]; x < m.cluster_begin[k + 1]; ++x) of[m.grp_con[x]] = int(k);
  for (int k = 0; k < m.nwide; ++k) {
    std::set<int> found;
    for (int e = m.grip_ptr[k]; e < m.grip_ptr[k + 1]; ++e) found.insert(of[con[e]]);
    cluster.insert(cluster.end(), found.begin(), found.end());
    ptr.push_back(int(cluster.size()));
  }
  m.grip_ptr = keep_ints("grip_ptr", std::move(ptr));
  m.grip_cluster = keep_ints("grip_cluster", std::move(cluster));
}

}  // namespace cmbrl
