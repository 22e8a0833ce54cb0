// Where round shapes (balls, capsules, cylinders, ellipsoids) touch each other or polytopes, as MuJoCo has it: in one point, or, where a
// straight patch lies on another, in further ones, which appear as the shapes are turned a little against each other.
#pragma once
#include "hull_sides.hpp"
#include "round.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr double kStraight = 1e7;              // [m] radius of what is flat
constexpr double kClose = 1e-9;                // [m] within which the search finds how deep they are; then settle() does

static void bends_of(const Meeting& m, Touch& t) {
  Point bent[2][2], *of[2] = {bent[0], bent[1]}, along[2] = {across(m.n), {}};
  along[1] = cross(m.n, along[0]);
  for (int side = 0; side < 2; ++side) {
    const Patch& patch = side ? m.b : m.a;
    const Spot& spot = side ? m.on_b : m.on_a;
    int n = 0;
    if (patch.form == Form::flat) for (int k = 0; k < patch.flats; ++k) of[side][n++] = __builtin_sqrt(kStraight) * patch.flat[k];
    for (int k = 0; k < spot.bents && n < 2; ++k) of[side][n++] = spot.bent[k];
    while (n < 2) of[side][n++] = {};
  }
  double Q[2][2] = {{m.dist, 0}, {0, m.dist}};
  for (int i = 0; i < 2; ++i)
    for (int j = 0; j < 2; ++j)
      for (int k = 0; k < 4; ++k) Q[i][j] += dot(bent[k / 2][k % 2], along[i]) * dot(bent[k / 2][k % 2], along[j]);
  double det = Q[0][0] * Q[1][1] - Q[0][1] * Q[0][1], size = Q[0][0] + Q[1][1];
  double K[2][2] = {{Q[1][1] / det, -Q[0][1] / det}, {-Q[0][1] / det, Q[0][0] / det}};
  bool turns = det > 1e-12 * size * size || det > 1e-6 * size;
  for (int k = 0; k < 9; ++k) {
    t.slid[k] = 0;
    for (int i = 0; i < 2; ++i) for (int j = 0; j < 2; ++j) if (turns) t.slid[k] += K[i][j] * along[i].x[k / 3] * along[j].x[k % 3];
  }
  t.axisA = bent[0][0];
  t.axisB = bent[0][1];
}

static Touch touch_of(const Meeting& m) {
  Touch t{};
  t.a = m.on_a.at;
  t.n = m.n;
  t.dist = m.dist;
  t.bends = true;
  bends_of(m, t);
  return t;
}

// The sides of H around what touches, with which it may lie on another: those of a polytope, a cylinder's end (face -1).
struct Sides { int n = 0, face[Feet::most]; Point normal[Feet::most]; };

static Sides sides_of(const PosedHull& H, const int* corner, const Point& outwards) {
  Sides s;
  if (H.kind == kCylinder) {
    s.face[0] = -1;
    s.normal[s.n++] = dot(outwards, H.axis[2]) < 0 ? -1.0 * H.axis[2] : H.axis[2];
  }
  if (H.round()) return s;
  Feet feet(H, corner[0], corner[1], corner[2]);
  for (; s.n < feet.nside; ++s.n) {
    s.face[s.n] = feet.side[s.n];
    s.normal[s.n] = H.normal(feet.side[s.n]);
  }
  return s;
}

// MuJoCo takes a cylinder's end for a polygon.
static void take_polygon(const PosedHull& H, const Sides& sides, int k, Polygon& out) {
  constexpr int corners = 16;
  if (sides.face[k] >= 0) { take_side(H, sides.face[k], out); return; }
  Point v[corners];
  for (int i = 0; i < corners; ++i) {
    double angle = (dot(sides.normal[k], H.axis[2]) < 0 ? 2 : -2) * __builtin_acos(-1.0) * i / corners;
    v[i] = H.centre + H.length() * sides.normal[k] + H.half[0] * (__builtin_cos(angle) * H.axis[0] + __builtin_sin(angle) * H.axis[1]);
  }
  for (int i = 0; i < corners; ++i) out.add({v[i], Origin::own, false, v[(i + 1) % corners] - v[i], {}, {}});
}

static int lie_on_sides(const PosedHull& E, const Sides& e, const PosedHull& F, const Sides& f, bool e_is_a, Touch* out) {
  double least = -kLying;
  int of_e = -1, of_f = -1;
  for (int i = 0; i < f.n; ++i)
    for (int j = 0; j < e.n; ++j)
      if (dot(f.normal[i], e.normal[j]) < least) { least = dot(f.normal[i], e.normal[j]); of_e = j; of_f = i; }
  if (of_e < 0) return -1;
  Polygon polygon, side;
  take_polygon(E, e, of_e, polygon);
  take_polygon(F, f, of_f, side);
  return clip_to({e_is_a, true, e.normal[of_e], f.normal[of_f]}, side, polygon, false, out);
}

// The straight side of a capsule or cylinder E, or an edge of a polytope, on a side of F.
static int lies_along(const PosedHull& E, const int* corner, const PosedHull& F, const Sides& f, bool e_is_a, Touch* out) {
  for (int k = 0; k < f.n; ++k) {
    Point n = f.normal[k], along{}, v;
    Clip c{e_is_a, false, {}, n};
    if (E.kind == kCapsule || (E.kind == kCylinder && !F.round())) {  // MuJoCo lays no cylinder along the end of another one
      double tilt = dot(E.axis[2], n);
      if (__builtin_fabs(tilt) >= kLevel) continue;
      Point down = E.kind == kCapsule ? -1.0 * n : unit(tilt * E.axis[2] - n);
      v = E.centre - E.length() * E.axis[2] + E.half[0] * down;
      Polygon side, segment;
      take_polygon(F, f, k, side);
      take_segment(v, 2 * E.length() * E.axis[2], segment);
      int found = clip_to(c, side, segment, true, out);
      double back = -E.half[0] * dot(down, n);
      for (int i = 0; i < found; ++i) {  // the point stays under the axis as E rolls
        out[i].beside = -E.half[0] * down;
        out[i].back += e_is_a ? back : -back;
        out[i].leans = e_is_a;
      }
      return found;
    }
    if (E.round()) return 0;
    Feet feet(E, corner[0], corner[1], corner[2]);
    if (feet.n > 2) return 0;
    v = E.vertex(feet.at[0]);
    for_edges(E, feet, [&](int end) {
      Point edge = E.vertex(end) - v;
      if (dot(along, along) == 0 && __builtin_fabs(dot(unit(edge), n)) < kLevel) along = edge;
    });
    if (dot(along, along) == 0) continue;
    Polygon side, segment;
    take_polygon(F, f, k, side);
    take_segment(v, along, segment);
    return clip_to(c, side, segment, true, out);
  }
  return 0;
}

// a_first: A is MuJoCo's first geom of the two; many: what lies flat touches in several points. Returns how many of `out` there are.
static int touch_round(const PosedHull& A, const PosedHull& B, const Point& between, bool a_first, bool many, Touch* out) {
  Simplex simplex;
  Depth d;
  if (!overlap(A, B, between, simplex) || !find_depth(A, B, simplex, d, kClose)) return 0;
  Meeting first = meet(A, B, d);
  if (!(first.dist < 0)) return 0;
  if (many) {
    const Apart* c = d.corner;
    int of_a[3] = {c[0].a, c[1].a, c[2].a}, of_b[3] = {c[0].b, c[1].b, c[2].b};
    Sides a = sides_of(A, of_a, -1.0 * first.n), b = sides_of(B, of_b, first.n);
    int n = a_first ? lie_on_sides(B, b, A, a, false, out) : lie_on_sides(A, a, B, b, true, out);
    if (n < 0) n = lies_along(A, of_a, B, b, true, out);
    if (n <= 0) n = lies_along(B, of_b, A, a, false, out);
    if (n > 0) return n;
  }
  out[0] = touch_of(first);
  return 1;
}

}  // namespace cmbrl::CMBRL_ISA
