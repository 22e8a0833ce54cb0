// LU of a matrix with the sparsity of a kinematic tree, from the leaves to the root, without pivoting: no fill-in
// (Featherstone 2008, section 6.5, carried over to the non-symmetric M + J^T Theta J of the interior point).
// Dofs that no active row touches are eliminated once a step, the others once an iteration.
#pragma once
#include "workspace.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G> static inline Pattern pattern_of(const Structure& m, const SolverWork<G>& w) {
  return w.coupled ? w.fill : Pattern{m.anc_ptr, m.anc_idx};
}

static inline void eliminate(T* H, int nv, Pattern p, int k) {
  T inv = 1.0 / H[k * nv + k];
  H[k * nv + k] = inv;  // the diagonal keeps its inverse
  const T* row = H + k * nv;
  for (int a = p.ptr[k + 1] - 1; a >= p.ptr[k]; --a) {  // nearest ancestor first: it is eliminated next and waits for this
    int i = p.idx[a];
    T f = H[i * nv + k] * inv;
    H[i * nv + k] = f;
    T* target = H + i * nv;
    for (int b = p.ptr[k]; b < p.ptr[k + 1]; ++b) target[p.idx[b]] -= f * row[p.idx[b]];
  }
}

static inline void copy_row(T* to, const T* from, int nv, Pattern p, int k) {
  to[k * nv + k] = from[k * nv + k];
  for (int a = p.ptr[k]; a < p.ptr[k + 1]; ++a) {
    int j = p.idx[a];
    to[k * nv + j] = from[k * nv + j];
    to[j * nv + k] = from[j * nv + k];
  }
}

// Solve H x = b in place on the dofs [lowest, nv) listed downwards; x may hold several columns.
static inline void solve_down(const T* H, int nv, Pattern p, int k, T* x) {
  T from = x[k];
  for (int a = p.ptr[k + 1] - 1; a >= p.ptr[k]; --a) x[p.idx[a]] -= H[p.idx[a] * nv + k] * from;
}
static inline void solve_up(const T* H, int nv, Pattern p, int k, T* x) {
  T r = x[k];
  for (int a = p.ptr[k]; a < p.ptr[k + 1]; ++a) r -= H[k * nv + p.idx[a]] * x[p.idx[a]];
  x[k] = r * H[k * nv + k];
}
static inline void solve(const T* H, int nv, Pattern p, T* x) {
  for (int k = nv - 1; k >= 0; --k) solve_down(H, nv, p, k, x);
  for (int k = 0; k < nv; ++k) solve_up(H, nv, p, k, x);
}
// H^T y = x in place.
static inline void solve_transposed(const T* H, int nv, Pattern p, T* x) {
  for (int k = nv - 1; k >= 0; --k) {
    x[k] *= H[k * nv + k];
    for (int a = p.ptr[k]; a < p.ptr[k + 1]; ++a) x[p.idx[a]] -= H[k * nv + p.idx[a]] * x[k];
  }
  for (int k = 0; k < nv; ++k)
    for (int a = p.ptr[k]; a < p.ptr[k + 1]; ++a) x[k] -= H[p.idx[a] * nv + k] * x[p.idx[a]];
}
// ncol right-hand sides, x is nv x ncol row-major.
static inline void solve_many(const T* H, int nv, Pattern p, T* x, int ncol) {
  for (int k = nv - 1; k >= 0; --k)
    for (int a = p.ptr[k]; a < p.ptr[k + 1]; ++a) {
      T f = H[p.idx[a] * nv + k];
      T *to = x + p.idx[a] * ncol, *from = x + k * ncol;
      for (int c = 0; c < ncol; ++c) to[c] -= f * from[c];
    }
  for (int k = 0; k < nv; ++k) {
    T* row = x + k * ncol;
    for (int a = p.ptr[k]; a < p.ptr[k + 1]; ++a) {
      T f = H[k * nv + p.idx[a]];
      const T* from = x + p.idx[a] * ncol;
      for (int c = 0; c < ncol; ++c) row[c] -= f * from[c];
    }
    T inv = H[k * nv + k];
    for (int c = 0; c < ncol; ++c) row[c] *= inv;
  }
}

// Finds the dofs that rows touch, straight or through the pattern; the others are eliminated now, once a step (in H0 and H).
template <class G>
static void eliminate_untouched(const Structure& m, SolverWork<G>& w) {
  int nv = m.nv;
  Pattern pat = pattern_of(m, w);
  for (int i = 0; i < nv; ++i) w.dynamic[i] = 0;
  for (int g = 0; g < w.ngroups; ++g)
    for (int k = m.grp_dptr[w.groups[g].group]; k < m.grp_dptr[w.groups[g].group + 1]; ++k) w.dynamic[m.grp_dof[k]] = 1;
  for (int i = 0; i < w.nlim; ++i) w.dynamic[w.lim[i].dof] = 1;
  for (int i = 0; i < w.ndry; ++i) w.dynamic[w.dry[i].dof] = 1;
  w.ndyn = 0;
  for (int k = nv - 1; k >= 0; --k) {
    if (w.dynamic[k]) {
      w.dyn_list[w.ndyn++] = k;
      for (int a = pat.ptr[k]; a < pat.ptr[k + 1]; ++a) w.dynamic[pat.idx[a]] = 1;
    }
    copy_row(w.H0, w.M, nv, pat, k);
  }
  for (int k = nv - 1; k >= 0; --k)
    if (!w.dynamic[k]) { eliminate(w.H0, nv, pat, k); copy_row(w.H, w.H0, nv, pat, k); }
}

}  // namespace cmbrl::CMBRL_ISA
