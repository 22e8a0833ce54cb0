// Height fields: a prism under each of the two triangles of a cell, as MuJoCo has them. What stands near a cell touches its
// prisms, each as a convex hull; all other cells are never looked at.
#pragma once
#include "capsule_box.hpp"
#include "hull_boxes.hpp"
#include "polytope_contact.hpp"

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

// A field in the world: heights above a corner of its base, along its own axes, by rows along the second one.
struct PosedField {
  Point corner, axis[3];
  double step[2];
  int rows, columns;
  const double* heights;

  PosedField(const Model& m, int hull, const Point& origin) {
    const double *box = m.hull_box + 15 * hull, *half = box + 12;
    int field = m.hull_field[hull];
    rows = m.field_size[2 * field];
    columns = m.field_size[2 * field + 1];
    heights = m.field_height + m.field_ptr[field];
    for (int j = 0; j < 3; ++j) {
      corner.x[j] = box[j] - origin.x[j];
      for (int k = 0; k < 3; ++k) {
        axis[k].x[j] = box[3 + 3 * k + j];
        corner.x[j] -= half[k] * axis[k].x[j];
      }
    }
    step[0] = 2 * half[0] / (columns - 1);
    step[1] = 2 * half[1] / (rows - 1);
  }
  double height(int r, int c) const { return heights[r * columns + c]; }
  Point base(int r, int c) const { return corner + (c * step[0]) * axis[0] + (r * step[1]) * axis[1]; }
  Point top(int r, int c) const { return base(r, c) + height(r, c) * axis[2]; }
};

// One of the two triangles of a cell, against the clock from the first corner on as seen from above, and the prism under it.
struct Prism {
  int row[3], column[3];
  double point[18], columns[3 * Model::hull_width], normal[15];  // of the base, then of the top; normals as the prism's sides stand in the model

  Prism(const PosedField& f, int r, int c, int which) {
    const int dr[2][3] = {{1, 0, 1}, {0, 0, 1}}, dc[2][3] = {{0, 0, 1}, {0, 1, 1}};
    for (int k = 0; k < 3; ++k) {
      row[k] = r + dr[which][k];
      column[k] = c + dc[which][k];
      set(k, f.base(row[k], column[k]));
      set(3 + k, f.top(row[k], column[k]));
    }
    set_normal(0, unit(cross(corner(4) - corner(3), corner(5) - corner(3))));
  }
  // What only a shape needs that is not above the triangle.
  void complete(const PosedField& f) {
    for (int k = 0; k < 3; ++k) set_normal(2 + k, unit(cross(corner((k + 1) % 3) - corner(k), f.axis[2])));
    set_normal(1, -1.0 * f.axis[2]);
    for (int j = 0; j < 3; ++j)
      for (int k = 0; k < Model::hull_width; ++k) columns[j * Model::hull_width + k] = point[3 * (k < 6 ? k : 5) + j];
  }
  Point corner(int k) const { return {{point[3 * k], point[3 * k + 1], point[3 * k + 2]}}; }
  Point up() const { return {{normal[0], normal[1], normal[2]}}; }
  Point middle() const {
    Point sum{};
    for (int k = 0; k < 6; ++k) sum = sum + (1.0 / 6) * corner(k);
    return sum;
  }
  PosedHull hull(const Model& m, double reach) const {
    PosedHull H;
    H.m = &m;
    H.kind = kPolytope;
    H.reach = reach;
    H.begin = H.first_point = m.hull_ptr[m.prism];
    H.first_face = m.vertex_face[m.vertex_ptr[H.begin + 3]];  // its top, which is the first around the first corner of it
    H.vertices = 6;
    H.count = Model::hull_width;
    H.points = point;
    H.normals = normal;
    H.columns = columns;
    H.made = nullptr;
    H.nmade = 0;
    H.p = {};
    for (int k = 0; k < 9; ++k) H.R[k] = k % 4 == 0;
    return H;
  }

 private:
  void set(int k, const Point& x) { for (int j = 0; j < 3; ++j) point[3 * k + j] = x.x[j]; }
  void set_normal(int k, const Point& x) { for (int j = 0; j < 3; ++j) normal[3 * k + j] = x.x[j]; }
};

// Of a shape, how far it extends along d.
static double extent(const PosedHull& H, const Point& d) {
  return dot(d, H.round() ? H.round_point(d) : H.vertex(H.farthest(d)));
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

// Touches of a field that are kept: at most `most`, none twice; once there is no room, the deepest.
struct FieldTouches {
  Touch* out;
  int most, n = 0;
  double same;  // [m]

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

// Of shape A, about `centre`, and a field. surface: only touches of the field itself, each once, and all points of what lies flat;
// otherwise MuJoCo's: one of each prism that A overlaps, edges of neighbours too. Returns how many of `out` there are.
static int touch_field(const Model& m, const PosedHull& A, const Point& centre, const PosedField& f, bool surface, Touch* out, int most) {
  int first[2], last[2];
  double low = -extent(A, -1.0 * f.axis[2]) - dot(f.axis[2], f.corner);
  for (int k = 0; k < 2; ++k) {
    double at = dot(f.axis[k], f.corner), from = -extent(A, -1.0 * f.axis[k]) - A.reach - at, to = extent(A, f.axis[k]) + A.reach - at;
    int cells = (k ? f.rows : f.columns) - 1;
    if (!(to >= 0 && from <= cells * f.step[k])) return 0;
    first[k] = from > 0 ? int(from / f.step[k]) : 0;
    last[k] = to < cells * f.step[k] ? int(__builtin_ceil(to / f.step[k])) : cells;
  }
  Point across = unit(f.step[0] * f.axis[1] - f.step[1] * f.axis[0]);  // from the diagonals of all cells towards their first triangles
  double least = -extent(A, -1.0 * across) - A.reach - dot(across, f.corner), farthest = extent(A, across) + A.reach - dot(across, f.corner);
  FieldTouches found{out, most < kMostOfField ? most : kMostOfField, 0, kOnEdge * __builtin_fmin(f.step[0], f.step[1])};
  for (int r = first[1]; r < last[1]; ++r)
    for (int c = first[0]; c < last[0]; ++c) {
      double most_high = __builtin_fmax(__builtin_fmax(f.height(r, c), f.height(r, c + 1)), __builtin_fmax(f.height(r + 1, c), f.height(r + 1, c + 1)));
      if (most_high < low - A.reach) continue;
      double diagonal = dot(across, f.base(r, c) - f.corner);
      for (int which = 0; which < 2; ++which) {
        if (which ? least > diagonal : farthest < diagonal) continue;
        A.nmade = 0;
        Prism prism(f, r, c, which);
        Point up = prism.up();
        if (-extent(A, -1.0 * up) - dot(up, prism.corner(3)) > A.reach) continue;
        prism.complete(f);
        A.nmade = 0;
        Touch touch[kMostTouches];
        PosedHull B = prism.hull(m, A.reach);
        int n = touches_of(A, B, prism.middle() - centre, false, surface, touch);
        bool sunk = false;
        for (int k = 0; k < n; ++k) {
          if (!surface) { if (found.n < found.most) out[found.n++] = touch[k]; continue; }
          Place place = place_of(f, prism, touch[k], n > 1);
          if (place == Place::surface) found.add(touch[k]);
          sunk |= place == Place::below;
        }
        A.nmade = 0;
        if (sunk && touch_top(A, prism, touch[0])) found.add(touch[0]);
      }
    }
  A.nmade = 0;
  return found.n;
}

}  // namespace cmbrl::CMBRL_ISA
