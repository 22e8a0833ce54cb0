// Parts of convex shapes near the point where they touch: a corner, an edge or a side, rounded off or not, a rim, an ellipsoid; and where
// two of them are nearest, to all digits. The search of hull_depth.hpp, which takes round shapes for polytopes, says which parts they are.
#pragma once
#include "collision/hull_depth.hpp"

namespace cmbrl::CMBRL_ISA {

enum class Form { flat, rim, ellipsoid };
// flat: points base + t flat, rounded off by `radius`. A rim goes around flat[0]. There, t is at most `most` in size.
struct Patch { Form form; Point base, flat[2]; int flats; double radius, most; const PosedHull* shape; };

// Where a part is farthest along a direction: there; t; and roots of its curvature, of which points move by bent bent' as the direction turns.
struct Spot { Point at, bent[2]; int bents; };

static Point across(const Point& d) {  // a unit vector across d
  int least = 0;
  for (int k = 1; k < 3; ++k) if (__builtin_fabs(d.x[k]) < __builtin_fabs(d.x[least])) least = k;
  Point x{};
  x.x[least] = 1;
  return unit(cross(d, x));
}

static Spot spot_on(const Patch& part, const double* t, const Point& d) {
  Spot s{};
  if (part.form == Form::ellipsoid) {
    const PosedHull& H = *part.shape;
    Point y{}, p[2];
    for (int k = 0; k < 3; ++k) y.x[k] = H.half[k] * dot(H.axis[k], d);
    double root = __builtin_sqrt(size_of(y));
    p[0] = across(y);
    p[1] = cross(unit(y), p[0]);
    s.at = H.round_point(d);
    for (s.bents = 0; s.bents < 2; ++s.bents)
      for (int k = 0; k < 3; ++k) s.bent[s.bents] = s.bent[s.bents] + (H.half[k] * p[s.bents].x[k] / root) * H.axis[k];
    return s;
  }
  s.at = part.base;
  if (part.form == Form::rim) {
    Point out = d - dot(d, part.flat[0]) * part.flat[0];
    double size = __builtin_fmax(size_of(out), 1e-9);
    s.at = s.at + (part.radius / size) * out;
    s.bent[s.bents++] = (__builtin_sqrt(part.radius / size) / size) * cross(part.flat[0], out);
    return s;
  }
  Point out = d;
  for (int k = 0; k < part.flats; ++k) {
    s.at = s.at + t[k] * part.flat[k];
    out = out - dot(d, part.flat[k]) * part.flat[k];
  }
  if (part.radius == 0) return s;
  out = unit(out);
  s.at = s.at + part.radius * out;
  Point first = part.flats ? cross(part.flat[0], out) : across(out);
  s.bent[s.bents++] = __builtin_sqrt(part.radius) * first;
  if (!part.flats) s.bent[s.bents++] = __builtin_sqrt(part.radius) * cross(out, first);
  return s;
}

// The part of H that the side of the polytope with `corner` says, which touches at x with direction d outwards.
static Patch patch_of(const PosedHull& H, const int* corner, const Point& x, const Point& d) {
  Patch part{Form::flat, {}, {}, 0, 0, 1e300, &H};
  if (!H.round()) {
    part.base = H.vertex(corner[0]);
    Point middle = part.base;
    for (int k = 1; k < 3; ++k) {
      Point edge = H.vertex(corner[k]) - part.base;
      double size = size_of(edge);
      if (part.flats) edge = edge - dot(edge, part.flat[0]) * part.flat[0];
      if (size == 0 || size_of(edge) < 1e-6 * size) continue;
      part.flat[part.flats++] = unit(edge);
      middle = middle + 0.5 * edge;
      part.most = 0.5 * size;
    }
    if (part.flats == 1) part.base = middle;
    else part.most = 1e300;
    return part;
  }
  if (H.kind == kEllipsoid) { part.form = Form::ellipsoid; return part; }
  part.base = H.centre;
  part.radius = H.half[0];
  if (H.kind == kBall) return part;
  double low = 1e300, high = -1e300, up = dot(x - H.centre, H.axis[2]) < 0 ? -1 : 1;
  for (int k = 0; k < 3; ++k) {
    double at = dot(H.vertex(corner[k]) - H.centre, H.axis[2]);
    low = at < low ? at : low;
    high = at > high ? at : high;
  }
  part.flat[0] = H.axis[2];
  if (high - low > H.length()) {  // the side, which is straight along the axis
    part.flats = 1;
    part.most = H.length();
    return part;
  }
  part.base = H.centre + up * H.length() * H.axis[2];
  if (H.kind == kCapsule) return part;
  if (size_of(cross(d, H.axis[2])) > 1e-7) { part.form = Form::rim; return part; }
  part.radius = 0;
  part.flat[0] = H.axis[0];
  part.flat[1] = H.axis[1];
  part.flats = 2;
  return part;
}

// Two parts that touch: n leads from B to A, dist is negative where they overlap.
struct Meeting { Patch a, b; Spot on_a, on_b; Point n; double dist; };

static void put(Meeting& m, const double* ta, const double* tb) {
  m.on_a = spot_on(m.a, ta, -1.0 * m.n);
  m.on_b = spot_on(m.b, tb, m.n);
}

// Solves A x = b of at most four unknowns; false where there is no pivot.
static bool solve_small(double A[4][5], int n) {
  for (int c = 0; c < n; ++c) {
    int best = c;
    for (int r = c + 1; r < n; ++r) if (__builtin_fabs(A[r][c]) > __builtin_fabs(A[best][c])) best = r;
    if (!(__builtin_fabs(A[best][c]) > 1e-14)) return false;
    for (int k = c; k <= n; ++k) { double x = A[c][k]; A[c][k] = A[best][k]; A[best][k] = x; }
    for (int r = 0; r < n; ++r) {
      if (r == c) continue;
      double f = A[r][c] / A[c][c];
      for (int k = c; k <= n; ++k) A[r][k] -= f * A[c][k];
    }
  }
  for (int r = 0; r < n; ++r) A[r][n] /= A[r][r];
  return true;
}

static double curved(const Spot& s, const Point& x, const Point& y) {
  double sum = 0;
  for (int k = 0; k < s.bents; ++k) sum += dot(s.bent[k], x) * dot(s.bent[k], y);
  return sum;
}

// Newton's method for where a - b is along n, and n across all that is flat.
static bool settle(Meeting& m) {
  constexpr int most = 30;
  double ta[2] = {}, tb[2] = {};
  if (m.a.flats + m.b.flats > 2) return false;
  for (int k = 0; k < m.a.flats; ++k) ta[k] = dot(m.on_a.at - m.a.base, m.a.flat[k]);
  for (int k = 0; k < m.b.flats; ++k) tb[k] = dot(m.on_b.at - m.b.base, m.b.flat[k]);
  for (int step = 0; step < most; ++step) {
    put(m, ta, tb);
    Point apart = m.on_a.at - m.on_b.at, t[2] = {across(m.n), {}};
    t[1] = cross(m.n, t[0]);
    m.dist = dot(apart, m.n);
    double A[4][5] = {};
    int n = 2;
    for (int i = 0; i < 2; ++i) {
      for (int j = 0; j < 2; ++j) A[i][j] = curved(m.on_a, t[i], t[j]) + curved(m.on_b, t[i], t[j]) + (i == j ? m.dist : 0);
      A[i][4] = dot(t[i], apart);
    }
    auto add = [&](const Patch& part, int k, double sign) {
      for (int i = 0; i < 2; ++i) {
        A[i][n] = -sign * dot(t[i], part.flat[k]);
        A[n][i] = dot(t[i], part.flat[k]);
      }
      A[n][4] = -dot(part.flat[k], m.n);
      ++n;
    };
    for (int k = 0; k < m.a.flats; ++k) add(m.a, k, 1);
    for (int k = 0; k < m.b.flats; ++k) add(m.b, k, -1);
    for (int i = 0; i < n; ++i) A[i][n] = A[i][4];
    if (!solve_small(A, n)) return false;
    double turn = __builtin_sqrt(A[0][n] * A[0][n] + A[1][n] * A[1][n]), share = turn > 0.3 ? 0.3 / turn : 1;
    m.n = unit(m.n + share * A[0][n] * t[0] + share * A[1][n] * t[1]);
    for (int k = 0; k < m.a.flats; ++k) ta[k] += share * A[2 + k][n];
    for (int k = 0; k < m.b.flats; ++k) tb[k] += share * A[2 + m.a.flats + k][n];
    if (turn < 1e-12) {
      put(m, ta, tb);
      m.dist = dot(m.on_a.at - m.on_b.at, m.n);
      return __builtin_fabs(ta[0]) <= m.a.most && __builtin_fabs(tb[0]) <= m.b.most;
    }
  }
  return false;
}

// Whether no point of H is farther along d than the spot x.
static bool farthest_at(const PosedHull& H, const Point& x, const Point& d) {
  Point far = H.round() ? H.round_point(d) : H.vertex(H.farthest(d));
  return dot(far - x, d) < 1e-7;
}

// Parts of H that may touch near x, by its side of the polytope: the likely ones first.
struct Parts {
  static constexpr int most = 7;
  Patch at[most];
  int n = 0;

  Parts(const PosedHull& H, const int* corner, const Point& x) {
    auto add = [&](Form form, const Point& base, double radius, double reach) -> Patch& {
      return at[n++] = {form, base, {}, 0, radius, reach, &H};
    };
    if (H.kind == kEllipsoid || H.kind == kBall) {
      add(H.kind == kBall ? Form::flat : Form::ellipsoid, H.centre, H.half[0], 1e300);
      return;
    }
    if (H.round()) {
      Point end = H.centre + (dot(x - H.centre, H.axis[2]) < 0 ? -1 : 1) * H.length() * H.axis[2];
      add(H.kind == kCapsule ? Form::flat : Form::rim, end, H.half[0], 1e300).flat[0] = H.axis[2];
      Patch& side = add(Form::flat, H.centre, H.half[0], H.length());
      side.flat[side.flats++] = H.axis[2];
      if (H.kind == kCapsule) return;
      Patch& level = add(Form::flat, end, 0, 1e300);
      level.flats = 2;
      level.flat[0] = H.axis[0];
      level.flat[1] = H.axis[1];
      return;
    }
    int order[3] = {0, 1, 2};  // of the corners, the nearest first
    auto far = [&](int k) { return size_of(H.vertex(corner[k]) - x); };
    for (int k = 1; k < 3; ++k)
      for (int l = k; l > 0 && far(order[l]) < far(order[l - 1]); --l) { int y = order[l]; order[l] = order[l - 1]; order[l - 1] = y; }
    for (int k = 0; k < 3; ++k) {  // the corner, then the edges to nearer ones
      Point v = H.vertex(corner[order[k]]);
      bool twin = false;
      for (int l = 0; l < k; ++l) twin |= corner[order[l]] == corner[order[k]];
      if (twin) continue;
      add(Form::flat, v, 0, 1e300);
      for (int l = 0; l < k; ++l) {
        Point edge = H.vertex(corner[order[l]]) - v;
        if (size_of(edge) == 0) continue;
        Patch& part = add(Form::flat, v + 0.5 * edge, 0, 0.5 * size_of(edge));
        part.flat[part.flats++] = unit(edge);
      }
    }
    if (n == most - 1) at[n++] = patch_of(H, corner, x, {});
  }
};

// How A and B meet, whose differences have the side d; what does not settle is left as the search found it.
static Meeting meet(const PosedHull& A, const PosedHull& B, const Depth& d) {
  const Apart* c = d.corner;
  Point x = c[0].x, u = c[1].x - x, v = c[2].x - x, to = d.depth * d.n - x;  // the nearest point in the side's own coordinates
  double uu = dot(u, u), uv = dot(u, v), vv = dot(v, v), det = __builtin_fmax(uu * vv - uv * uv, 1e-300);
  double s = (dot(to, u) * vv - dot(to, v) * uv) / det, t = (dot(to, v) * uu - dot(to, u) * uv) / det;
  if (vv == 0) s = dot(to, u) / __builtin_fmax(uu, 1e-300);  // two corners, or one
  auto mixed = [&](const Point& p, const Point& q, const Point& r) { return (1 - s - t) * p + s * q + t * r; };
  int of_a[3] = {c[0].a, c[1].a, c[2].a}, of_b[3] = {c[0].b, c[1].b, c[2].b};
  Meeting rough{{}, {}, {}, {}, -1.0 * d.n, -d.depth};
  rough.on_a.at = mixed(A.vertex(of_a[0]), A.vertex(of_a[1]), A.vertex(of_a[2]));
  rough.on_b.at = mixed(B.vertex(of_b[0]), B.vertex(of_b[1]), B.vertex(of_b[2]));
  rough.a = patch_of(A, of_a, rough.on_a.at, d.n);
  rough.b = patch_of(B, of_b, rough.on_b.at, -1.0 * d.n);
  auto settled = [&](Meeting m) {
    if (!settle(m) || dot(m.n, rough.n) < 0.98 || __builtin_fabs(m.dist - rough.dist) > 0.05 * __builtin_fabs(d.depth) + 1e-6) return false;
    if (!farthest_at(A, m.on_a.at, -1.0 * m.n) || !farthest_at(B, m.on_b.at, m.n)) return false;
    rough = m;
    return true;
  };
  if (settled(rough)) return rough;
  if (rough.a.flats + rough.b.flats > 2) {  // flat on flat: what is less so touches with a point of its own
    Meeting blunt = rough;
    bool of_a = rough.a.flats < rough.b.flats;
    Patch& less = of_a ? blunt.a : blunt.b;
    less.base = (of_a ? rough.on_a : rough.on_b).at - less.radius * (of_a ? d.n : -1.0 * d.n);
    less.flats = 0;
    if (settled(blunt)) return rough;
  }
  // The search takes round shapes for polytopes, and ends before a corner or an edge is alone: neighbours of what it found.
  Parts parts_a(A, of_a, rough.on_a.at), parts_b(B, of_b, rough.on_b.at);
  for (int sum = 0; sum < parts_a.n + parts_b.n - 1; ++sum)
    for (int k = sum < parts_b.n ? 0 : sum - parts_b.n + 1; k <= sum && k < parts_a.n; ++k) {
      Meeting other = rough;
      other.a = parts_a.at[k];
      other.b = parts_b.at[sum - k];
      if (other.a.flats + other.b.flats <= 2 && settled(other)) return rough;
    }
  Point a = rough.on_a.at, b = rough.on_b.at;
  double ta[2] = {}, tb[2] = {};
  put(rough, ta, tb);
  rough.on_a.at = a;
  rough.on_b.at = b;
  return rough;
}

}  // namespace cmbrl::CMBRL_ISA
