// Where two polytopes touch, as MuJoCo has it: sides or edges that lie on a side with their corners, all others in one point.
#pragma once
#include "collision/round_contact.hpp"

namespace cmbrl::CMBRL_ISA {

// a_first: A is MuJoCo's first geom of the two. Returns how many of `out` there are.
static int touch_polytopes(const PosedHull& A, const PosedHull& B, const Point& between, bool a_first, bool many, Touch* out) {
  Depth d;
  if (!find_depth(A, B, between, d)) return 0;
  const Apart* c = d.corner;
  Feet a(A, c[0].a, c[1].a, c[2].a), b(B, c[0].b, c[1].b, c[2].b);
  if (many) {
    int n = a_first ? side_on_side(B, b, A, a, false, out) : side_on_side(A, a, B, b, true, out);
    if (n < 0) {
      bool edge_a = a.n < 3 && (a_first ? a.n <= b.n : !(b.n < 3 && b.n <= a.n));
      n = edge_a ? edge_on_side(A, a, B, b, true, out) : b.n < 3 ? edge_on_side(B, b, A, a, false, out) : 0;
    }
    if (n > 0) return n;
  }
  if (d.depth < 0) {  // what is apart is nearest along the line between both points
    out[0] = touch_of(meet(A, B, d));
    return 1;
  }
  if (a.n == 1 || b.n == 1) {
    bool of_a = a.n == 1;
    Point v = of_a ? A.vertex(a.at[0]) : B.vertex(b.at[0]);
    out[0] = touch_at({of_a, false, {}, of_a ? -1.0 * d.n : d.n}, own_point(v), -d.depth);
    return 1;
  }
  Point x = c[0].x, u = c[1].x - x, v = c[2].x - x, to = d.depth * d.n - x;  // the nearest point in the side's own coordinates
  double uu = dot(u, u), uv = dot(u, v), vv = dot(v, v), det = uu * vv - uv * uv;
  double s = (dot(to, u) * vv - dot(to, v) * uv) / det, t = (dot(to, v) * uu - dot(to, u) * uv) / det;
  Point on_a = (1 - s - t) * A.vertex(c[0].a) + s * A.vertex(c[1].a) + t * A.vertex(c[2].a);
  out[0] = touch_at({true, false, {}, -1.0 * d.n}, own_point(on_a), -d.depth);
  if (a.n == 2 && b.n == 2) {
    out[0].edges = out[0].crossing = true;
    out[0].axisA = A.vertex(a.at[1]) - A.vertex(a.at[0]);
    out[0].axisB = B.vertex(b.at[1]) - B.vertex(b.at[0]);
  }
  return 1;
}

}  // namespace cmbrl::CMBRL_ISA
