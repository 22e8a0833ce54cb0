// LU of a matrix with the sparsity of a kinematic tree, from the leaves to the root, without pivoting: no fill-in
// (Featherstone 2008, section 6.5, carried over to the non-symmetric M + J^T Theta J of the interior point).
// Matrices are packed (packed.hpp). Dofs that no active row touches are eliminated once a step, the others once an iteration.
#pragma once
#include <type_traits>

#include "dynamics/lines.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G> static inline Pattern pattern_of(const Structure& m, const SolverWork<G>& w) {
  return w.coupled ? w.fill : m.mass;
}

static inline void eliminate(T* H, Pattern p, int k) {
  const int* columns = p.columns(k);
  Row<T> row(H, p, k);
  T inv = 1.0 / *row.diagonal;
  *row.diagonal = inv;  // the diagonal keeps its inverse
  for (int a = 0; a < row.n; ++a) row.mirror[a] *= inv;
  for (int a = row.n - 1; a >= 0; --a) {  // nearest ancestor first: it is eliminated next and waits for this
    Row<T> to(H, p, columns[a]);
    const int* place = p.columns(columns[a]);
    T below = row.mirror[a], right = row.before[a];
    *to.diagonal -= below * right;
    if (to.n == a) {  // always in a tree without fill-in: chains begin alike
      for (int b = 0; b < a; ++b) {
        to.before[b] -= below * row.before[b];
        to.mirror[b] -= row.mirror[b] * right;
      }
      continue;
    }
    for (int b = 0, x = 0; b < a; ++b, ++x) {
      while (place[x] != columns[b]) ++x;
      to.before[x] -= below * row.before[b];
      to.mirror[x] -= row.mirror[b] * right;
    }
  }
}

// The same of a row that is symmetric so far, in half the time: mirror images are kept up in rows that are not, which
// `skew` marks, if there are any.
static inline void eliminate_symmetric(T* H, Pattern p, int k, const uint8_t* skew) {
  const int* columns = p.columns(k);
  Row<T> row(H, p, k);
  T inv = 1.0 / *row.diagonal;
  *row.diagonal = inv;
  for (int a = 0; a < row.n; ++a) row.mirror[a] = row.before[a] * inv;
  for (int a = row.n - 1; a >= 0; --a) {
    Row<T> to(H, p, columns[a]);
    const int* place = p.columns(columns[a]);
    T below = row.mirror[a];
    *to.diagonal -= below * row.before[a];
    auto hand_on = [&](auto mirrored, auto at) {
      for (int b = 0, x = 0; b < a; ++b, ++x) {
        x = at(b, x);
        T share = below * row.before[b];
        to.before[x] -= share;
        if (mirrored) to.mirror[x] -= share;
      }
    };
    auto all_of_them = [](int b, int) { return b; };  // in a tree without fill-in: chains begin alike
    auto some = [&](int b, int x) {
      while (place[x] != columns[b]) ++x;
      return x;
    };
    bool mirrored = skew && skew[columns[a]];
    if (to.n == a) mirrored ? hand_on(std::true_type{}, all_of_them) : hand_on(std::false_type{}, all_of_them);
    else mirrored ? hand_on(std::true_type{}, some) : hand_on(std::false_type{}, some);
  }
}

// The factor of a symmetric matrix, in half the time.
static inline void factorise_symmetric(T* H, Pattern p, int nv) {
  for (int k = nv - 1; k >= 0; --k) eliminate_symmetric(H, p, k, nullptr);
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
    if (!w.dynamic[k]) { eliminate(w.H0, pat, k); copy_row(w.H, w.H0, pat, k); }
}

}  // namespace cmbrl::CMBRL_ISA
