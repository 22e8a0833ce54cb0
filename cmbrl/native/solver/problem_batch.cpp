#include "solver/problem_batch.hpp"

#include <algorithm>

#include "base/fill.hpp"

namespace cmbrl {

const Structure& ProblemStructure::of(const ProblemBatch& b, int64_t begin, int64_t end) {
  int nv = b.nv, rows = 1 + b.tangents, words = FillPattern::words(nv);
  bits_.assign((2 * nv + b.contacts) * words, 0);
  FillPattern mass{bits_.data(), nv}, both{mass.row(nv), nv};
  auto columns = [&](int contact) { return both.row(nv) + contact * words; };
  auto mark = [&](const double* x, int n, uint64_t* row) {
    for (int word = 0; word < n; word += 64) {
      uint64_t found = 0;
      for (int i = word; i < std::min(n, word + 64); ++i) found |= uint64_t(x[i] != 0) << (i - word);
      row[word / 64] |= found;
    }
  };
  for (int64_t k = begin; k < end; ++k) {
    const double *M = b.M + k * nv * nv, *J = b.J + k * b.contacts * rows * nv;
    for (int i = 0; i < nv; ++i) mark(M + i * nv, i, mass.row(i));
    for (int r = 0; r < b.contacts * rows; ++r) mark(J + r * nv, nv, columns(r / rows));
  }
  for (int i = 0; i < nv * words; ++i) both.bits[i] = mass.bits[i];
  dof_ptr_.assign(1, 0);
  dof_.clear();
  for (int c = 0; c < b.contacts; ++c) {
    both.couple_all(columns(c));
    both.for_each(columns(c), [&](int k) { dof_.push_back(k); });
    dof_ptr_.push_back(int(dof_.size()));
  }
  sign_.assign(dof_.size(), 1);
  auto list = [nv](FillPattern& pattern, std::vector<int>& ptr, std::vector<int>& idx) {
    pattern.fill_in();
    ptr.resize(nv + 1);
    idx.resize(pattern.count());
    pattern.list(ptr.data(), idx.data());
  };
  list(mass, mass_ptr_, mass_idx_);
  list(both, fill_ptr_, fill_idx_);
  structure_ = {nv, {mass_ptr_.data(), mass_idx_.data()}, {fill_ptr_.data(), fill_idx_.data()}, dof_ptr_.data(), dof_.data(), sign_.data(), nullptr, nullptr};
  return structure_;
}

}  // namespace cmbrl
