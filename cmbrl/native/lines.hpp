// Lines: what springs, limits, dry friction and actuators act along. First the dofs themselves, then the fixed tendons, each
// a sum of coefficients times coordinates. A line is a sparse covector over the dofs, which rise.
#pragma once
#include "workspace.hpp"

namespace cmbrl::CMBRL_ISA {

// The rate of a line under velocities x.
static inline T along(const Structure& m, int line, const T* x) {
  int k = m.line_ptr[line];
  T sum = m.line_coef[k] * x[m.line_dof[k]];
  while (++k < m.line_ptr[line + 1]) sum += m.line_coef[k] * x[m.line_dof[k]];
  return sum;
}
// What a pull of the line is on the dofs.
static inline void add_pull(const Structure& m, int line, T pull, T* x) {
  for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k) x[m.line_dof[k]] += m.line_coef[k] * pull;
}
// H += x c c^T for the covector c of the line; the pattern of H couples its dofs.
static inline void add_square(const Structure& m, int line, T x, T* H, Pattern p) {
  int begin = m.line_ptr[line], n = m.line_ptr[line + 1] - begin;
  const int* dof = m.line_dof + begin;
  const double* c = m.line_coef + begin;
  for (int a = 0; a < n; ++a) {
    Row<T> row(H, p, dof[a]);
    const int* columns = p.columns(dof[a]);
    *row.diagonal += (c[a] * c[a]) * x;
    for (int b = 0, k = 0; b < a; ++b, ++k) {
      while (columns[k] != dof[b]) ++k;  // both rise
      T y = (c[a] * c[b]) * x;
      row.before[k] += y;
      row.mirror[k] += y;
    }
  }
}
// The same for a full matrix.
static inline void add_square(const Structure& m, int line, T x, T* A) {
  for (int a = m.line_ptr[line]; a < m.line_ptr[line + 1]; ++a)
    for (int b = m.line_ptr[line]; b < m.line_ptr[line + 1]; ++b)
      A[m.line_dof[a] * m.nv + m.line_dof[b]] += (m.line_coef[a] * m.line_coef[b]) * x;
}

// The same for the direction of a limit.
static inline T along(const Structure& m, const Direction& d, const T* x) {
  if (!d.round) return d.sign * along(m, d.line, x);
  const T* y = x + d.line - 2;
  return d.axis[0] * y[0] + d.axis[1] * y[1] + d.axis[2] * y[2];
}
static inline void add_pull(const Structure& m, const Direction& d, T pull, T* x) {
  if (!d.round) return add_pull(m, d.line, d.sign * pull, x);
  CMBRL_FOR(k, 3) x[d.line - 2 + k] += d.axis[k] * pull;
}
static inline void add_square(const Structure& m, const Direction& d, T x, T* H, Pattern p) {
  if (!d.round) return add_square(m, d.line, x, H, p);
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
static inline void add_square(const Structure& m, const Direction& d, T x, T* A) {
  if (!d.round) return add_square(m, d.line, x, A);
  CMBRL_FOR(a, 3) CMBRL_FOR(b, 3) A[(d.line - 2 + a) * m.nv + d.line - 2 + b] += d.axis[a] * d.axis[b] * x;
}

// Length of a line; of a ball joint's dofs, which have none, 0.
template <class G>
static inline T length_of(const Model& m, const Work<G>& w, int line) {
  T sum = T{};
  for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k)
    if (int q = m.dof_qadr[m.line_dof[k]]; q >= 0) sum += m.line_coef[k] * w.q[q];
  return sum;
}

// How far the line's spring is stretched, and its stiffness there: none in the slack of a tendon.
struct Spring { T stretch, stiffness; };
template <class G>
static inline Spring spring_of(const Model& m, const Work<G>& w, int line) {
  const T* p = w.P + m.oDof + line * kDofFields;
  T x = length_of(m, w, line) - p[kSpringref], slack = splat(m.line_slack[line]);
  return {x - vmin(vmax(x, T{}), slack), keep((x <= 0.0) | (x >= slack), p[kStiffness])};
}

// MuJoCo's Euler takes the damping of joints at the next velocity, that of tendons at the last one.
static inline bool damps_implicitly(const Model& m, int line) { return line < m.nv || m.implicit_gains; }

}  // namespace cmbrl::CMBRL_ISA
