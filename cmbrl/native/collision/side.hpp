// The side of a mesh that lies towards a plane, as MuJoCo has it: of the sides around the lowest vertex of its hull the one that
// turns most towards the plane. It touches with its corners, at most four: the lowest vertex, and three that span much with it.
// Where rows do not look ahead, the first four candidates of such a pair are these corners.
#pragma once
#include "collision/contact.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr int kCorners = 4;

struct Corners { int n, at[kCorners]; };

// Of a polygon with corner `first`: MuJoCo's walk, which turns the other three on for as long as the area between them grows.
static Corners wide_corners(const double* points, const int* polygon, int n, int first) {
  auto number = [&](int k) { return polygon[(first + k) % n]; };
  if (n <= kCorners) {
    Corners all{n, {}};
    for (int k = 0; k < n; ++k) all.at[k] = number(k);
    return all;
  }
  auto area = [&](int b, int c, int d) {  // squared, of the quadrilateral from `first` on, four times
    double x[2][3], sum = 0;
    for (int j = 0; j < 3; ++j) {
      x[0][j] = points[3 * number(c) + j] - points[3 * number(0) + j];
      x[1][j] = points[3 * number(d) + j] - points[3 * number(b) + j];
    }
    for (int j = 0; j < 3; ++j) {
      double y = x[0][(j + 1) % 3] * x[1][(j + 2) % 3] - x[0][(j + 2) % 3] * x[1][(j + 1) % 3];
      sum += y * y;
    }
    return sum;
  };
  int b = 1, c = 2, d = 3;
  double most = area(b, c, d);
  auto grows = [&](int b, int c, int d) {
    double now = area(b, c, d);
    if (now <= most) return false;
    most = now;
    return true;
  };
  while (d + 1 < n && grows(b, c, d + 1)) {
    ++d;
    while (c + 1 < d && grows(b, c + 1, d)) ++c;
    while (b + 1 < c && grows(b + 1, c, d)) ++b;
  }
  return {kCorners, {number(0), number(b), number(c), number(d)}};
}

// Those of the side around a vertex that turns most towards -up.
static Corners corners_towards(const Model& m, int vertex, const double* up) {
  int best = -1;
  double least = 1e300;
  for (int k = m.vertex_ptr[vertex]; k < m.vertex_ptr[vertex + 1]; ++k) {
    const double* normal = m.face_normal + 3 * m.vertex_face[k];
    double along = normal[0] * up[0] + normal[1] * up[1] + normal[2] * up[2];
    if (best < 0 || along < least) { least = along; best = m.vertex_face[k]; }
  }
  const int* polygon = m.face_vertex + m.face_ptr[best];
  int n = m.face_ptr[best + 1] - m.face_ptr[best], first = 0;
  while (polygon[first] != vertex) ++first;
  return wide_corners(m.hull_point, polygon, n, first);
}

// The corners of candidate i's pair of geoms, in the frame of the mesh's body, into w.side; w.side_there: the lanes that have as many.
template <class G>
static void find_side(const Model& m, Work<G>& w, int i) {
  if (w.side_of == m.con_pair[i]) return;
  w.side_of = m.con_pair[i];
  if constexpr (G::D == 3) {
    int hull = m.con_hull[i], begin = m.hull_ptr[hull], end = m.hull_ptr[hull + 1];
    typename G::V up = G::unrotate(w.R[m.con_bodyA[i]], plane_normal<G>(m, m.con_plane[i]));
    T lowest = splat(1e300), vertex = splat(begin);
    for (int k = begin; k < end; ++k) {
      T height = dot(up, load<3>(m.hull_point + 3 * k));
      vertex = select(height < lowest, splat(k), vertex);
      lowest = vmin(lowest, height);
    }
    for (int lane = 0; lane < W; ++lane) {
      double direction[3] = {up[0][lane], up[1][lane], up[2][lane]};
      Corners corners = corners_towards(m, int(vertex[lane]), direction);
      for (int k = 0; k < kCorners; ++k) {
        w.side_there[k][lane] = k < corners.n ? -1 : 0;
        const double* point = m.hull_point + 3 * corners.at[k < corners.n ? k : 0];
        CMBRL_FOR(j, 3) w.side[k][j][lane] = point[j];
      }
    }
  }
}

}  // namespace cmbrl::CMBRL_ISA
