// Contacts of meshes and boxes with each other where rows do not look ahead: those of MuJoCo (hull_sides.hpp), found lane by lane.
// Where they do, corners of boxes look ahead by themselves, and only what touches between corners is taken from here.
#pragma once
#include "hull_sides.hpp"
#include "workspace.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G>
static PosedHull posed(const Model& m, const Work<G>& w, int hull, int body, int lane) {
  PosedHull H{&m, m.hull_ptr[hull], m.hull_ptr[hull + 1] - m.hull_ptr[hull], m.hull_count(hull), m.hull_column + m.hull_block[hull], {1, 0, 0, 0, 1, 0, 0, 0, 1}, {}};
  CMBRL_FOR(k, 9) if (body >= 0) H.R[k] = w.R[body].m[k][lane];
  CMBRL_FOR(k, 3) H.p.x[k] = body >= 0 ? w.pos[body][k][lane] : -w.O[k][lane];
  return H;
}

static inline void set_lane(Vec<3>& to, const Point& from, int lane) { CMBRL_FOR(k, 3) to[k][lane] = from.x[k]; }

template <class G>
static void keep_touch(const Touch& t, Feature<G>& F, int lane) {
  set_lane(F.a, t.a, lane);
  set_lane(F.n, t.n, lane);
  set_lane(F.axisA, t.edges ? t.axisA : t.rise, lane);
  set_lane(F.axisB, t.axisB, lane);
  set_lane(F.beside, t.beside, lane);
  F.dist[lane] = t.dist;
  F.free_s[lane] = F.free_t[lane] = F.turns[lane] = t.edges;
  F.linear[lane] = !t.edges;
  F.held[lane] = !t.edges && t.held;
  F.leans[lane] = t.leans;
  F.back[lane] = t.edges ? 0 : t.back;
  CMBRL_FOR(k, 9) F.slide[k][lane] = t.edges ? 0 : t.slid[k];
}

// Of candidate i's pair of geoms, into w.touch; w.touch_there: the lanes that have as many.
template <class G>
static void find_touches(const Model& m, Work<G>& w, int i) {
  if (w.touch_of == m.con_pair[i]) return;
  w.touch_of = m.con_pair[i];
  if constexpr (G::D == 3) {
    CMBRL_FOR(k, kMostTouches) {
      std::memset(&w.touch[k], 0, sizeof w.touch[k]);
      w.touch_there[k] = none();
    }
    for (int lane = 0; lane < W; ++lane) {
      Touch found[kMostTouches];
      PosedHull A = posed(m, w, m.con_hull[i], m.con_bodyA[i], lane), B = posed(m, w, m.con_hullB[i], m.con_bodyB[i], lane);
      const double *a = m.con_posA + 3 * i, *b = m.con_posB + 3 * i;
      Point between = B.p + B.turned(b) - A.p - A.turned(a);
      int n = touch_hulls(A, B, between, m.con_first[i], m.con_many[i], found);
      for (int k = 0; k < n; ++k) {
        if (!w.by_sides && !found[k].crossing) continue;
        keep_touch(found[k], w.touch[k], lane);
        w.touch_there[k][lane] = -1;
      }
    }
  }
}

}  // namespace cmbrl::CMBRL_ISA
