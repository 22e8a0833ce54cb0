// Lines: what springs, limits, dry friction and actuators act along. First the dofs themselves, then the tendons, each a sum
// of coefficients times coordinates, or of straight segments between points of bodies. A line has a length and, over the
// dofs that change it, which rise, a sparse covector: how fast they do.
#pragma once
#include "workspace.hpp"

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
  for (int i = m.nv; m.nseg && i < m.nline; ++i) {
    int begin = m.line_ptr[i];
    for (int s = m.seg_ptr[i - m.nv]; s < m.seg_ptr[i - m.nv + 1]; ++s) {
      Segment<G> segment = segment_of(m, w, s);
      const int* side = m.seg_side + m.seg_sides[s] - begin;
      w.line_length[i] += m.seg_scale[s] * segment.length;
      for (int k = begin; k < m.line_ptr[i + 1]; ++k)
        if (side[k]) w.line_c[k] += m.seg_scale[s] * dot(segment.n, stretch_of(w, segment, m.line_dof[k], side[k]));
    }
  }
}

// The change of entry k of a tendon's covector with the coordinate of its entry l.
template <class G>
static T bend_of(const Model& m, const Work<G>& w, int line, int k, int l) {
  T sum = T{};
  int dk = m.line_dof[k], dl = m.line_dof[l];
  for (int s = m.seg_ptr[line - m.nv]; s < m.seg_ptr[line - m.nv + 1]; ++s) {
    const int* side = m.seg_side + m.seg_sides[s] - m.line_ptr[line];
    if (!side[k] || !side[l]) continue;
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
static inline bool bends(const Model& m, int line) { return line >= m.nv && m.seg_ptr[line - m.nv] < m.seg_ptr[line - m.nv + 1]; }
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

// MuJoCo's Euler takes the damping of joints at the next velocity, that of tendons at the last one.
static inline bool damps_implicitly(const Model& m, int line) { return line < m.nv || m.implicit_gains; }
// h times what of the damping along a line, with velocity gains, is implicit.
template <class G>
static inline T implicit_damping(const Model& m, const Options& o, const Work<G>& w, int line) {
  if (!damps_implicitly(m, line)) return T{};
  T damping = w.P[m.oDof + line * kDofFields + kDamping];
  return o.h * (m.implicit_gains ? damping + w.kd[line] : damping);
}

}  // namespace cmbrl::CMBRL_ISA
