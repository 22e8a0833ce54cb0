// Lines: what springs, limits, dry friction and actuators act along. First the dofs themselves, then the tendons, each a sum
// of coefficients times coordinates, or of segments between points of bodies, straight or around something; last what only actuators
// act along (linkages.hpp). A line has a length and, over the
// dofs that change it, which rise, a sparse covector: how fast they do.
#pragma once
#include "dynamics/linkages.hpp"
#include "scene/workspace.hpp"
#include "dynamics/wrap.hpp"

namespace cmbrl::CMBRL_ISA {

// The rate of a line under velocities x.
template <class G>
static inline T along(const Structure& m, const SolverWork<G>& w, int line, const T* x) {
  int k = m.line_ptr[line];
  T sum = w.line_c[k] * x[m.line_dof[k]];
  while (++k < m.line_ptr[line + 1]) sum += w.line_c[k] * x[m.line_dof[k]];
  return sum;
}
// What a pull of the line is on the dofs.
template <class G>
static inline void add_pull(const Structure& m, const SolverWork<G>& w, int line, T pull, T* x) {
  for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k) x[m.line_dof[k]] += w.line_c[k] * pull;
}
// H += x c c^T for the covector c of the line; the pattern of H couples its dofs.
template <class G>
static inline void add_square(const Structure& m, const SolverWork<G>& w, int line, T x, T* H, Pattern p) {
  int begin = m.line_ptr[line], n = m.line_ptr[line + 1] - begin;
  const int* dof = m.line_dof + begin;
  const T* c = w.line_c + begin;
  for (int a = 0; a < n; ++a) {
    Row<T> row(H, p, dof[a]);
    const int* columns = p.columns(dof[a]);
    T share = c[a] * x;
    *row.diagonal += c[a] * share;
    for (int b = 0, k = 0; b < a; ++b, ++k) {
      while (columns[k] != dof[b]) ++k;  // both rise
      row.before[k] += c[b] * share;
      row.mirror[k] += c[b] * share;
    }
  }
}
// The same for a full matrix.
template <class G>
static inline void add_square(const Structure& m, const SolverWork<G>& w, int line, T x, T* A) {
  for (int a = m.line_ptr[line]; a < m.line_ptr[line + 1]; ++a)
    for (int b = m.line_ptr[line]; b < m.line_ptr[line + 1]; ++b)
      A[m.line_dof[a] * m.nv + m.line_dof[b]] += w.line_c[a] * w.line_c[b] * x;
}

// The same for the direction of a limit.
template <class G>
static inline T along(const Structure& m, const SolverWork<G>& w, const Direction& d, const T* x) {
  if (!d.round) return d.sign * along(m, w, d.line, x);
  const T* y = x + d.line - 2;
  return d.axis[0] * y[0] + d.axis[1] * y[1] + d.axis[2] * y[2];
}
template <class G>
static inline void add_pull(const Structure& m, const SolverWork<G>& w, const Direction& d, T pull, T* x) {
  if (!d.round) return add_pull(m, w, d.line, d.sign * pull, x);
  CMBRL_FOR(k, 3) x[d.line - 2 + k] += d.axis[k] * pull;
}
template <class G>
static inline void add_square(const Structure& m, const SolverWork<G>& w, const Direction& d, T x, T* H, Pattern p) {
  if (!d.round) return add_square(m, w, d.line, x, H, p);
  for (int a = 0; a < 3; ++a) {
    int dof = d.line - 2 + a;
    Row<T> row(H, p, dof);
    const int* columns = p.columns(dof);
    *row.diagonal += d.axis[a] * d.axis[a] * x;
    for (int b = 0, k = 0; b < a; ++b, ++k) {
      while (columns[k] != d.line - 2 + b) ++k;
      T y = d.axis[a] * d.axis[b] * x;
      row.before[k] += y;
      row.mirror[k] += y;
    }
  }
}
template <class G>
static inline void add_square(const Structure& m, const SolverWork<G>& w, const Direction& d, T x, T* A) {
  if (!d.round) return add_square(m, w, d.line, x, A);
  CMBRL_FOR(a, 3) CMBRL_FOR(b, 3) A[(d.line - 2 + a) * m.nv + d.line - 2 + b] += d.axis[a] * d.axis[b] * x;
}

// A point that a body carries.
template <class G>
static typename G::V place_of(const Work<G>& w, int body, const double* pos) {
  typename G::V x = load<G::D>(pos);
  return body < 0 ? x - w.O : w.pos[body] + G::rotate(w.R[body], x);
}

// A straight piece of a tendon, from a to b along n.
template <class G> struct Segment { typename G::V a, b, n; T length; };
template <class G>
static Segment<G> segment_of(const Model& m, const Work<G>& w, int s) {
  typename G::V a = place_of(w, m.seg_A[s], m.seg_posA + s * G::D), b = place_of(w, m.seg_B[s], m.seg_posB + s * G::D);
  T length = vsqrt(dot(b - a, b - a));
  return {a, b, 1.0 / vmax(length, splat(1e-12)) * (b - a), length};
}
// The velocity of b against a under dof d, which carries one of them.
template <class G>
static typename G::V stretch_of(const Work<G>& w, const Segment<G>& s, int d, int side) {
  return side == kCarriesB ? point_velocity<G>(w.S[d], s.b) : zero<G::D>() - point_velocity<G>(w.S[d], s.a);
}

// A segment that goes around something: how its length changes with its ends, as seen from there (wrap.hpp).
template <class G>
static void find_way(const Model& m, Work<G>& w, int s, bool bends) {
  Bent<G>& way = w.bent[m.seg_wrap[s]];
  if constexpr (G::D == 3) {
    int k = m.seg_wrap[s], body = m.wrap_body[k];
    Obstacle obstacle{m.wrap_radius[k], m.wrap_kind[2 * k] != 0, m.wrap_kind[2 * k + 1] != 0};
    typename G::V centre = place_of(w, body, m.wrap_pos + 3 * k);
    typename G::V site = place_of(w, m.wrap_site_body[k], m.wrap_site + 3 * k) - centre;
    typename G::Rot rot = G::load_rot(m.wrap_rot + 9 * k);
    if (body >= 0) rot = G::compose(w.R[body], rot);
    way.a = place_of(w, m.seg_A[s], m.seg_posA + s * 3);
    way.b = place_of(w, m.seg_B[s], m.seg_posB + s * 3);
    for (int lane = 0; lane < W; ++lane) {
      double a[3], b[3], c[3], axes[3][3];
      for (int i = 0; i < 3; ++i) {
        a[i] = way.a[i][lane] - centre[i][lane]; b[i] = way.b[i][lane] - centre[i][lane]; c[i] = site[i][lane];
        for (int j = 0; j < 3; ++j) axes[j][i] = rot.m[3 * i + j][lane];
      }
      Way found = way_between(obstacle, a, b, axes, c, bends);
      way.length[lane] = found.length;
      for (int i = 0; i < 6; ++i) {
        way.g[i / 3][i % 3][lane] = found.g[i];
        for (int j = 0; j < 6 && bends; ++j) way.H[i][j][lane] = found.H[i][j];
      }
    }
  }
}
// The velocity of an end of it under dof d, as seen from what it goes around; `sign`: 1 if the dof carries the end, -1 if the other.
static inline int sign_of(int side, int end) { return int((side & end) != 0) - int((side & kCarriesObstacle) != 0); }
template <class G>
static typename G::V seen(const Work<G>& w, const Bent<G>& way, int d, int end, int sign) {
  if (!sign) return zero<G::D>();
  typename G::V x = point_velocity<G>(w.S[d], end == kCarriesA ? way.a : way.b);
  return sign > 0 ? x : zero<G::D>() - x;
}
template <class G>
static T rate_around(const Work<G>& w, const Bent<G>& way, int d, int side) {
  return dot(way.g[0], seen(w, way, d, kCarriesA, sign_of(side, kCarriesA))) +
         dot(way.g[1], seen(w, way, d, kCarriesB, sign_of(side, kCarriesB)));
}

// Whether anything asks how covectors of lines change: derivatives, and ties of tendons.
template <class G>
static bool asks_for_bends(const Model& m, const Work<G>& w) {
  bool asks = w.Gq;
  for (int i = 0; i < m.ntie; ++i) asks |= m.tie_type[i] == kPolynomial && (m.tie_A[i] >= m.nv || m.tie_B[i] >= m.nv);
  return asks;
}

// Lengths and covectors of all lines.
template <class G>
static void find_lines(const Model& m, Work<G>& w) {
  for (int i = 0; i < m.nline; ++i) {
    T length = T{};
    for (int k = m.line_ptr[i]; k < m.line_ptr[i + 1]; ++k) {
      w.line_c[k] = splat(m.line_coef[k]);
      if (int q = m.dof_qadr[m.line_dof[k]]; q >= 0) length += m.line_coef[k] * w.q[q];  // a ball's dofs have none
    }
    w.line_length[i] = length;
  }
  bool bends = m.nwrap > 0 && asks_for_bends(m, w);
  for (int i = m.nv; m.nseg && i < m.nline; ++i) {
    int begin = m.line_ptr[i];
    for (int s = m.seg_ptr[i - m.nv]; s < m.seg_ptr[i - m.nv + 1]; ++s) {
      const int* side = m.seg_side + m.seg_sides[s] - begin;
      if (m.seg_wrap[s] >= 0) {
        find_way(m, w, s, bends);
        const Bent<G>& way = w.bent[m.seg_wrap[s]];
        w.line_length[i] += m.seg_scale[s] * way.length;
        for (int k = begin; k < m.line_ptr[i + 1]; ++k)
          if (side[k]) w.line_c[k] += m.seg_scale[s] * rate_around(w, way, m.line_dof[k], side[k]);
        continue;
      }
      Segment<G> segment = segment_of(m, w, s);
      w.line_length[i] += m.seg_scale[s] * segment.length;
      for (int k = begin; k < m.line_ptr[i + 1]; ++k)
        if (side[k]) w.line_c[k] += m.seg_scale[s] * dot(segment.n, stretch_of(w, segment, m.line_dof[k], side[k]));
    }
  }
  if (m.nlink > 0) find_linkages(m, w);
}

// The change of dof k's rate along a segment that goes around something with the coordinate of dof l.
template <class G>
static T bend_around(const Model& m, const Work<G>& w, const Bent<G>& way, int dk, int dl, int side_k, int side_l) {
  const int ends[2] = {kCarriesA, kCarriesB};
  T sum = T{};
  bool after = dk > dl || m.dof_jnt[dk] == m.dof_jnt[dl];
  for (int p = 0; p < 2; ++p) {
    int sign_k = sign_of(side_k, ends[p]);
    if (!sign_k) continue;
    typename G::V x = seen(w, way, dk, ends[p], sign_k);
    for (int q = 0; q < 2; ++q) {
      int sign_l = sign_of(side_l, ends[q]);
      if (!sign_l) continue;
      typename G::V y = seen(w, way, dl, ends[q], sign_l);
      CMBRL_FOR(i, G::D) CMBRL_FOR(j, G::D) sum += x[i] * way.H[G::D * p + i][G::D * q + j] * y[j];
      if (p != q) continue;
      // of two dofs between the obstacle and the end, the one that is nearer to the obstacle turns what the other one does
      bool k_near = sign_k != sign_l ? sign_k < 0 : sign_k < 0 ? after : !after;
      typename G::V turned = k_near ? G::turn(ang<G>(w.S[dk]), y) : G::turn(ang<G>(w.S[dl]), x);
      T change = dot(way.g[p], turned);
      sum += (k_near ? sign_k : sign_l) > 0 ? change : -change;
    }
  }
  return sum;
}

// The change of entry k of a tendon's covector with the coordinate of its entry l.
template <class G>
static T bend_of(const Model& m, const Work<G>& w, int line, int k, int l) {
  if (int link = linkage_of(m, line); link >= 0) return linkage_bend(m, w, link, k, l);
  T sum = T{};
  int dk = m.line_dof[k], dl = m.line_dof[l];
  for (int s = m.seg_ptr[line - m.nv]; s < m.seg_ptr[line - m.nv + 1]; ++s) {
    const int* side = m.seg_side + m.seg_sides[s] - m.line_ptr[line];
    if (!side[k] || !side[l]) continue;
    if (m.seg_wrap[s] >= 0) {
      sum += m.seg_scale[s] * bend_around(m, w, w.bent[m.seg_wrap[s]], dk, dl, side[k], side[l]);
      continue;
    }
    Segment<G> segment = segment_of(m, w, s);
    typename G::V x = stretch_of(w, segment, dk, side[k]), y = stretch_of(w, segment, dl, side[l]);
    T bend = (dot(x, y) - dot(segment.n, x) * dot(segment.n, y)) / vmax(segment.length, splat(1e-12));
    if (side[k] == side[l]) {  // the farther out of two dofs in a chain is moved by the other one
      bool moved = dk > dl || m.dof_jnt[dk] == m.dof_jnt[dl];
      bend += dot(segment.n, G::turn(ang<G>(w.S[moved ? dl : dk]), moved ? x : y));
    }
    sum += m.seg_scale[s] * bend;
  }
  return sum;
}
// The change of a tendon's rate under velocities a x + b y with the coordinate of its entry l.
template <class G>
static T bent_rate(const Model& m, const Work<G>& w, int line, int l, T a, const T* x, T b, const T* y) {
  T sum = T{};
  for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k)
    sum += bend_of(m, w, line, k, l) * (a * x[m.line_dof[k]] + b * y[m.line_dof[k]]);
  return sum;
}
static inline bool bends(const Model& m, int line) {
  return line >= m.nv && (m.seg_ptr[line - m.nv] < m.seg_ptr[line - m.nv + 1] || linkage_of(m, line) >= 0);
}
// What the bending of a line does to its pull, which changes with its rates under x and y by a and b: added to A, by coordinate.
template <class G>
static void add_bend(const Model& m, const Work<G>& w, int line, T pull, T a, const T* x, T b, const T* y, T* A) {
  if (!bends(m, line)) return;
  for (int l = m.line_ptr[line]; l < m.line_ptr[line + 1]; ++l) {
    T change = bent_rate(m, w, line, l, a, x, b, y);
    for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k)
      A[m.line_dof[k] * m.nv + m.line_dof[l]] += pull * bend_of(m, w, line, k, l) + w.line_c[k] * change;
  }
}

// How far the line's spring is stretched, and its stiffness there: none in the slack of a tendon.
struct Spring { T stretch, stiffness; };
template <class G>
static inline Spring spring_of(const Model& m, const Work<G>& w, int line) {
  const T* p = w.P + m.oDof + line * kDofFields;
  T x = w.line_length[line] - p[kSpringref], slack = splat(m.line_slack[line]);
  return {x - vmin(vmax(x, T{}), slack), keep((x <= 0.0) | (x >= slack), p[kStiffness])};
}

// MuJoCo's Euler takes the damping of joints at the next velocity, unless a flag says otherwise, that of tendons at the last one.
static inline bool damps_implicitly(const Model& m, int line) { return line < m.nv ? m.implicit_damping : m.implicit_gains; }
// h times what of the damping along a line, with velocity gains, is implicit.
template <class G>
static inline T implicit_damping(const Model& m, const Options& o, const Work<G>& w, int line) {
  if (o.rk4 || !damps_implicitly(m, line)) return T{};
  T damping = w.P[m.oDof + line * kDofFields + kDamping];
  return o.h * (m.implicit_gains ? damping + w.kd[line] : damping);
}

}  // namespace cmbrl::CMBRL_ISA
