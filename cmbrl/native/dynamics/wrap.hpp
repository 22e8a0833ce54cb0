// A tendon's way between two points around a sphere or a cylinder that a body carries: its length and how that changes with
// the points, as seen from that body. The way is straight, touches the surface along an arc, or turns at one point inside.
// Which of them, and on which side: as MuJoCo chooses. Gradients need no change of the touching points, since the length is
// stationary in them; second derivatives come from the way's circle and from the plane that turns with the points.
#pragma once
#include <cmath>

namespace cmbrl {

struct Obstacle { double radius; bool cylinder, sided; };

struct Way { double length, g[6], H[6][6]; };  // by both points

namespace wrapping {

constexpr double kTiny = 1e-15;
struct Flat { double length, g[4], H[4][4]; };  // the same in a plane with the circle's centre as the origin

static inline double cross2(const double* a, const double* b) { return a[0] * b[1] - a[1] * b[0]; }
static inline double dot2(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1]; }

static inline bool intersect(const double* p1, const double* p2, const double* p3, const double* p4) {
  double u[2] = {p2[0] - p1[0], p2[1] - p1[1]}, v[2] = {p4[0] - p3[0], p4[1] - p3[1]}, w[2] = {p1[0] - p3[0], p1[1] - p3[1]};
  double det = cross2(u, v);
  if (std::fabs(det) < kTiny) return false;
  double a = cross2(v, w) / det, b = cross2(u, w) / det;
  return a >= 0 && a <= 1 && b >= 0 && b <= 1;
}

// A straight piece from e to p, added to the derivatives by e.
static inline double piece(const double* e, const double* p, double* g, double (*H)[4], int at) {
  double d[2] = {p[0] - e[0], p[1] - e[1]}, length = std::sqrt(dot2(d, d)), inv = 1 / std::fmax(length, 1e-12);
  double n[2] = {d[0] * inv, d[1] * inv};
  g[at] -= n[0]; g[at + 1] -= n[1];
  H[at][at] += n[1] * n[1] * inv; H[at + 1][at + 1] += n[0] * n[0] * inv;
  H[at][at + 1] -= n[0] * n[1] * inv; H[at + 1][at] -= n[0] * n[1] * inv;
  return length;
}

// Along the circle, from outside; false where the straight way is free.
static inline bool outside(const double* e, const double* side, double r, Flat& way) {
  double q0 = dot2(e, e), q1 = dot2(e + 2, e + 2), dif[2] = {e[2] - e[0], e[3] - e[1]}, dd = dot2(dif, dif);
  if (q0 < r * r || q1 < r * r || r < kTiny || dd < kTiny) return false;
  double a = std::fmin(std::fmax(-dot2(dif, e) / dd, 0.0), 1.0), near[2] = {e[0] + a * dif[0], e[1] + a * dif[1]};
  if (dot2(near, near) > r * r && (!side || dot2(side, near) >= 0)) return false;
  double s0 = std::sqrt(q0 - r * r), s1 = std::sqrt(q1 - r * r), touch[2][4], good[2];
  for (int i = 0; i < 2; ++i) {
    double sign = i ? -1 : 1, *p = touch[i];
    p[0] = (e[0] * r * r + sign * r * e[1] * s0) / q0; p[1] = (e[1] * r * r - sign * r * e[0] * s0) / q0;
    p[2] = (e[2] * r * r - sign * r * e[3] * s1) / q1; p[3] = (e[3] * r * r + sign * r * e[2] * s1) / q1;
    if (side) {
      double sum[2] = {p[0] + p[2], p[1] + p[3]};
      good[i] = dot2(sum, side) / std::fmax(std::sqrt(dot2(sum, sum)), kTiny);
    } else {
      double apart[2] = {p[0] - p[2], p[1] - p[3]};
      good[i] = -dot2(apart, apart);
    }
    if (intersect(e, p, e + 2, p + 2)) good[i] = -10000;
  }
  int i = good[0] > good[1] ? 0 : 1;
  const double* p = touch[i];
  if (intersect(e, p, e + 2, p + 2)) return false;
  double angle = std::acos(std::fmin(std::fmax(dot2(p, p + 2) / (r * r), -1.0), 1.0)), turn = -cross2(p, p + 2);
  if ((turn > 0 && i) || (turn < 0 && !i)) angle = 2 * M_PI - angle;
  way = {};
  way.length = r * angle + piece(e, p, way.g, way.H, 0) + piece(e + 2, p + 2, way.g, way.H, 2);
  return true;
}

// Where a way turns that touches the circle from inside: asin(A z) + asin(B z) - 2 asin(z) + G = 0 (MuJoCo's Newton
// iteration, to the end). False where the straight way is free.
static inline bool inside(const double* e, double r, Flat& way) {
  double l0 = std::sqrt(dot2(e, e)), l1 = std::sqrt(dot2(e + 2, e + 2)), dif[2] = {e[2] - e[0], e[3] - e[1]}, dd = dot2(dif, dif);
  if (l0 <= r || l1 <= r || r < kTiny) return false;
  if (dd > kTiny) {
    double a = -dot2(dif, e) / dd, near[2] = {e[0] + a * dif[0], e[1] + a * dif[1]};
    if (a > 0 && a < 1 && dot2(near, near) <= r * r) return false;
  }
  double mid[2] = {e[0] + e[2], e[1] + e[3]}, long_mid = std::fmax(std::sqrt(dot2(mid, mid)), kTiny);
  double p[2] = {r * mid[0] / long_mid, r * mid[1] / long_mid};
  double A = r / l0, B = r / l1, cosine = (l0 * l0 + l1 * l1 - dd) / (2 * l0 * l1);
  if (cosine < -1 + kTiny) return false;
  bool found = false;
  if (cosine <= 1 - kTiny) {
    double G = std::acos(cosine), z = 1 - 1e-7;
    auto f = [&](double x) { return std::asin(A * x) + std::asin(B * x) - 2 * std::asin(x) + G; };
    double y = f(z);
    for (int iteration = 0; y <= 0 && iteration < 40; ++iteration) {
      if (std::fabs(y) < 1e-14) { found = true; break; }
      double slope = A / std::sqrt(1 - z * z * A * A) + B / std::sqrt(1 - z * z * B * B) - 2 / std::sqrt(1 - z * z);
      double next = z - y / slope;
      if (!(slope < 0) || !(next > 0) || next >= z) { found = std::fabs(y) < 1e-6; break; }
      z = next;
      y = f(z);
    }
    found |= std::fabs(y) < 1e-6;
    if (found) {
      bool first = cross2(e, e + 2) > 0;
      const double* from = first ? e : e + 2;
      double angle = std::asin(z) - std::asin(z * (first ? A : B)), c = std::cos(angle), s = std::sin(angle), l = first ? l0 : l1;
      p[0] = r * (c * from[0] - s * from[1]) / l;
      p[1] = r * (s * from[0] + c * from[1]) / l;
    }
  }
  way = {};
  way.length = piece(e, p, way.g, way.H, 0) + piece(e + 2, p, way.g, way.H, 2);
  if (!found) return true;
  double along[2] = {-p[1], p[0]}, bend = 0, by[4];  // the turning point moves along the circle
  for (int k = 0; k < 2; ++k) {
    const double *x = e + 2 * k, *g = way.g + 2 * k;
    double d[2] = {p[0] - x[0], p[1] - x[1]}, length = std::sqrt(dot2(d, d)), rate = -dot2(g, along);
    bend += (r * r - rate * rate) / length + dot2(g, p);
    for (int j = 0; j < 2; ++j) by[2 * k + j] = -(along[j] + g[j] * rate) / length;
  }
  if (std::fabs(bend) > kTiny)
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < 4; ++j) way.H[i][j] -= by[i] * by[j] / bend;
  return true;
}

static inline double dot3(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
static inline void cross3(const double* a, const double* b, double* c) {
  c[0] = a[1] * b[2] - a[2] * b[1]; c[1] = a[2] * b[0] - a[0] * b[2]; c[2] = a[0] * b[1] - a[1] * b[0];
}

// e2 and m make a right-handed frame with a / |a|, m across the plane of a and b.
static inline void plane_of(const double* a, const double* b, double la, double* e1, double* e2, double* m) {
  for (int i = 0; i < 3; ++i) e1[i] = a[i] / la;
  cross3(a, b, m);
  double size = std::sqrt(dot3(m, m));
  if (size < kTiny) {  // in one line with the centre: any plane, chosen as MuJoCo does
    int i = 0;
    if (std::fabs(e1[1]) > std::fabs(e1[0]) && std::fabs(e1[1]) > std::fabs(e1[2])) i = 1;
    if (std::fabs(e1[2]) > std::fabs(e1[0]) && std::fabs(e1[2]) > std::fabs(e1[1])) i = 2;
    double other[3] = {1, 1, 1};
    other[i] = 0;
    cross3(e1, other, m);
    size = std::sqrt(dot3(m, m));
  }
  for (int i = 0; i < 3; ++i) m[i] /= size;
  cross3(m, e1, e2);
}

}  // namespace wrapping

// The way from a to b, seen from the obstacle's centre, with the obstacle's axes as rows, and the place of the site that
// tells the side; all in one frame; H if it `bends`. False where it is straight.
static inline bool way_around(const Obstacle& o, const double* a, const double* b, const double (*axes)[3], const double* site, bool bends, Way& way) {
  using namespace wrapping;
  double la = std::sqrt(dot3(a, a)), lb = std::sqrt(dot3(b, b)), x[3], y[3], m[3];
  if (la < kTiny || lb < kTiny) return false;
  if (o.cylinder) for (int i = 0; i < 3; ++i) { x[i] = axes[0][i]; y[i] = axes[1][i]; m[i] = axes[2][i]; }
  else plane_of(a, b, la, x, y, m);
  double ends[4] = {dot3(a, x), dot3(a, y), dot3(b, x), dot3(b, y)}, side[2] = {dot3(site, x), dot3(site, y)};
  double size = std::fmax(std::sqrt(dot2(side, side)), kTiny);
  side[0] *= o.radius / size; side[1] *= o.radius / size;
  Flat flat;
  bool through = o.sided && dot3(site, site) < o.radius * o.radius;
  if (!(through ? inside(ends, o.radius, flat) : outside(ends, o.sided ? side : nullptr, o.radius, flat))) return false;
  double g[6] = {}, H[6][6] = {};  // in the frame x, y, m of each point
  const int place[4] = {0, 1, 3, 4};
  for (int i = 0; i < 4; ++i) {
    g[place[i]] = flat.g[i];
    for (int j = 0; j < 4; ++j) H[place[i]][place[j]] = flat.H[i][j];
  }
  way.length = flat.length;
  if (o.cylinder) {  // the way is straight on the unrolled cylinder: its length is that of (flat, height)
    double height = dot3(b, m) - dot3(a, m), L = std::sqrt(flat.length * flat.length + height * height), c = flat.length / L, s = height / L;
    double dz[6] = {0, 0, -1, 0, 0, 1};
    for (int i = 0; i < 6 && bends; ++i)
      for (int j = 0; j < 6; ++j) {
        double across = (s * g[i] - c * dz[i]) * (s * g[j] - c * dz[j]) / L;
        way.H[i][j] = c * H[i][j] + across;
      }
    for (int i = 0; i < 6; ++i) g[i] = c * g[i] + s * dz[i];
    for (int i = 0; i < 6 && bends; ++i) for (int j = 0; j < 6; ++j) H[i][j] = way.H[i][j];
    way.length = L;
  } else {  // across the plane: the points move on spheres around the centre, and the plane turns with them
    double by_angle = ends[2] * flat.g[3] - ends[3] * flat.g[2], sine = cross2(ends, ends + 2) / (la * lb), cosine = dot2(ends, ends + 2) / (la * lb);
    double safe = std::fmax(std::fabs(sine), 1e-9), cotangent = cosine / safe;
    H[2][2] = (dot2(flat.g, ends) + by_angle * cotangent) / (la * la);
    H[5][5] = (dot2(flat.g + 2, ends + 2) + by_angle * cotangent) / (lb * lb);
    H[2][5] = H[5][2] = -by_angle / (la * lb * safe);
  }
  const double* frame[3] = {x, y, m};
  for (int i = 0; i < 6; ++i) {
    way.g[i] = 0;
    for (int k = 0; k < 3; ++k) way.g[i] += frame[k][i % 3] * g[i / 3 * 3 + k];
    for (int j = 0; j < 6 && bends; ++j) {
      double sum = 0;
      for (int k = 0; k < 3; ++k)
        for (int l = 0; l < 3; ++l) sum += frame[k][i % 3] * H[i / 3 * 3 + k][j / 3 * 3 + l] * frame[l][j % 3];
      way.H[i][j] = sum;
    }
  }
  return true;
}

// The same, also where it is straight.
static inline Way way_between(const Obstacle& o, const double* a, const double* b, const double (*axes)[3], const double* site, bool bends) {
  Way way;
  if (way_around(o, a, b, axes, site, bends, way)) return way;
  double d[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]};
  way.length = std::sqrt(wrapping::dot3(d, d));
  double inv = 1 / std::fmax(way.length, 1e-12);
  for (int i = 0; i < 6; ++i) {
    double sign = i < 3 ? -1 : 1, n = d[i % 3] * inv;
    way.g[i] = sign * n;
    for (int j = 0; j < 6 && bends; ++j) way.H[i][j] = ((i < 3) == (j < 3) ? 1 : -1) * (double(i % 3 == j % 3) - n * d[j % 3] * inv) * inv;
  }
  return way;
}

}  // namespace cmbrl
