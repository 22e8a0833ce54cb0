// Where a capsule and a box touch, as MuJoCo has it: where the capsule's axis is nearest to the box, and, if the capsule lies along a
// side or an edge rather than across it, where it leaves that side or edge; each by itself, as a ball on the axis would.
#pragma once
#include "collision/round_contact.hpp"

namespace cmbrl::CMBRL_ISA {

// The capsule's axis in the box's own coordinates, p + t h for t from -1 to 1.
struct AxisByBox {
  const PosedHull &capsule, &box;
  bool capsule_is_a;
  double p[3], h[3];

  AxisByBox(const PosedHull& C, const PosedHull& X, bool capsule_is_a) : capsule(C), box(X), capsule_is_a(capsule_is_a) {
    for (int k = 0; k < 3; ++k) {
      p[k] = dot(X.axis[k], C.centre - X.centre);
      h[k] = C.length() * dot(X.axis[k], C.axis[2]);
    }
  }
  double at(int k, double t) const { return p[k] + t * h[k]; }
  // How far a coordinate is past the box's side; 0 between its two sides.
  double over(int k, double t) const {
    double x = at(k, t), past = __builtin_fabs(x) - box.half[k];
    return past > 0 ? (x < 0 ? -past : past) : 0;
  }
  double slope(double t) const {  // half that of the squared distance, which is convex
    double sum = 0;
    for (int k = 0; k < 3; ++k) sum += h[k] * over(k, t);
    return sum;
  }
  double crosses(int k, double side) const { return (side * box.half[k] - p[k]) / h[k]; }  // where it does one of the box's planes
  // Where it leaves what is between the box's planes across k in this direction, at an end at most; `by`: the plane's axis, or -1.
  double leaves(int k, double direction, double stop, int& by) const {
    if (h[k] == 0) return stop;
    double t = crosses(k, h[k] * direction < 0 ? -1 : 1);
    if (direction * t >= direction * stop) return stop;
    by = k;
    return t;
  }
  double nearest() const {
    double low = -1, high = 1;
    if (slope(low) >= 0) return low;
    if (slope(high) <= 0) return high;
    for (int k = 0; k < 3; ++k)  // between two of these the slope is linear
      for (int side = -1; side <= 1; side += 2) {
        double t = h[k] == 0 ? low : crosses(k, side);
        if (t > low && t < high) (slope(t) > 0 ? high : low) = t;
      }
    double below = slope(low), above = slope(high);
    return above > below ? low + (high - low) * below / (below - above) : low;
  }
  bool inside(double t) const { return over(0, t) == 0 && over(1, t) == 0 && over(2, t) == 0; }
  bool passes_through() const {
    double in = -1, out = 1;
    for (int k = 0; k < 3; ++k) {
      if (h[k] == 0 && over(k, 0) != 0) return false;
      if (h[k] == 0) continue;
      double t[2] = {crosses(k, -1), crosses(k, 1)};
      in = __builtin_fmax(in, __builtin_fmin(t[0], t[1]));
      out = __builtin_fmin(out, __builtin_fmax(t[0], t[1]));
    }
    return in <= out;
  }
  Point on_axis(double t) const { return capsule.centre + t * capsule.length() * capsule.axis[2]; }
};

// A ball around the axis at t, or the capsule's side there, against what is nearest of the box: a corner, an edge, a side; the nearest
// side where it is inside. past[k]: how far it is past the box, along its axes. False where they are apart.
static bool touch_ball(const AxisByBox& x, double t, const double* past, bool of_side, Touch& out) {
  const PosedHull &C = x.capsule, &X = x.box;
  Point centre = x.on_axis(t), away{};
  for (int k = 0; k < 3; ++k) away = away + past[k] * X.axis[k];
  double distance = size_of(away);
  Patch ball{Form::flat, centre, {C.axis[2]}, of_side, C.half[0], 1e300, &C}, part{Form::flat, {}, {}, 0, 0, 1e300, &X};
  Meeting m{};
  if (distance > 0) {
    for (int k = 0; k < 3; ++k) if (past[k] == 0) part.flat[part.flats++] = X.axis[k];
    m.n = (1 / distance) * away;
  } else {
    int side = 0;
    for (int k = 1; k < 3; ++k)
      if (X.half[k] - __builtin_fabs(x.at(k, t)) < X.half[side] - __builtin_fabs(x.at(side, t))) side = k;
    distance = __builtin_fabs(x.at(side, t)) - X.half[side];
    m.n = x.at(side, t) < 0 ? -1.0 * X.axis[side] : X.axis[side];
    part.flat[part.flats++] = X.axis[(side + 1) % 3];
    part.flat[part.flats++] = X.axis[(side + 2) % 3];
  }
  m.dist = distance - C.half[0];
  if (!(m.dist < C.reach)) return false;
  part.base = centre - distance * m.n;
  m.a = x.capsule_is_a ? ball : part;
  m.b = x.capsule_is_a ? part : ball;
  if (!x.capsule_is_a) m.n = -1.0 * m.n;
  double here[2] = {};
  put(m, here, here);
  out = touch_of(m);
  return true;
}

static bool touch_ball(const AxisByBox& x, double t, Touch& out) {
  double past[3];
  for (int k = 0; k < 3; ++k) past[k] = x.over(k, t);
  return touch_ball(x, t, past, __builtin_fabs(t) < 1, out);
}

// The corner of the box that is towards `corner` against the capsule's side; or the capsule's end in this direction, if it is nearer.
static bool touch_corner(const AxisByBox& x, const double* corner, double direction, Touch& out) {
  double along = 0, size = 0, past[3];
  for (int k = 0; k < 3; ++k) {
    along += x.h[k] * (__builtin_copysign(x.box.half[k], corner[k]) - x.p[k]);
    size += x.h[k] * x.h[k];
  }
  double t = along / size;
  if (t * direction >= 1) return touch_ball(x, direction, out);
  for (int k = 0; k < 3; ++k) past[k] = x.at(k, t) - __builtin_copysign(x.box.half[k], corner[k]);
  return touch_ball(x, t, past, true, out);
}

// Where the capsule leaves the box's side across `k` in this direction, over that side; or its end, if that comes first; or, where it
// passes by that side, the corner.
static bool touch_leaving(const AxisByBox& x, int k, double direction, Touch& out) {
  int by = -1;
  double t = x.leaves((k + 1) % 3, direction, direction, by);
  t = x.leaves((k + 2) % 3, direction, t, by);
  if (by < 0) return touch_ball(x, direction, out);
  double place[3] = {x.at(0, t), x.at(1, t), x.at(2, t)};
  if (x.over(3 - k - by, t) != 0) return touch_corner(x, place, direction, out);
  double radius = x.capsule.half[0], dist = __builtin_fabs(place[k]) - x.box.half[k] - radius;
  if (!(dist < x.capsule.reach)) return false;
  Point n = (place[k] < 0 ? -1.0 : 1.0) * x.box.axis[k], centre = x.on_axis(t);
  out = touch_at({x.capsule_is_a, false, {}, n}, {centre - radius * n, Origin::cut, false, {}, x.capsule.axis[2], x.box.axis[by]}, dist);
  out.a = centre;  // a point of the axis, moved by the normal
  out.back += x.capsule_is_a ? radius : -radius;
  return true;
}

// A capsule that touches an edge with its end is one at a corner to MuJoCo if its axis, drawn on, passes by the edge's end.
static bool passes_end(const AxisByBox& x, int i, int j, double* place, double* inwards) {
  int edge = 3 - i - j;
  double along = 0;
  for (int k : {i, j}) along += x.h[k] * (__builtin_copysign(x.box.half[k], place[k]) - x.p[k]);
  double passes = x.at(edge, along / __builtin_fmax(x.h[i] * x.h[i] + x.h[j] * x.h[j], 1e-300));
  if (__builtin_fabs(passes) <= x.box.half[edge]) return false;
  place[edge] = passes;
  inwards[edge] = passes < 0 ? x.h[edge] : -x.h[edge];
  return true;
}

// Of `out` there are at most two; -1: the axis passes through the box.
static int touch_capsule_box(const AxisByBox& x, Touch* out) {
  int n = 0;
  if (x.passes_through()) {
    if (!x.inside(-1) && !x.inside(1)) return -1;
    return touch_ball(x, x.inside(-1) ? -1 : 1, out[0]);
  }
  double t = x.nearest(), inwards[3], place[3];  // as t grows
  int outside[3], count = 0;
  for (int k = 0; k < 3; ++k) {
    place[k] = x.at(k, t);
    inwards[k] = place[k] < 0 ? x.h[k] : -x.h[k];
    if (x.over(k, t) != 0) outside[count++] = k;
  }
  if (count == 1) {  // over a side
    n += touch_leaving(x, outside[0], -1, out[n]);
    return n + touch_leaving(x, outside[0], 1, out[n]);
  }
  if (!touch_ball(x, t, out[n])) return 0;
  ++n;
  if (count == 2 && __builtin_fabs(t) == 1) count += passes_end(x, outside[0], outside[1], place, inwards);
  if (count == 2) {  // at an edge: over the one of its sides that is less steep, unless it comes straight at the edge or leaves it so
    bool first = __builtin_fabs(x.h[outside[0]]) < __builtin_fabs(x.h[outside[1]]);
    int level = outside[!first], across = outside[first];
    if (inwards[level] * inwards[across] > 0) return n;
    return n + touch_leaving(x, level, inwards[across] > 0 ? 1 : -1, out[n]);
  }
  int odd = -1;  // at a corner: of the axes, the one along which it comes in while it goes out along the others, or the reverse
  for (int k = 0; k < 3; ++k)
    if ((inwards[k] > 0) != (inwards[(k + 1) % 3] > 0) && (inwards[k] > 0) != (inwards[(k + 2) % 3] > 0)) odd = k;
  if (odd < 0) return n;
  double inward = inwards[odd] > 0 ? 1 : -1, length = x.capsule.length();
  if (x.h[odd] * x.h[odd] <= 0.5 * length * length) return n + touch_leaving(x, odd, -inward, out[n]);
  place[odd] = -place[odd];
  return n + touch_corner(x, place, inward, out[n]);
}

}  // namespace cmbrl::CMBRL_ISA
