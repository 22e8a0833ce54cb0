// Split damping, the order of MuJoCo's steps: contacts, limits, equality constraints and dry friction find their impulses, and the
// velocity u, as if damping and velocity gains acted with the velocity v of the step's start; then these become implicit,
//   (M + D) (v' - v) = M (u - v),   or   v' = u - y with K y = D (u - v), K = M + D,
// where D is h times what damps, with the Coriolis forces of gyro.hpp not symmetric; as in MuJoCo, without what a tendon couples of two branches of the tree. u is the velocity vn of the step's equation (derivative.hpp), v' is vstep.
#pragma once
#include "solver/factor.hpp"

namespace cmbrl::CMBRL_ISA {

// Whether one of two dofs carries the other.
static inline bool in_one_chain(const Model& m, int a, int b) {
  int outer = a > b ? a : b, inner = a > b ? b : a;
  for (int k = m.anc_ptr[outer]; k < m.anc_ptr[outer + 1]; ++k)
    if (m.anc_idx[k] == inner) return true;
  return a == b;
}
// f(entry) of a line's dofs in one chain with that of entry k.
template <class F>
static void for_chain(const Model& m, int line, int k, F f) {
  for (int l = m.line_ptr[line]; l < m.line_ptr[line + 1]; ++l)
    if (in_one_chain(m, m.line_dof[k], m.line_dof[l])) f(l);
}

// D += x c c^T of a line.
template <class G>
static void add_drag(const Model& m, Work<G>& w, int line, T x) {
  if (!any(x != 0.0)) return;
  if (line < m.nv) {  // its dof alone
    w.D[m.mass.row(line)] += x;
    return;
  }
  for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k) {
    int dof = m.line_dof[k];
    Row<T> row(w.D, m.mass, dof);
    T share = w.line_c[k] * x;
    for_chain(m, line, k, [&](int l) {
      if (l == k) *row.diagonal += share * w.line_c[k];
      if (l >= k) return;
      int a = 0;
      while (m.mass.columns(dof)[a] != m.line_dof[l]) ++a;
      row.before[a] += share * w.line_c[l];
      row.mirror[a] += share * w.line_c[l];
    });
  }
}
// The rate of a line under x, of the dofs in one chain with that of entry k.
template <class G>
static T chain_rate(const Model& m, const Work<G>& w, int line, int k, const T* x) {
  T rate = T{};
  for_chain(m, line, k, [&](int l) { rate += w.line_c[l] * x[m.line_dof[l]]; });
  return rate;
}
// Adds -dD x by coordinate, of a line that bends.
template <class G>
static void add_bent_drag(const Model& m, const Work<G>& w, int line, T drag, const T* x, T* A) {
  if (!bends(m, line)) return;
  for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k) {
    T rate = chain_rate(m, w, line, k, x);
    for (int j = m.line_ptr[line]; j < m.line_ptr[line + 1]; ++j) {
      T bent = T{};
      for_chain(m, line, k, [&](int l) { bent += bend_of(m, w, line, l, j) * x[m.line_dof[l]]; });
      A[m.line_dof[k] * m.nv + m.line_dof[j]] -= drag * (bend_of(m, w, line, k, j) * rate + w.line_c[k] * bent);
    }
  }
}

// The factor of K, from M without ties.
template <class G>
static void split_factor(const Model& m, Work<G>& w) {
  for (int i = 0; i < m.mass.row(m.nv); ++i) w.K[i] = w.M[i] + w.D[i];
  m.ngyro == 0 ? factorise<true>(w.K, m.mass, m.nv) : factorise<false>(w.K, m.mass, m.nv);
}

// f(i, k, D_ik) of the entries of D.
template <class G, class F>
static inline void for_drags(const Model& m, const Work<G>& w, F f) {
  bool coupled = m.ntendon > 0 || m.in_fluid() || m.ngyro > 0;  // otherwise each dof damps itself alone
  for (int i = 0; i < m.nv; ++i) {
    Row<const T> row(w.D, m.mass, i);
    f(i, i, *row.diagonal);
    for (int a = 0; coupled && a < row.n; ++a) {
      int k = m.mass.columns(i)[a];
      f(i, k, row.before[a]);
      f(k, i, row.mirror[a]);
    }
  }
}

// y of the velocity vn.
template <class G>
static void damped_away(const Model& m, const Work<G>& w, T* y) {
  for (int i = 0; i < m.nv; ++i) y[i] = T{};
  for_drags(m, w, [&](int i, int k, T damping) { y[i] += damping * (w.vn[k] - w.v[k]); });
  solve(w.K, m.nv, m.mass, y);
}

}  // namespace cmbrl::CMBRL_ISA
