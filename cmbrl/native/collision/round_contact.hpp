// Where round shapes (balls, capsules, cylinders, ellipsoids) touch each other or polytopes, as MuJoCo has it: in one point, or, where a
// straight patch lies on another, in further ones, which appear as the shapes are turned a little against each other.
#pragma once
#include "collision/hull_sides.hpp"
#include "collision/round.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr double kFacing = 0.98;               // of normals: a side that lies on another, and the touch
constexpr double kClose = 1e-9;                // [m] within which the search finds how deep they are; then settle() does

// How the touch moves (bends.hpp). With the curvatures S of A and B and the motions p, q along what is straight of them, E and F,
//   (dist + S_A + S_B) dn = u + S_A w + E p + F q,   E^T dn = E^T w,   F^T dn = 0,   da = u + S_A (w - dn) + E p.
static void bends_of(const Meeting& m, Touch& t) {
  Point along[2] = {__builtin_fabs(m.n.x[0]) < 0.7 ? Point{{1, 0, 0}} : Point{{0, 1, 0}}, {}};  // as `tangents` has them (edges.hpp)
  along[0] = unit(along[0] - dot(along[0], m.n) * m.n);
  along[1] = cross(m.n, along[0]);
  double S[2][2][2] = {}, flat[4][2];
  int flats[2] = {m.a.form == Form::flat ? m.a.flats : 0, m.b.form == Form::flat ? m.b.flats : 0}, n = 2;
  if (flats[0] + flats[1] > 2) flats[flats[0] == 2] = 0;
  for (int side = 0; side < 2; ++side) {
    const Spot& spot = side ? m.on_b : m.on_a;
    for (int k = 0; k < spot.bents; ++k)
      for (int i = 0; i < 2; ++i)
        for (int j = 0; j < 2; ++j) S[side][i][j] += dot(spot.bent[k], along[i]) * dot(spot.bent[k], along[j]);
    for (int k = 0; k < flats[side]; ++k, ++n)
      for (int i = 0; i < 2; ++i) flat[n - 2][i] = dot((side ? m.b : m.a).flat[k], along[i]);
  }
  double found[16];  // dn by u and by w, da by u and by w
  for (int c = 0; c < 4; ++c) {  // of a unit of u (c < 2), and of w
    double A[4][5] = {}, x[4] = {}, u[2] = {double(c == 0), double(c == 1)}, w[2] = {double(c == 2), double(c == 3)};
    for (int i = 0; i < 2; ++i) {
      A[i][n] = u[i];
      for (int j = 0; j < 2; ++j) {
        A[i][j] = S[0][i][j] + S[1][i][j] + (i == j ? m.dist : 0);
        A[i][n] += S[0][i][j] * w[j];
      }
      for (int k = 2; k < n; ++k) {
        A[i][k] = -flat[k - 2][i];
        A[k][i] = flat[k - 2][i];
        if (k - 2 < flats[0]) A[k][n] += flat[k - 2][i] * w[i];
      }
    }
    if (solve_small(A, n)) for (int k = 0; k < n; ++k) x[k] = A[k][n];
    for (int i = 0; i < 2; ++i) {
      double moves = u[i];
      for (int j = 0; j < 2; ++j) moves += S[0][i][j] * (w[j] - x[j]);
      for (int k = 2; k < 2 + flats[0]; ++k) moves += flat[k - 2][i] * x[k];
      double* column = found + 4 * (c / 2) + 2 * i + c % 2;
      column[0] = x[i];
      column[8] = moves;
    }
  }
  t.axisA = {{found[0], found[1], found[3]}};  // N is symmetric
  for (int k = 0; k < 9; ++k) t.slid[k] = found[4 + k];
  t.axisB = {{found[13], found[14], found[15]}};
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

// The sides of H around what touches, with which it may lie on another, and which face it: those of a polytope, a cylinder's end (face -1).
struct Sides { int n = 0, face[Feet::most]; Point normal[Feet::most]; };

static Sides sides_of(const PosedHull& H, const int* corner, const Point& outwards) {
  Sides s;
  auto add = [&](int face, const Point& normal) {
    if (dot(normal, outwards) < kFacing) return;
    s.face[s.n] = face;
    s.normal[s.n++] = normal;
  };
  if (H.kind == kCylinder) add(-1, dot(outwards, H.axis[2]) < 0 ? -1.0 * H.axis[2] : H.axis[2]);
  if (H.round()) return s;
  Feet feet(H, corner[0], corner[1], corner[2]);
  for (int k = 0; k < feet.nside; ++k) add(feet.side[k], H.normal(feet.side[k]));
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
  return clip_to({e_is_a, true, e.normal[of_e], f.normal[of_f]}, side, polygon, false, F.reach, out);
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
      int found = clip_to(c, side, segment, true, F.reach, out);
      double back = -E.half[0] * dot(down, n);
      for (int i = 0; i < found; ++i) {  // the point stays under the axis as E rolls
        Point to_axis = -E.half[0] * down;
        out[i].back += e_is_a ? back : -back;
        if (E.kind == kCapsule) { out[i].a = out[i].a + to_axis; continue; }  // whose points are those of its axis, moved by F's normal
        out[i].beside = to_axis;
        out[i].axisB = E.axis[2];
        out[i].leans = e_is_a ? kRolls : kLifts;
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
    return clip_to(c, side, segment, true, F.reach, out);
  }
  return 0;
}

// a_first: A is MuJoCo's first geom of the two; many: what lies flat touches in several points. Returns how many of `out` there are.
static int touch_round(const PosedHull& A, const PosedHull& B, const Point& between, bool a_first, bool many, Touch* out) {
  Depth d;
  if (!find_rounded_depth(A, B, between, d, kClose)) return 0;
  Meeting first = meet(A, B, d);
  if (!(first.dist < A.reach)) return 0;
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
