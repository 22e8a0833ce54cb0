// Where two hulls that overlap touch, as MuJoCo has it: with a corner, or where edges cross; sides that lie flat on each other, or
// on an edge, with the corners of what both cover, at most four (eight of boxes). And how each of these points moves with the hulls.
#pragma once
#include "collision/bends.hpp"
#include "collision/hull_gap.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr int kMostTouches = 8, kMostOfSides = 4;
constexpr double kLying = 0.996, kLevel = 0.0888;  // as in MuJoCo: sides turned by less than 5.1 degrees lie flat, and so does an edge

// The contact's point is a + beside - (back + dist / 2) n. As A moves with velocity u at `a` and B stays, the gap changes by rise u, what
// else the point moves by than that of n is u - slid u, n turns with A if it is `held`, `beside` as it `leans`. Of edges: they say where
// they cross (contact.hpp). `crossing`: no corner is there, but an edge that crosses another one or the end of a side.
// Of round shapes (round.hpp) it `bends`: see bends.hpp for slid, axisA and axisB.
struct Touch { Point a, n, rise, beside, axisA, axisB; double dist, back, leans, slid[9]; bool held, edges, crossing, bends; };

// A corner of what is clipped: its own; where its line cuts a plane with normal `cut`; or a corner of the clipping side over it. After
// it comes a line of its own, or one that was cut.
enum class Origin { own, cut, other };
struct Clipped { Point v; Origin origin; bool along_cut; Point next, line, cut; };

static Clipped own_point(const Point& v) { return {v, Origin::own, false, {}, {}, {}}; }

// What is clipped belongs to the hull E, the clipping side to F, whose normal it has; n is that of E or of F.
struct Clip { bool e_is_a, by_e; Point of_e, of_f; };

static Touch touch_at(const Clip& c, const Clipped& at, double dist) {
  Touch t{};
  t.a = at.v;
  t.dist = dist;
  t.crossing = at.origin == Origin::cut;
  t.held = c.e_is_a == c.by_e;
  Point owner = c.by_e ? c.of_e : c.of_f;
  t.n = t.held ? -1.0 * owner : owner;
  double moves[9] = {};  // of the point, by that of what it is on against the other
  Point x = c.of_f, y = c.of_e;
  if (at.origin == Origin::cut) { x = at.line; y = at.cut; }
  if (at.origin != Origin::own) {
    double along = dot(x, y);
    for (int k = 0; k < 9; ++k) moves[k] = x.x[k / 3] * y.x[k % 3] / along;
  }
  bool rest = at.origin == Origin::other ? !c.e_is_a : c.e_is_a;  // moves with A but for that
  double sign = rest && at.origin != Origin::own ? -1 : 1;
  for (int k = 0; k < 9; ++k) moves[k] = sign * moves[k] + (rest && k % 4 == 0);
  for (int j = 0; j < 3; ++j) {
    t.rise.x[j] = c.e_is_a ? 0 : -c.of_f.x[j];
    for (int k = 0; k < 3; ++k) t.rise.x[j] += c.of_f.x[k] * moves[3 * k + j];
  }
  if (c.e_is_a == c.by_e) {
    t.back = -dist;
    for (int k = 0; k < 9; ++k) moves[k] += t.n.x[k / 3] * t.rise.x[k % 3];
  }
  if (c.by_e) {  // over the clipping side's point
    t.beside = -dist * c.of_f;
    t.leans = c.e_is_a ? 0 : kLeans;
    for (int k = 0; k < 9; ++k) moves[k] -= c.of_f.x[k / 3] * t.rise.x[k % 3];
  }
  for (int k = 0; k < 9; ++k) t.slid[k] = (k % 4 == 0) - moves[k];
  return t;
}

struct Polygon {
  static constexpr int most = 256;
  Clipped at[most];  // set as they are added: most polygons have few corners
  int n = 0, first = 0;  // where it begins, of which it depends what MuJoCo takes

  Polygon() {}
  Polygon(const Polygon&) = delete;  // of 27 kB
  void add(const Clipped& x) { if (n < most) at[n++] = x; }
  int after(int k) const { return k + 1 < n ? k + 1 : 0; }
  Point corner(int k) const { return at[k % n].v; }
};

static void take_side(const PosedHull& H, int face, Polygon& out) {
  int begin = H.m->face_ptr[face], n = H.m->face_ptr[face + 1] - begin;
  if (n > Polygon::most / 2) return;
  for (int k = 0; k < n; ++k) {  // backwards around it, as MuJoCo goes
    Point v = H.vertex(H.m->face_vertex[begin + n - 1 - k]), next = H.vertex(H.m->face_vertex[begin + (2 * n - 2 - k) % n]);
    out.add({v, Origin::own, false, next - v, {}, {}});
  }
}

// What of `polygon` is on the inner side of the plane through p with this normal: into `out`, unless that is all of it or nothing.
enum class Inside { none, part, all };
static Inside clip(const Polygon& polygon, const Point& p, const Point& normal, Polygon& out) {
  double height[Polygon::most];
  int within = 0;
  for (int i = 0; i < polygon.n; ++i) {
    height[i] = dot(normal, polygon.at[i].v - p);
    within += height[i] > -1e-15;
  }
  if (within == 0 || within == polygon.n) return within ? Inside::all : Inside::none;
  out.n = out.first = 0;
  for (int k = 0, i = polygon.first; k < polygon.n; ++k, i = polygon.after(i)) {
    int j = polygon.after(i);
    const Clipped &from = polygon.at[i], &to = polygon.at[j];
    double start = height[i], end = height[j];
    bool inside = start > -1e-15, stays = end > -1e-15;
    if (inside != stays) {
      Clipped x = from;
      x.v = from.v + (start / (start - end)) * (to.v - from.v);
      x.origin = from.along_cut ? Origin::other : Origin::cut;
      x.line = from.next;
      x.cut = normal;
      if (inside) x.along_cut = true;
      out.add(x);
    }
    if (stays) out.add(to);
  }
  return Inside::part;
}

// Corners that are where others are go; returns how many stay.
static int drop_twins(Polygon& polygon, double size) {
  int kept = 0;
  for (int k = 0; k < polygon.n; ++k) {
    bool twin = false;
    for (int i = 0; i < kept; ++i) twin |= size_of(polygon.at[k].v - polygon.at[i].v) < 1e-7 * size;
    if (!twin) polygon.at[kept++] = polygon.at[k];
  }
  return polygon.n = kept;
}

// MuJoCo's walk to four corners that span much.
static void widest_four(const Polygon& p, int* best) {
  int at[4] = {0, 1, 2, 3}, n = p.n;
  auto area = [&] { return size_of(cross(p.corner(at[2]) - p.corner(at[0]), p.corner(at[3]) - p.corner(at[1]))); };
  auto keep_best = [&] { for (int k = 0; k < 4; ++k) best[k] = at[k] % n; };
  double most = area();
  keep_best();
  auto grows = [&](int k) {
    ++at[k];
    double now = area();
    if (now <= most) { --at[k]; return false; }
    most = now;
    keep_best();
    return true;
  };
  for (; at[0] < n; ++at[0]) {
    while (grows(3)) { while (grows(2)) {} while (grows(1)) {} }
    if (at[1] % n == at[0] && ++at[1] == at[2] && ++at[2] == at[3]) ++at[3];
  }
}

// Corners of `polygon` that are below `side` of F, or `reach` above it, and within it. What it holds afterwards is undefined.
static int clip_to(const Clip& c, const Polygon& side, Polygon& whole, bool segment, double reach, Touch* out, int limit = kMostOfSides) {
  if (side.n < 3 || whole.n < 2) return 0;
  Polygon spare, *now = &whole, *next = &spare;
  Point middle = side.at[0].v;
  for (int k = 1; k < side.n; ++k) middle = middle + side.at[k].v;
  middle = (1.0 / side.n) * middle;
  Point centre = whole.at[0].v;
  double spread = 0;  // squared: all of it is within
  for (int k = 1; k < whole.n; ++k) {
    Point away = whole.at[k].v - centre;
    spread = dot(away, away) > spread ? dot(away, away) : spread;
  }
  for (int k = 0; k < side.n; ++k) {
    Point inwards = cross(c.of_f, side.at[k].next);
    if (dot(inwards, middle - side.at[k].v) < 0) inwards = -1.0 * inwards;
    double height = dot(inwards, centre - side.at[k].v);
    if (height > 0 && height * height > spread * dot(inwards, inwards)) { now->first = now->after(now->first); continue; }
    inwards = unit(inwards);
    Inside left = clip(*now, side.at[k].v, inwards, *next);
    if (left == Inside::none) return 0;
    if (left == Inside::all) { now->first = now->after(now->first); continue; }  // MuJoCo's begins one corner on each time
    Polygon* x = now;
    now = next;
    next = x;
  }
  Polygon& polygon = *next;
  polygon.n = polygon.first = 0;
  for (int k = 0, i = now->first; k < now->n; ++k, i = now->after(i))
    if (dot(c.of_f, now->at[i].v - side.at[0].v) <= reach) polygon.add(now->at[i]);
  int kept = polygon.n;
  if (limit > kMostOfSides) kept = drop_twins(polygon, size_of(side.at[0].next));
  int chosen[kMostTouches] = {0, 1, 2, 3, 4, 5, 6, 7}, n = kept < limit ? kept : limit;
  if (kept > limit && limit == kMostOfSides) widest_four(polygon, chosen);
  else if (segment && kept > 2) {
    double most = -1;
    n = 2;
    for (int i = 0; i < kept; ++i)
      for (int j = i + 1; j < kept; ++j) {
        Point apart = polygon.at[j].v - polygon.at[i].v;
        if (dot(apart, apart) > most) { most = dot(apart, apart); chosen[0] = i; chosen[1] = j; }
      }
  }
  for (int k = 0; k < n; ++k) {
    const Clipped& at = polygon.at[chosen[k]];
    out[k] = touch_at(c, at, dot(c.of_f, at.v - side.at[0].v));
  }
  return n;
}

static int clip_to_side(const Clip& c, const PosedHull& F, int face, Polygon& polygon, bool segment, Touch* out, int limit = kMostOfSides) {
  Polygon side;
  take_side(F, face, side);
  return clip_to(c, side, polygon, segment, F.reach, out, limit);
}

static void take_segment(const Point& v, const Point& along, Polygon& segment) {
  segment.add({v, Origin::own, false, along, {}, {}});
  segment.add({v + along, Origin::own, false, -1.0 * along, {}, {}});
}

// Of one hull, the corners that are nearest the other: one, the ends of an edge, or three of a side; and the sides around all of them.
struct Feet {
  static constexpr int most = 64;
  int at[3], n, side[most], nside = 0;

  Feet(const PosedHull& H, int a, int b, int c) : at{a, b, c}, n(a == b ? (a == c ? 1 : 2) : c == a || c == b ? 2 : 3) {
    if (n == 2 && a == b) at[1] = c;
    const Model& m = *H.m;
    for (int k = m.vertex_ptr[a]; k < m.vertex_ptr[a + 1] && nside < most; ++k) {
      int face = m.vertex_face[k];
      bool of_all = true;
      for (int j = 1; j < n; ++j) of_all &= touches(m, face, at[j]);
      if (of_all) side[nside++] = face;
    }
  }
  static bool touches(const Model& m, int face, int vertex) {
    for (int k = m.vertex_ptr[vertex]; k < m.vertex_ptr[vertex + 1]; ++k) if (m.vertex_face[k] == face) return true;
    return false;
  }
};

// Calls f(other end) for edges from the first foot: the one to the second, or all.
template <class F>
static void for_edges(const PosedHull& H, const Feet& feet, F f) {
  if (feet.n == 2) { f(feet.at[1]); return; }
  const Model& m = *H.m;
  for (int k = 0; k < feet.nside; ++k) {
    const int* around = m.face_vertex + m.face_ptr[feet.side[k]];
    int n = m.face_ptr[feet.side[k] + 1] - m.face_ptr[feet.side[k]], at = 0;
    while (around[at] != feet.at[0]) ++at;
    f(around[(at + n - 1) % n]);
  }
}

static int edge_on_side(const PosedHull& E, const Feet& edge, const PosedHull& F, const Feet& sides, bool e_is_a, Touch* out) {
  Point v = E.vertex(edge.at[0]);
  for (int k = 0; k < sides.nside; ++k) {
    Point normal = F.normal(sides.side[k]), level{};
    bool found = false;
    for_edges(E, edge, [&](int end) {
      Point along = E.vertex(end) - v;
      if (found || __builtin_fabs(dot(unit(along), normal)) >= kLevel) return;
      level = along;
      found = true;
    });
    if (!found) continue;
    Polygon segment;
    take_segment(v, level, segment);
    return clip_to_side({e_is_a, false, {}, normal}, F, sides.side[k], segment, true, out);
  }
  return 0;
}

static int side_on_side(const PosedHull& E, const Feet& e, const PosedHull& F, const Feet& f, bool e_is_a, Touch* out) {
  Clip flattest{e_is_a, true, {}, {}};
  double least = -kLying;
  int of_e = -1, of_f = -1;
  for (int i = 0; i < f.nside; ++i)
    for (int j = 0; j < e.nside; ++j) {
      Point x = F.normal(f.side[i]), y = E.normal(e.side[j]);
      if (dot(x, y) >= least) continue;
      least = dot(x, y);
      flattest.of_e = y; flattest.of_f = x;
      of_e = e.side[j]; of_f = f.side[i];
    }
  if (of_e < 0) return -1;
  Polygon polygon;
  take_side(E, of_e, polygon);
  return clip_to_side(flattest, F, of_f, polygon, false, out);
}

}  // namespace cmbrl::CMBRL_ISA
