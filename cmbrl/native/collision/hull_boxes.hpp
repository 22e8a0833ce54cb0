// Where two boxes touch, as MuJoCo has it: along the one of fifteen axes in which they overlap least (Gottschalk et al., SIGGRAPH 1996),
// where two edges cross, or with all corners of what a side of one covers of the other's that faces it.
#pragma once
#include "collision/hull_sides.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr double kEdgeBias = 1e-6, kNearSide = 0.99, kNearlyAsDeep = 0.05;  // MuJoCo's: where a side is taken for an edge axis

static int side_of_box(const PosedHull& H, int axis, double sign) {  // its number in the model
  return H.m->vertex_face[H.m->vertex_ptr[H.begin + 7]] + 2 * axis + (sign < 0);
}

// Half an edge of H along `axis`, at the corner that is farthest along d.
static Point edge_middle(const PosedHull& H, int axis, const Point& d) {
  Point x = H.centre;
  for (int k = 0; k < 3; ++k) if (k != axis) x = x + (dot(H.axis[k], d) >= 0 ? H.half[k] : -H.half[k]) * H.axis[k];
  return x;
}

static Touch crossing_edges(const PosedHull& A, int i, const PosedHull& B, int j, const Point& n, double depth) {
  Point a = edge_middle(A, i, -1.0 * n), apart = edge_middle(B, j, n) - a;
  double b = dot(A.axis[i], B.axis[j]), s = (dot(A.axis[i], apart) - b * dot(B.axis[j], apart)) / (1 - b * b);
  Point on_a = a + __builtin_fmin(__builtin_fmax(s, -A.half[i]), A.half[i]) * A.axis[i];
  Touch t = touch_at({true, false, {}, n}, own_point(on_a), -depth);
  t.edges = t.crossing = true;
  t.axisA = A.axis[i];
  t.axisB = B.axis[j];
  return t;
}

// X is MuJoCo's first box, Y its second; A the one of them from which Touch tells.
static int touch_boxes(const PosedHull& X, const PosedHull& Y, bool x_is_a, Touch* out) {
  Point apart = Y.centre - X.centre;
  double r[3][3], best = -1e300;
  for (int i = 0; i < 3; ++i) for (int j = 0; j < 3; ++j) r[i][j] = dot(X.axis[i], Y.axis[j]);
  int code = -1;
  for (int k = 0; k < 6; ++k) {  // sides of X, then of Y
    double reach = k < 3 ? X.half[k] : Y.half[k - 3];
    for (int j = 0; j < 3; ++j) reach += k < 3 ? __builtin_fabs(r[k][j]) * Y.half[j] : __builtin_fabs(r[j][k - 3]) * X.half[j];
    double gap = __builtin_fabs(dot(k < 3 ? X.axis[k] : Y.axis[k - 3], apart)) - reach;
    if (gap > X.reach) return 0;
    if (gap > best) { best = gap; code = k; }
  }
  int side = code;
  double of_side = best;
  Point n{};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      Point axis = cross(X.axis[i], Y.axis[j]);
      if (dot(axis, axis) < 1e-16) continue;
      axis = unit(axis);
      if (dot(axis, apart) < 0) axis = -1.0 * axis;
      double gap = dot(axis, apart);
      for (int k = 0; k < 3; ++k) gap -= __builtin_fabs(dot(axis, X.axis[k])) * X.half[k] + __builtin_fabs(dot(axis, Y.axis[k])) * Y.half[k];
      if (gap > X.reach) return 0;
      if (gap - kEdgeBias * __builtin_fabs(gap) > best && gap > of_side) { best = gap; code = 6 + 3 * i + j; n = axis; }
    }
  Point facing = side < 3 ? X.axis[side] : Y.axis[side - 3];
  if (code >= 6 && __builtin_fabs(dot(n, facing)) > kNearSide && best < of_side + kNearlyAsDeep * __builtin_fabs(of_side)) code = side;
  if (code >= 6) {
    int i = (code - 6) / 3, j = (code - 6) % 3;
    out[0] = x_is_a ? crossing_edges(X, i, Y, j, -1.0 * n, -best) : crossing_edges(Y, j, X, i, n, -best);
    return 1;
  }
  const PosedHull &F = code < 3 ? X : Y, &E = code < 3 ? Y : X;  // the side's box, and the one that is clipped to it
  int of_f = code % 3, of_e = 0;
  double towards = dot(F.axis[of_f], E.centre - F.centre) >= 0 ? 1 : -1;
  for (int k = 1; k < 3; ++k)
    if (__builtin_fabs(dot(F.axis[of_f], E.axis[k])) > __builtin_fabs(dot(F.axis[of_f], E.axis[of_e]))) of_e = k;
  double back = towards * dot(F.axis[of_f], E.axis[of_e]) > 0 ? -1 : 1;
  Clip c{(code < 3) != x_is_a, false, back * E.axis[of_e], towards * F.axis[of_f]};
  Polygon polygon;
  take_side(E, side_of_box(E, of_e, back), polygon);
  return clip_to_side(c, F, side_of_box(F, of_f, towards), polygon, false, out, kMostTouches);
}

}  // namespace cmbrl::CMBRL_ISA
