// One row of a packed matrix (model.hpp: Pattern).
#pragma once
#include "model.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr int kBlock = 8;  // columns of a wide matrix that are worked on at once: few stay in registers and the nearest cache

template <class X>
struct Row {
  int n;
  X *diagonal, *before, *mirror;  // (k, k); (k, j) and (j, k) for the n columns j before k

  Row(X* matrix, Pattern p, int k) : n(p.count(k)), diagonal(matrix + p.row(k)), before(diagonal + 1), mirror(before + n) {}
};

}  // namespace cmbrl::CMBRL_ISA
