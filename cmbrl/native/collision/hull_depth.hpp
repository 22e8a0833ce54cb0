// How deep two convex hulls are in each other, and along which direction: Gilbert, Johnson and Keerthi's simplices say whether they
// overlap (Gilbert et al., IEEE J. Robotics and Automation 4, 1988), the expanding polytope says how deep (van den Bergen, Game Developers
// Conference 2001). Both look at the differences of points of one hull and of the other, with plain numbers: lanes differ in their ways.
#pragma once
#include "scene/model.hpp"
#include "collision/climb.hpp"
#include "base/pack.hpp"

namespace cmbrl::CMBRL_ISA {

struct Point { double x[3]; };
static inline Point operator+(Point a, const Point& b) { for (int k = 0; k < 3; ++k) a.x[k] += b.x[k]; return a; }
static inline Point operator-(Point a, const Point& b) { for (int k = 0; k < 3; ++k) a.x[k] -= b.x[k]; return a; }
static inline Point operator*(double s, Point a) { for (int k = 0; k < 3; ++k) a.x[k] *= s; return a; }
static inline double dot(const Point& a, const Point& b) { return a.x[0] * b.x[0] + a.x[1] * b.x[1] + a.x[2] * b.x[2]; }
static inline Point cross(const Point& a, const Point& b) {
  return {{a.x[1] * b.x[2] - a.x[2] * b.x[1], a.x[2] * b.x[0] - a.x[0] * b.x[2], a.x[0] * b.x[1] - a.x[1] * b.x[0]}};
}
static inline double size_of(const Point& a) { return __builtin_sqrt(dot(a, a)); }
static inline Point unit(const Point& a) { return (1 / __builtin_fmax(size_of(a), 1e-300)) * a; }

// What a hull is: the vertices that it has, those of a box, or a round shape that fills the box whose corners it has.
enum HullKind { kPolytope = 0, kBox = 1, kBall = 2, kCapsule = 3, kEllipsoid = 4, kCylinder = 5, kField = 6 };  // the last: see field.hpp

// A hull of the model in a pose: x = p + R y for the points y of its body's frame. Of a prism of a height field, whose corners are
// not the model's, the sides are.
struct PosedHull {
  const Model* m;
  const double *points, *normals;  // from vertex first_point and side first_face of the model on
  int first_point, first_face;
  int begin, vertices, count;  // how many vertices there are, and with those that fill up
  const double* columns;
  const int* starts;  // of a hull of many vertices (climb.hpp), or null
  double R[9];
  Point p;
  int kind;
  double reach;  // [m] the gap from which on it touches the other one, which has the same
  const double* bound;    // centre and half sizes of the box around it along the axes of its body's frame
  Point centre, axis[3];  // of a box, or of the one around a round shape
  double half[3];
  Point* made;  // points of a round shape, in the order in which they were asked for
  mutable int nmade;

  bool round() const { return kind > kBox; }
  double radius() const { return kind == kEllipsoid ? 0 : half[0]; }
  double length() const { return kind == kCapsule ? half[2] - half[0] : half[2]; }  // half that of the axis
  void place(const double* box) {
    nmade = 0;
    if (kind == kPolytope) return;
    centre = p + turned(box);
    for (int k = 0; k < 3; ++k) {
      axis[k] = turned(box + 3 + 3 * k);
      half[k] = box[12 + k];
    }
  }
  Point round_point(const Point& d) const {
    if (kind == kEllipsoid) {
      Point x = centre;
      double y[3], size = 0;
      for (int k = 0; k < 3; ++k) { y[k] = half[k] * dot(axis[k], d); size += y[k] * y[k]; }
      size = __builtin_sqrt(__builtin_fmax(size, 1e-300));
      for (int k = 0; k < 3; ++k) x = x + (half[k] * y[k] / size) * axis[k];
      return x;
    }
    double up = dot(axis[2], d);
    Point end = kind == kBall ? centre : centre + (up >= 0 ? length() : -length()) * axis[2], out = kind == kCylinder ? d - up * axis[2] : d;
    double size = size_of(out);
    return size > 1e-9 * size_of(d) ? end + (half[0] / size) * out : end;  // along the axis, `out` is round-off
  }

  Point turned(const double* y) const {
    Point out;
    for (int k = 0; k < 3; ++k) out.x[k] = R[3 * k] * y[0] + R[3 * k + 1] * y[1] + R[3 * k + 2] * y[2];
    return out;
  }
  Point vertex(int k) const { return round() ? made[k] : p + turned(points + 3 * (k - first_point)); }
  Point normal(int face) const { return turned(normals + 3 * (face - first_face)); }
  // How far it extends along d, and, in less time, how far at most.
  double extent(const Point& d) const { return dot(d, round() ? round_point(d) : vertex(farthest(d))); }
  double at_most(const Point& d) const {
    double sum = dot(p, d);
    for (int k = 0; k < 3; ++k) {
      double along = R[k] * d.x[0] + R[3 + k] * d.x[1] + R[6 + k] * d.x[2];
      sum += bound[k] * along + bound[3 + k] * __builtin_fabs(along);
    }
    return sum;
  }
  int farthest(const Point& d) const {
    if (round()) {
      made[nmade] = round_point(d);
      return nmade++;
    }
    double y[3];
    for (int k = 0; k < 3; ++k) y[k] = R[k] * d.x[0] + R[3 + k] * d.x[1] + R[6 + k] * d.x[2];
    if (starts) return climb(*m, starts, y);
    T most[2] = {splat(-1e300), splat(-1e300)}, at[2] = {}, number = T{};  // of even and of odd blocks, which need not wait for each other
    for (int k = 0; k < W; ++k) number[k] = k;
    auto look = [&](int k, int odd) {
      T x[3];
      for (int j = 0; j < 3; ++j) std::memcpy(&x[j], columns + j * count + k, sizeof(T));
      T along = x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
      at[odd] = select(along > most[odd], number, at[odd]);
      most[odd] = vmax(most[odd], along);
      number += splat(W);
    };
    for (int k = 0; k < count; k += 2 * W) {
      look(k, 0);
      if (k + W < count) look(k + W, 1);
    }
    at[0] = select(most[1] > most[0], at[1], at[0]);
    most[0] = vmax(most[0], most[1]);
    int best = 0;
    for (int k = 0; k < W; ++k) if (most[0][k] > most[0][best]) best = k;
    int found = int(at[0][best]);
    return begin + (found < vertices ? found : vertices - 1);
  }
};

// A point of A minus one of B.
struct Apart { Point x; int a, b; };
static Apart farthest_apart(const PosedHull& A, const PosedHull& B, const Point& d) {
  int a = A.farthest(d), b = B.farthest(-1.0 * d);
  return {A.vertex(a) - B.vertex(b), a, b};
}

// Up to four of them, the newest last; `towards` leads from the nearest part to the origin.
struct Simplex {
  Apart at[4];
  int n = 0;
  Point towards;

  void keep(int i) { at[0] = at[i]; n = 1; }
  void keep(int i, int j) { Apart x = at[i], y = at[j]; at[0] = x; at[1] = y; n = 2; }
  void keep(int i, int j, int k) { Apart x = at[i], y = at[j], z = at[k]; at[0] = x; at[1] = y; at[2] = z; n = 3; }
  void face_origin(const Point& d, const Point& otherwise) { towards = dot(d, d) > 1e-30 ? d : otherwise; }

  void on_segment() {  // at[1] is the newest
    Point b = at[0].x - at[1].x, o = -1.0 * at[1].x;
    if (dot(b, o) <= 0) { keep(1); return face_origin(o, b); }
    Point least = {{0, 0, 0}};  // across the segment where the origin lies on it
    int axis = 0;
    for (int k = 1; k < 3; ++k) if (__builtin_fabs(b.x[k]) < __builtin_fabs(b.x[axis])) axis = k;
    least.x[axis] = 1;
    Point d = cross(cross(b, o), b);
    towards = dot(d, d) > 1e-24 * dot(b, b) * dot(b, b) * dot(o, o) ? d : cross(b, least);
  }
  void on_triangle() {  // at[2] is the newest
    Point b = at[1].x - at[2].x, c = at[0].x - at[2].x, o = -1.0 * at[2].x, n = cross(b, c);
    if (dot(cross(n, c), o) > 0) {
      if (dot(c, o) > 0) keep(0, 2); else keep(1, 2);
      return on_segment();
    }
    if (dot(cross(b, n), o) > 0) { keep(1, 2); return on_segment(); }
    towards = dot(n, o) > 0 ? n : -1.0 * n;
  }
  bool holds_origin() {  // at[3] is the newest
    Point top = at[3].x, o = -1.0 * top;
    const int faces[3][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}};  // two corners of the base, and the one that is left
    for (const int* f : faces) {
      Point u = at[f[0]].x - top, v = at[f[1]].x - top, n = cross(u, v);
      if (dot(n, at[f[2]].x - top) > 0) n = -1.0 * n;
      if (dot(n, o) > 0) { keep(f[0], f[1], 3); on_triangle(); return false; }
    }
    return true;
  }
};

// Whether A and B overlap; then s is a tetrahedron around the origin.
constexpr int kMostSimplices = 64;
static bool overlap(const PosedHull& A, const PosedHull& B, const Point& between, Simplex& s) {
  constexpr int most = kMostSimplices;
  s.towards = dot(between, between) > 0 ? between : Point{{1, 0, 0}};
  for (int k = 0; k < most; ++k) {
    Apart far = farthest_apart(A, B, s.towards);
    if (dot(far.x, s.towards) <= 0) return false;
    for (int i = 0; i < s.n; ++i)
      if (s.at[i].a == far.a && s.at[i].b == far.b) return false;  // they touch at most
    s.at[s.n++] = far;
    if (s.n == 1) s.towards = -1.0 * far.x;
    else if (s.n == 2) s.on_segment();
    else if (s.n == 3) s.on_triangle();
    else if (s.holds_origin()) return true;
  }
  return false;
}

// The side of A - B that is nearest to the origin: its normal, its distance, its corners.
struct Depth { Point n; double depth; Apart corner[3]; };

struct Expansion {
  static constexpr int most = 160;
  Apart at[most];
  int corner[2 * most][3];
  double normal[3][2 * most + W], distance[2 * most + W];  // by coordinate; those past the last are far
  int n = 0, nside = 0;
  Point middle;

  Point normal_of(int k) const { return {{normal[0][k], normal[1][k], normal[2][k]}}; }
  void end_sides() { for (int k = 0; k < W; ++k) distance[nside + k] = 1e300; }
  void add(int i, int j, int k) {
    Point n = cross(at[j].x - at[i].x, at[k].x - at[i].x);
    double size = size_of(n), sign = dot(n, at[i].x - middle) < 0 ? -1 : 1;
    n = (size > 1e-300 ? sign / size : 0) * n;
    int in = nside++, of[3] = {i, j, k};
    for (int x = 0; x < 3; ++x) { corner[in][x] = of[x]; normal[x][in] = n.x[x]; }
    distance[in] = size > 1e-18 ? dot(n, at[i].x) : 1e300;  // a side without an area is none
  }
  explicit Expansion(const Simplex& s) {
    middle = 0.25 * (s.at[0].x + s.at[1].x + s.at[2].x + s.at[3].x);
    for (; n < 4; ++n) at[n] = s.at[n];
    add(0, 1, 2); add(0, 1, 3); add(0, 2, 3); add(1, 2, 3);
    end_sides();
  }
  int nearest() const {
    T least = splat(1e300), in = T{}, first = T{};
    for (int k = 0; k < nside; k += W, first += splat(W)) {
      T d;
      std::memcpy(&d, distance + k, sizeof d);
      in = select(d < least, first, in);
      least = vmin(least, d);
    }
    int best = 0;
    for (int k = 1; k < W; ++k) if (least[k] < least[best]) best = k;
    return int(in[best]) + best;
  }
  bool has(const Apart& x) const {
    for (int k = 0; k < n; ++k) if (at[k].a == x.a && at[k].b == x.b) return true;
    return false;
  }
  void drop(int k) {
    --nside;
    for (int x = 0; x < 3; ++x) { corner[k][x] = corner[nside][x]; normal[x][k] = normal[x][nside]; }
    distance[k] = distance[nside];
  }
  // Takes away all sides that see x, and joins the edges around the hole with it. False where there is no room.
  bool expand(const Apart& x) {
    int edges[4 * most][2], nedge = 0, number = n;
    for (int begin = (nside - 1) / W * W; begin >= 0; begin -= W) {  // from the last: what is dropped is replaced by one that stays
      T above = T{}, d;
      for (int j = 0; j < 3; ++j) {
        T of;
        std::memcpy(&of, normal[j] + begin, sizeof of);
        above += of * x.x.x[j];
      }
      std::memcpy(&d, distance + begin, sizeof d);
      Mask sees = (d > 1e200) | (above - d > 1e-12);
      if (!any(sees)) continue;
      for (int k = (nside - begin < W ? nside - begin : W) - 1; k >= 0; --k) {
        if (!sees[k]) continue;
        const int* c = corner[begin + k];
        for (int e = 0; e < 3; ++e) {
          int i = c[e], j = c[(e + 1) % 3], twin = 0;
          while (twin < nedge && !(edges[twin][0] == j && edges[twin][1] == i) && !(edges[twin][0] == i && edges[twin][1] == j)) ++twin;
          if (twin < nedge) { --nedge; edges[twin][0] = edges[nedge][0]; edges[twin][1] = edges[nedge][1]; continue; }
          if (nedge == 4 * most) return false;
          edges[nedge][0] = i; edges[nedge][1] = j; ++nedge;
        }
        drop(begin + k);
      }
    }
    if (n == most || nside + nedge > 2 * most) return false;
    at[n++] = x;
    for (int e = 0; e < nedge; ++e) add(edges[e][0], edges[e][1], number);
    end_sides();
    return nside > 0;
  }
};

// Of round shapes within `tolerance`.
constexpr int kMostMade = kMostSimplices + Expansion::most + 1;
static bool find_depth(const PosedHull& A, const PosedHull& B, const Simplex& s, Depth& out, double tolerance = 1e-10) {
  Expansion polytope(s);
  for (;;) {
    int near = polytope.nearest();
    if (!(polytope.distance[near] < 1e200)) return false;
    out.n = polytope.normal_of(near);
    out.depth = polytope.distance[near];
    for (int k = 0; k < 3; ++k) out.corner[k] = polytope.at[polytope.corner[near][k]];
    Apart far = farthest_apart(A, B, out.n);
    if (dot(far.x, out.n) - out.depth < tolerance || polytope.has(far) || !polytope.expand(far)) return true;
  }
}

}  // namespace cmbrl::CMBRL_ISA
