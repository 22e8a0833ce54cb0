// LU of a matrix with the sparsity of a kinematic tree, from the leaves to the root, without pivoting: no fill-in
// (Featherstone 2008, section 6.5, carried over to the non-symmetric M + J^T Theta J of the interior point).
// Dofs of one chain are eliminated several at a time: what they hand on to an ancestor's row is added while that row is at hand.
// The sums are those of one at a time, but long chains leave the nearest cache, where each pass over the matrix costs more than what is
// computed in it.
#pragma once
#include "scene/packed.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr int kRun = 4;  // dofs at a time; of more, their own rows would leave the cache

// n rows of one chain, the last dof's first, to the a-th of the columns that all of them have. `mirrored`: of a symmetric matrix, in
// half the time, mirror images are kept up in rows that are not.
template <int n, bool symmetric>
static inline void hand_on(T* H, Pattern p, T* const* before, T* const* mirror, const int* columns, int a, bool mirrored) {
  Row<T> to(H, p, columns[a]);
  T below[n], right[n];
  CMBRL_FOR(i, n) {
    below[i] = mirror[i][a];
    right[i] = before[i][a];
    *to.diagonal -= below[i] * right[i];
  }
  auto add = [&](auto both, int b, int x) {
    T up = to.before[x];
    if constexpr (symmetric && !both.value) {
      CMBRL_FOR(i, n) up -= below[i] * before[i][b];
    } else {
      T down = to.mirror[x];
      CMBRL_FOR(i, n) {
        up -= below[i] * before[i][b];
        if constexpr (symmetric) down -= below[i] * before[i][b];
        else down -= mirror[i][b] * right[i];
      }
      to.mirror[x] = down;
    }
    to.before[x] = up;
  };
  auto add_all = [&](auto both) {
    if (to.n == a) {  // always in a tree without fill-in: chains begin alike
      for (int b = 0; b < a; ++b) add(both, b, b);
      return;
    }
    const int* place = p.columns(columns[a]);
    for (int b = 0, x = 0; b < a; ++b, ++x) {
      while (place[x] != columns[b]) ++x;
      add(both, b, x);
    }
  };
  if (symmetric && !mirrored) add_all(std::false_type{});
  else add_all(std::true_type{});
}

// Dofs k, k - 1, ... to k - n + 1, each the parent of the one before, and nothing else between them. Of a symmetric matrix, rows that
// are not so any more are marked by `skew`, if there are any. The diagonal keeps its inverse.
template <int n, bool symmetric>
static inline void eliminate(T* H, Pattern p, int k, const uint8_t* skew = nullptr) {
  const int* columns = p.columns(k);
  int shared = p.count(k) - (n - 1);
  T *before[n], *mirror[n];
  auto mirrored = [&](int a) { return skew && skew[columns[a]]; };
  for (int i = 0; i < n; ++i) {
    Row<T> row(H, p, k - i);
    T inv = 1.0 / *row.diagonal;
    *row.diagonal = inv;
    before[i] = row.before;
    mirror[i] = row.mirror;
    for (int a = 0; a < row.n; ++a) row.mirror[a] = (symmetric ? row.before[a] : row.mirror[a]) * inv;
    for (int a = row.n - 1; a >= shared; --a) hand_on<1, symmetric>(H, p, before + i, mirror + i, columns, a, mirrored(a));
  }
  for (int a = shared - 1; a >= 0; --a)  // nearest ancestor first: it is eliminated next and waits for this
    hand_on<n, symmetric>(H, p, before, mirror, columns, a, mirrored(a));
}

// As many dofs as are a chain from k on, at most `most`; returns how many those were.
template <bool symmetric>
static inline int eliminate_chain(T* H, Pattern p, int k, int most, const uint8_t* skew = nullptr) {
  auto of_chain = [&](int j) { return j > 0 && p.count(j) == p.count(j - 1) + 1 && p.columns(j)[p.count(j) - 1] == j - 1; };
  int n = 1;
  while (n < most && of_chain(k - n + 1)) ++n;
  if (n >= kRun) return eliminate<kRun, symmetric>(H, p, k, skew), kRun;
  if (n >= 2) return eliminate<2, symmetric>(H, p, k, skew), 2;
  return eliminate<1, symmetric>(H, p, k, skew), 1;
}

// The factor of a matrix, or in half the time of a symmetric one.
template <bool symmetric>
static inline void factorise(T* H, Pattern p, int nv) {
  for (int k = nv - 1; k >= 0;) k -= eliminate_chain<symmetric>(H, p, k, kRun);
}

}  // namespace cmbrl::CMBRL_ISA
