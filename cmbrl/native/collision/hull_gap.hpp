// How far two convex hulls are apart, where that is not much: the distance of Gilbert, Johnson and Keerthi (IEEE J. Robotics and
// Automation 4, 1988). Of each simplex, every part is looked at, which is slow and never goes astray.
#pragma once
#include "collision/hull_depth.hpp"

namespace cmbrl::CMBRL_ISA {

// Up to three differences, and a further one; `nearest`: of what they span, the point nearest to the origin.
struct Nearby {
  Apart at[4];
  int n = 0;
  Point nearest;

  bool has(const Apart& x) const {
    for (int k = 0; k < n; ++k) if (at[k].a == x.a && at[k].b == x.b) return true;
    return false;
  }
  // Takes x in, and keeps those between which the nearest point is.
  void take(const Apart& x) {
    at[n++] = x;
    double least = 1e300;
    Apart kept[3];
    int nkept = 0;
    for (int part = 1; part < 1 << n; ++part) {
      int of[4], count = 0;
      for (int k = 0; k < n; ++k) if (part >> k & 1) of[count++] = k;
      Point p;
      if (count > 3 || !between(of, count, p) || dot(p, p) >= least) continue;
      least = dot(p, p);
      nearest = p;
      for (nkept = 0; nkept < count; ++nkept) kept[nkept] = at[of[nkept]];
    }
    for (n = 0; n < nkept; ++n) at[n] = kept[n];
  }
  // The nearest point of the plane (line) through some of them, if it is between them.
  bool between(const int* of, int count, Point& p) const {
    p = at[of[0]].x;
    if (count == 1) return true;
    Point u = at[of[1]].x - p, v = count == 3 ? at[of[2]].x - p : Point{};
    double uu = dot(u, u), vv = dot(v, v), uv = dot(u, v), pu = -dot(p, u), pv = -dot(p, v), s, t = 0;
    if (count == 2) {
      s = uu > 0 ? pu / uu : -1;
    } else {
      double det = uu * vv - uv * uv;
      if (!(det > 1e-14 * uu * vv)) return false;
      s = (pu * vv - pv * uv) / det;
      t = (pv * uu - pu * uv) / det;
      if (t < 0) return false;
    }
    if (s < 0 || s + t > 1) return false;
    p = p + s * u + t * v;
    return true;
  }
};

// How far hulls are apart that do not overlap, unless it is more than `reach`. Then `depth` is negative, and n leads from A to B.
enum class Gap { overlap, found, far };
static Gap find_gap(const PosedHull& A, const PosedHull& B, const Point& between, double reach, Depth& out, double tolerance) {
  Nearby near;
  near.take(farthest_apart(A, B, dot(between, between) > 0 ? between : Point{{1, 0, 0}}));
  for (int k = 0; k < kMostSimplices; ++k) {
    double size = size_of(near.nearest);
    if (size < 1e-14) return Gap::overlap;
    Apart far = farthest_apart(A, B, -1.0 * near.nearest);
    double least = dot(far.x, near.nearest) / size;
    if (least > reach) return Gap::far;
    if (size - least < tolerance || near.has(far)) break;
    near.take(far);
  }
  double size = size_of(near.nearest);
  if (!(size > 1e-14)) return Gap::overlap;
  if (!(size <= reach)) return Gap::far;
  out.n = (-1 / size) * near.nearest;
  out.depth = -size;
  for (int k = 0; k < 3; ++k) out.corner[k] = near.at[k < near.n ? k : 0];
  return Gap::found;
}

// How deep A and B are in each other, or, up to their reach, how far apart.
static bool find_depth(const PosedHull& A, const PosedHull& B, const Point& between, Depth& out, double tolerance = 1e-10) {
  Simplex simplex;
  if (overlap(A, B, between, simplex)) return find_depth(A, B, simplex, out, tolerance);
  return A.reach > 0 && find_gap(A, B, between, A.reach, out, tolerance) == Gap::found;
}

// A ball is a point that is rounded off, a capsule a segment.
static double rounding_of(const PosedHull& H) { return H.kind == kBall || H.kind == kCapsule ? H.half[0] : 0; }
static PosedHull core_of(const PosedHull& H) {
  PosedHull core = H;
  core.nmade = 0;
  if (rounding_of(H) == 0) return core;
  core.half[2] = H.length();
  core.half[0] = core.half[1] = 0;
  return core;
}

// The same by what is rounded off, which the search takes for what it is: for a polytope with as many corners as it needs otherwise.
static bool find_rounded_depth(const PosedHull& A, const PosedHull& B, const Point& between, Depth& out, double tolerance) {
  double of_a = rounding_of(A), of_b = rounding_of(B);
  if (of_a + of_b == 0) return find_depth(A, B, between, out, tolerance);
  PosedHull a = core_of(A), b = core_of(B);
  Gap gap = find_gap(a, b, between, of_a + of_b + A.reach, out, tolerance);
  if (gap == Gap::overlap) return find_depth(A, B, between, out, tolerance);
  if (gap == Gap::far) return false;
  auto round_off = [&](const PosedHull& H, int vertex, bool done, double by) {  // towards the other hull
    if (H.round() && !done) H.made[vertex] = H.made[vertex] + by * out.n;
  };
  for (int k = 0; k < 3; ++k) {
    Apart& c = out.corner[k];
    bool done_a = false, done_b = false;
    for (int j = 0; j < k; ++j) { done_a |= out.corner[j].a == c.a; done_b |= out.corner[j].b == c.b; }
    round_off(A, c.a, done_a, of_a);
    round_off(B, c.b, done_b, -of_b);
    c.x = c.x + (of_a + of_b) * out.n;
  }
  out.depth += of_a + of_b;
  return out.depth > -A.reach;
}

}  // namespace cmbrl::CMBRL_ISA
