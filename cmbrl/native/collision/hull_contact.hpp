// Contacts of convex shapes with each other where rows do not look ahead: those of MuJoCo (hull_sides.hpp, hull_boxes.hpp,
// round_contact.hpp, capsule_box.hpp), found lane by lane; and of shapes on height fields (field_contact.hpp), which know of more.
// Where they do, corners of boxes look ahead by themselves, and only what touches between corners is taken from here.
#pragma once
#include "collision/field_contact.hpp"
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G>
static PosedHull posed(const Model& m, const Work<G>& w, int hull, int body, double reach, int lane, Point* made) {
  PosedHull H;
  H.m = &m;
  H.points = m.hull_point;
  H.normals = m.face_normal;
  H.first_point = H.first_face = 0;
  H.bound = m.hull_bound + 6 * hull;
  H.kind = m.hull_kind[hull];
  H.reach = reach;
  H.begin = m.hull_ptr[hull];
  H.vertices = m.hull_ptr[hull + 1] - H.begin;
  H.count = m.hull_count(hull);
  H.columns = m.hull_column + m.hull_block[hull];
  H.starts = m.hull_graph[hull] < 0 ? nullptr : m.climb_start + m.hull_graph[hull] * Model::climb_cells;
  H.made = made;
  CMBRL_FOR(k, 9) H.R[k] = k % 4 == 0;
  CMBRL_FOR(k, 9) if (body >= 0) H.R[k] = w.R[body].m[k][lane];
  CMBRL_FOR(k, 3) H.p.x[k] = body >= 0 ? w.pos[body][k][lane] : -w.O[k][lane];
  H.place(m.hull_box + 15 * hull);
  return H;
}

static inline void set_lane(Vec<3>& to, const Point& from, int lane) { CMBRL_FOR(k, 3) to[k][lane] = from.x[k]; }

template <class G>
static void keep_touch(const Touch& t, Feature<G>& F, int lane) {
  set_lane(F.a, t.a, lane);
  set_lane(F.n, t.n, lane);
  set_lane(F.axisA, t.edges || t.bends ? t.axisA : t.rise, lane);
  set_lane(F.axisB, t.axisB, lane);
  set_lane(F.beside, t.beside, lane);
  F.dist[lane] = t.dist;
  F.free_s[lane] = F.free_t[lane] = F.turns[lane] = t.edges;
  F.bends[lane] = t.bends;
  F.linear[lane] = !t.edges && !t.bends;
  F.held[lane] = !t.edges && t.held;
  F.leans[lane] = t.leans;
  F.back[lane] = t.edges ? 0 : t.back;
  CMBRL_FOR(k, 9) F.slide[k][lane] = t.edges ? 0 : t.slid[k];
}

// Whether candidate i is of a shape and a height field.
static inline bool of_field(const Model& m, int i) { return m.con_type[i] == kHulls && m.hull_kind[m.con_hullB[i]] == kField; }

// Those of candidate i's pair of geoms in one lane. Returns how many of `found` there are.
template <class G>
static int touches_in_lane(const Model& m, const Work<G>& w, int i, int lane, Touch* found) {
  Point of_a[kMostMade], of_b[kMostMade];
  bool field = of_field(m, i);
  double reach = __builtin_fmax(m.con_reach[i], field ? w.sight[lane] : 0);
  PosedHull A = posed(m, w, m.con_hull[i], m.con_bodyA[i], reach, lane, of_a);
  if (field) {
    Point origin{{w.O[0][lane], w.O[1][lane], w.O[2][lane]}};
    return touch_field(m, A, PosedField(m, m.con_hullB[i], origin), !w.prisms, found, m.con_touches[i]);
  }
  PosedHull B = posed(m, w, m.con_hullB[i], m.con_bodyB[i], reach, lane, of_b);
  const double *a = m.con_posA + 3 * i, *b = m.con_posB + 3 * i;
  return touches_of(A, B, B.p + B.turned(b) - A.p - A.turned(a), m.con_first[i], m.con_many[i], found);
}

// Of candidate i's pair of geoms, into w.touch; w.touch_there: the lanes of w.may_touch that have as many.
template <class G>
static void find_touches(const Model& m, Work<G>& w, int i) {
  if (w.touch_of == m.con_pair[i]) return;
  w.touch_of = m.con_pair[i];
  if constexpr (G::D == 3) {
    for (int k = 0; k < m.most_touches; ++k) w.touch_there[k] = none();
    int cleared = 0;
    for (int lane = 0; lane < w.lanes; ++lane) {
      if (!w.may_touch[lane]) continue;
      Touch found[kMostOfField];
      int n = touches_in_lane(m, w, i, lane, found);
      for (; cleared < n; ++cleared) std::memset(&w.touch[cleared], 0, sizeof w.touch[cleared]);
      for (int k = 0; k < n; ++k) {
        if (!w.by_sides && !found[k].crossing && !of_field(m, i)) continue;
        keep_touch(found[k], w.touch[k], lane);
        w.touch_there[k][lane] = -1;
      }
    }
    int last = w.lanes - 1;
    for (int k = 0; k < cleared && last < W - 1; ++k) {
      if (!w.touch_there[k][last]) continue;
      copy_lane(~up_to(last), last, sizeof w.touch[k] / sizeof(T), reinterpret_cast<T*>(&w.touch[k]));
      w.touch_there[k] |= ~up_to(last);
    }
  }
}

// The touch of a row that is read back from a tape, if it stands there.
template <class G>
static bool recall_touch(const Given& given, Feature<G>& F) {
  if (!given.touch[first_of(given.on)]) return false;
  T* x = reinterpret_cast<T*>(&F);
  for (size_t k = 0; k < sizeof F / sizeof(T); ++k) {
    x[k] = T{};
    for (int lane = 0; lane < W; ++lane) if (given.on[lane]) x[k][lane] = given.touch[lane][k];
  }
  return true;
}

}  // namespace cmbrl::CMBRL_ISA
