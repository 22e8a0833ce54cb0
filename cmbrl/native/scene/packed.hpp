// One row of a packed matrix (model.hpp: Pattern), and where its columns are.
#pragma once
#include "scene/model.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr int kBlock = 8;  // columns of a wide matrix that are worked on at once: few stay in registers and the nearest cache

template <class X>
struct Row {
  int n;
  X *diagonal, *before, *mirror;  // (k, k); (k, j) and (j, k) for the n columns j before k

  Row(X* matrix, Pattern p, int k) : n(p.count(k)), diagonal(matrix + p.row(k)), before(diagonal + 1), mirror(before + n) {}
};

// A pattern by columns: the rows behind column j that have it, the last one first, and where their mirror images of it stand.
struct Below {
  int *ptr, *row, *place;

  template <class A>
  void take(A& arena, int64_t nv, int64_t columns) {
    ptr = arena.template take<int>(nv + 1);
    row = arena.template take<int>(columns);
    place = arena.template take<int>(columns);
  }
  void fill(Pattern p, int nv, const uint8_t* chosen = nullptr) {  // of chosen rows; nothing: of all
    for (int j = 0; j <= nv; ++j) ptr[j] = 0;
    auto for_entries = [&](auto f) {
      for (int k = 0; k < nv; ++k)
        for (int a = p.ptr[k]; (!chosen || chosen[k]) && a < p.ptr[k + 1]; ++a) f(k, a);
    };
    for_entries([&](int, int a) { ++ptr[p.idx[a]]; });
    for (int j = 1; j <= nv; ++j) ptr[j] += ptr[j - 1];  // where each column ends; filled from there on down
    for_entries([&](int k, int a) {
      int to = --ptr[p.idx[a]];
      row[to] = k;
      place[to] = p.row(k) + 1 + p.count(k) + a - p.ptr[k];
    });
  }
};

}  // namespace cmbrl::CMBRL_ISA
