// One row of a packed matrix (model.hpp: Pattern).
#pragma once
#include "model.hpp"

namespace cmbrl::CMBRL_ISA {

template <class X>
struct Row {
  int n;
  X *diagonal, *before, *mirror;  // (k, k); (k, j) and (j, k) for the n columns j before k

  Row(X* matrix, Pattern p, int k) : n(p.count(k)), diagonal(matrix + p.row(k)), before(diagonal + 1), mirror(before + n) {}
};

}  // namespace cmbrl::CMBRL_ISA
