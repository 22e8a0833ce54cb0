// Where shapes touch a height field (field.hpp): each prism near them as a convex hull, as in MuJoCo, or, where rows look ahead, the
// field's surface alone.
#pragma once
#include "collision/capsule_box.hpp"
#include "collision/field.hpp"
#include "collision/hull_boxes.hpp"
#include "collision/polytope_contact.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr int kMostOfField = 50;   // touches of a shape and a field, as in MuJoCo
constexpr double kOnEdge = 1e-6;   // of a cell: what is so near an edge of a triangle lies on it

// first: A is MuJoCo's first geom of the two; many: what lies flat touches in several points. Returns how many of `out` there are.
static int touches_of(const PosedHull& A, const PosedHull& B, const Point& between, bool first, bool many, Touch* out) {
  int n = -1;
  if (A.kind == kBox && B.kind == kBox) return first ? touch_boxes(A, B, true, out) : touch_boxes(B, A, false, out);
  if (A.kind == kCapsule && B.kind == kBox) n = touch_capsule_box({A, B, true}, out);
  else if (A.kind == kBox && B.kind == kCapsule) n = touch_capsule_box({B, A, false}, out);
  if (n >= 0) return n;
  return A.round() || B.round() ? touch_round(A, B, between, first, many, out) : touch_polytopes(A, B, between, first, many, out);
}

// What a touch of a prism is to the field: at the nearest point of it around there; at another one, to which an edge or a side leads
// that the field has not, over which what slides would trip; or below the surface, at the side of a neighbour. flat: it is one of
// several of what lies on the triangle, whose normals are not quite the triangle's.
enum class Place { surface, hidden, below };
static Place place_of(const PosedField& f, const Prism& P, const Touch& t, bool flat) {
  Point b = t.a + t.beside - (t.back + t.dist) * t.n, from = b - P.corner(3), up = P.up();
  double least = __builtin_fmin(f.step[0], f.step[1]), close = kOnEdge * least;
  Point local = b - f.corner;
  double x = dot(local, f.axis[0]), y = dot(local, f.axis[1]);
  if (dot(up, from) < -1e-3 * least) {  // below the surface: at the field's border alone
    bool border = x < close || y < close || x > (f.columns - 1) * f.step[0] - close || y > (f.rows - 1) * f.step[1] - close;
    return border ? Place::surface : Place::below;
  }
  bool lies = dot(t.n, up) > kLying;
  Point n = flat && lies ? up : t.n;
  bool corner[3] = {true, true, true};  // of the triangle, what lies on the part that b is on
  for (int k = 0; k < 3; ++k) {         // across the edge against corner k
    Point along = P.corner(3 + (k + 2) % 3) - P.corner(3 + (k + 1) % 3), in = unit(cross(up, along));
    if (dot(in, b - P.corner(3 + (k + 1) % 3)) < close) corner[k] = false;
  }
  if (corner[0] && corner[1] && corner[2]) return lies ? Place::surface : Place::hidden;
  for (int r = P.row[0] - 1; r <= P.row[2] + 1; ++r)  // of all triangles around that part
    for (int c = P.column[0] - 1; c <= P.column[2] + 1; ++c) {
      if (r < 0 || c < 0 || r >= f.rows || c >= f.columns) continue;
      bool shares = true;
      for (int k = 0; k < 3; ++k) {
        if (!corner[k]) continue;
        int dr = r - P.row[k], dc = c - P.column[k];
        shares &= dr * dr <= 1 && dc * dc <= 1 && dr * dc >= 0;  // the diagonal of a cell goes one way
      }
      Point to = f.top(r, c) - b;
      if (shares && dot(n, to) > close + 1e-6 * size_of(to)) return Place::hidden;
    }
  return Place::surface;
}

// The lowest point of A over the triangle's plane, if it is over or under the triangle: what is so deep that the nearest way out of
// the prism is sideways goes upwards still.
static bool touch_top(const PosedHull& A, const Prism& P, Touch& out) {
  Point up = P.up(), down = -1.0 * up;
  Patch part{Form::flat, {}, {}, 0, 0, 1e300, &A};
  if (A.kind == kEllipsoid) part.form = Form::ellipsoid;
  else if (!A.round()) part.base = A.vertex(A.farthest(down));
  else {
    double end = A.kind == kBall ? 0 : dot(A.axis[2], down) < 0 ? -A.length() : A.length();
    part.base = A.centre + end * A.axis[2];
    part.radius = A.half[0];
    part.flat[0] = A.axis[2];
    if (A.kind == kCylinder) part.form = Form::rim;
  }
  double none[2] = {};
  Meeting m{};
  m.n = up;
  m.a = part;
  m.on_a = spot_on(part, none, down);
  m.dist = dot(up, m.on_a.at - P.corner(3));
  Point b = m.on_a.at - m.dist * up;
  for (int k = 0; k < 3; ++k) {
    Point from = P.corner(3 + k), along = P.corner(3 + (k + 1) % 3) - from;
    if (dot(cross(up, along), b - from) < 0) return false;
  }
  m.b = {Form::flat, b, {unit(P.corner(4) - P.corner(3)), {}}, 2, 0, 1e300, nullptr};
  m.b.flat[1] = cross(up, m.b.flat[0]);
  m.on_b = spot_on(m.b, none, up);
  out = touch_of(m);
  return m.dist < A.reach;
}

// Touches of a field that are kept, at most `most`: the first ones, or none twice and, once there is no room, the deepest.
struct FieldTouches {
  Touch* out;
  int most, n = 0;
  double same;  // [m]
  Touch refused[kMostOfField];
  int nrefused = 0;

  // That of a prism which is none of the surface. If it is much deeper than all that are, the surface alone would let the shape through:
  // a peak that is near the side of a box, for which the shortest way out leads there. What
  // begins deeper than a tenth of a cell is left to touch_top.
  void refuse(const Touch& t) { if (t.dist < 0 && nrefused < kMostOfField) refused[nrefused++] = t; }
  void take_deeper() {
    constexpr double much = 1.5, shallow = 0.1 / kOnEdge;
    double deepest = 0;
    for (int k = 0; k < n; ++k) deepest = __builtin_fmin(deepest, out[k].dist);
    for (int k = 0; k < nrefused; ++k) if (refused[k].dist < much * deepest - same && refused[k].dist > -shallow * same) add(refused[k]);
  }

  void add_any(const Touch& t) { if (n < most) out[n++] = t; }
  void add(const Touch& t) {
    int at = n;
    for (int k = 0; k < n; ++k) if (size_of(out[k].a - t.a) < same && dot(out[k].n, t.n) > 1 - 1e-9) return;
    if (n == most) {
      at = 0;
      for (int k = 1; k < n; ++k) if (out[k].dist > out[at].dist) at = k;
      if (out[at].dist <= t.dist) return;
    } else {
      ++n;
    }
    out[at] = t;
  }
};

// Adds the touches of shape A and one prism, whose top is what is looked at first.
static void touch_prism(const PosedHull& A, const PosedField& f, const Prism& prism, const PosedHull& B, bool surface, FieldTouches& found) {
  Touch touch[kMostTouches];
  bool sunk = false;
  A.nmade = 0;
  int n = touches_of(A, B, -1.0 * prism.up(), false, surface, touch);
  for (int k = 0; k < n; ++k) {
    Place place = surface ? place_of(f, prism, touch[k], n > 1) : Place::surface;
    if (!surface) found.add_any(touch[k]);
    else if (place == Place::surface) found.add(touch[k]);
    else found.refuse(touch[k]);
    sunk |= place == Place::below;
  }
  if (sunk && touch_top(A, prism, touch[0])) found.add(touch[0]);
  A.nmade = 0;
}

// Of shape A and a field. surface: only touches of the field itself, each once, and all points of what lies flat;
// otherwise MuJoCo's: one of each prism that A overlaps, edges of neighbours too. Returns how many of `out` there are.
static int touch_field(const Model& m, const PosedHull& A, const PosedField& f, bool surface, Touch* out, int most) {
  Range range(A, f);
  FieldTouches found;
  found.out = out;
  found.most = most < kMostOfField ? most : kMostOfField;
  found.same = kOnEdge * __builtin_fmin(f.step[0], f.step[1]);
  for (int r = range.first[1]; r < range.last[1]; ++r)
    for (int c = range.first[0]; c < range.last[0]; ++c) {
      if (!range.reaches(f, r, c)) continue;
      for (int which = 0; which < 2; ++which) {
        if (!range.meets(f, r, c, which)) continue;
        Prism prism(f, r, c, which);
        Point down = -1.0 * prism.up();
        double room = A.reach - dot(down, prism.corner(3));  // over the triangle's plane
        if (-A.at_most(down) > room || -A.extent(down) > room) continue;
        prism.complete(f);
        touch_prism(A, f, prism, prism.hull(m, A.reach), surface, found);
      }
    }
  found.take_deeper();
  return found.n;
}

}  // namespace cmbrl::CMBRL_ISA
