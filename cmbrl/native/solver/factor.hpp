// Factors of packed matrices (packed.hpp) with the sparsity of a kinematic tree (elimination.hpp), and what they solve.
// Dofs that no active row touches are eliminated once a step, the others once an iteration.
#pragma once
#include <type_traits>

#include "dynamics/lines.hpp"
#include "solver/elimination.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G> static inline Pattern pattern_of(const Structure& m, const SolverWork<G>& w) {
  return w.coupled ? w.fill : m.mass;
}

static inline void copy_row(T* to, const T* from, Pattern p, int k, bool mirrored = true) {
  int begin = p.row(k), end = mirrored ? p.row(k + 1) : begin + 1 + p.count(k);
  for (int i = begin; i < end; ++i) to[i] = from[i];
}
// The same from a pattern that is part of `p`; zeros elsewhere.
static inline void spread_row(T* to, Pattern p, const T* from, Pattern part, int k) {
  Row<T> row(to, p, k);
  Row<const T> known(from, part, k);
  const int *columns = p.columns(k), *here = part.columns(k);
  *row.diagonal = *known.diagonal;
  for (int a = 0, x = 0; a < row.n; ++a) {
    bool given = x < known.n && here[x] == columns[a];
    row.before[a] = given ? known.before[x] : T{};
    row.mirror[a] = given ? known.mirror[x] : T{};
    x += given;
  }
}

// Solve H x = b in place, one dof at a time: downwards through all of them, then upwards.
static inline void solve_down(const T* H, Pattern p, int k, T* x) {
  Row<const T> row(H, p, k);
  const int* columns = p.columns(k);
  T from = x[k];
  for (int a = row.n - 1; a >= 0; --a) x[columns[a]] -= row.mirror[a] * from;
}
// The same, of what has been handed on to dof k: nothing is written that the next dof would have to wait for.
static inline void solve_down(const T* H, const Below& below, int k, T* x) {
  T sum = x[k];
  for (int e = below.ptr[k]; e < below.ptr[k + 1]; ++e) sum -= H[below.place[e]] * x[below.row[e]];
  x[k] = sum;
}
static inline void solve_up(const T* H, Pattern p, int k, T* x) {
  Row<const T> row(H, p, k);
  const int* columns = p.columns(k);
  T r = x[k];
  for (int a = 0; a < row.n; ++a) r -= row.before[a] * x[columns[a]];
  x[k] = r * *row.diagonal;
}
static inline void solve(const T* H, int nv, Pattern p, T* x) {
  for (int k = nv - 1; k >= 0; --k) solve_down(H, p, k, x);
  for (int k = 0; k < nv; ++k) solve_up(H, p, k, x);
}
// H^T y = x in place.
static inline void solve_transposed(const T* H, int nv, Pattern p, T* x) {
  for (int k = nv - 1; k >= 0; --k) {
    Row<const T> row(H, p, k);
    x[k] *= *row.diagonal;
    for (int a = 0; a < row.n; ++a) x[p.columns(k)[a]] -= row.before[a] * x[k];
  }
  for (int k = 0; k < nv; ++k) {
    Row<const T> row(H, p, k);
    for (int a = 0; a < row.n; ++a) x[k] -= row.mirror[a] * x[p.columns(k)[a]];
  }
}
// n right-hand sides, in rows that are `stride` apart.
template <int n>
static inline void solve_columns_up(const T* H, int nv, Pattern p, T* x, int64_t stride) {
  for (int k = 0; k < nv; ++k) {
    Row<const T> row(H, p, k);
    const int* columns = p.columns(k);
    T sum[n];
    for (int c = 0; c < n; ++c) sum[c] = x[k * stride + c];
    for (int a = 0; a < row.n; ++a) {
      T f = row.before[a];
      const T* from = x + columns[a] * stride;
      for (int c = 0; c < n; ++c) sum[c] -= f * from[c];
    }
    T inv = *row.diagonal;
    for (int c = 0; c < n; ++c) x[k * stride + c] = sum[c] * inv;
  }
}
template <int n>
static inline void solve_columns(const T* H, int nv, Pattern p, T* x, int64_t stride) {
  for (int k = nv - 1; k >= 0; --k) {
    Row<const T> row(H, p, k);
    const int* columns = p.columns(k);
    T from[n];
    for (int c = 0; c < n; ++c) from[c] = x[k * stride + c];
    for (int a = 0; a < row.n; ++a) {
      T f = row.mirror[a], *to = x + columns[a] * stride;
      for (int c = 0; c < n; ++c) to[c] -= f * from[c];
    }
  }
  solve_columns_up<n>(H, nv, p, x, stride);
}
// The same where the factor is at hand by columns as well: each row is written once, not once for every row behind it.
template <int n>
static inline void solve_columns(const T* H, int nv, Pattern p, const Below& below, T* x, int64_t stride) {
  for (int k = nv - 1; k >= 0; --k) {
    T sum[n];
    for (int c = 0; c < n; ++c) sum[c] = x[k * stride + c];
    for (int e = below.ptr[k]; e < below.ptr[k + 1]; ++e) {
      T f = H[below.place[e]];
      const T* from = x + below.row[e] * stride;
      for (int c = 0; c < n; ++c) sum[c] -= f * from[c];
    }
    for (int c = 0; c < n; ++c) x[k * stride + c] = sum[c];
  }
  solve_columns_up<n>(H, nv, p, x, stride);
}
// Calls f(first, n) for the columns of a wide matrix, n at a time.
template <int n = kBlock, class F>
static inline void for_blocks(int ncol, F f, int first = 0) {
  for (; first + n <= ncol; first += n) f(first, std::integral_constant<int, n>{});
  if constexpr (n > 1) for_blocks<n / 2>(ncol, f, first);
}
// ncol right-hand sides, x is nv x ncol row-major.
static inline void solve_many(const T* H, int nv, Pattern p, T* x, int ncol) {
  for_blocks(ncol, [&](int c, auto n) { solve_columns<n>(H, nv, p, x + c, ncol); });
}

// Finds the dofs that rows touch, straight or through the pattern; the others are eliminated now, once a step (in H0 and H).
template <class G>
static void eliminate_untouched(const Structure& m, SolverWork<G>& w) {
  int nv = m.nv;
  Pattern pat = pattern_of(m, w);
  for (int i = 0; i < nv; ++i) w.dynamic[i] = w.skew[i] = 0;
  for (int g = 0; g < w.ngroups; ++g)
    for (int k = m.grp_dptr[w.groups[g].group]; k < m.grp_dptr[w.groups[g].group + 1]; ++k) w.dynamic[m.grp_dof[k]] = w.skew[m.grp_dof[k]] = 1;
  auto touch = [&](int line) {
    for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k) w.dynamic[m.line_dof[k]] = 1;
  };
  for (int i = 0; i < w.nlim; ++i) touch(w.lim[i].line);
  for (int i = 0; i < w.ndry; ++i) touch(w.dry[i].line);
  w.ndyn = 0;
  for (int k = nv - 1; k >= 0; --k) {
    if (w.dynamic[k]) {
      w.dyn_list[w.ndyn++] = k;
      for (int a = pat.ptr[k]; a < pat.ptr[k + 1]; ++a) {
        w.dynamic[pat.idx[a]] = 1;
        w.skew[pat.idx[a]] |= w.skew[k];
      }
    }
    spread_row(w.H0, pat, w.M, m.mass, k);
  }
  for (int k = nv - 1; k >= 0; --k)
    if (!w.dynamic[k]) { eliminate<1, false>(w.H0, pat, k); copy_row(w.H, w.H0, pat, k); }
}

}  // namespace cmbrl::CMBRL_ISA
