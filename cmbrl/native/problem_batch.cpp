#include "problem_batch.hpp"

#include <algorithm>

namespace cmbrl {

namespace {
using Bits = std::vector<uint8_t>;  // nv x nv, row-major

// Pattern of the factor below the diagonal: eliminating k couples all dofs that k is coupled to.
void fill_in(Bits& p, int nv, std::vector<int>& ptr, std::vector<int>& idx) {
  std::vector<std::vector<int>> rows(nv);
  for (int k = nv - 1; k >= 0; --k) {
    std::vector<int>& row = rows[k];
    for (int j = 0; j < k; ++j)
      if (p[k * nv + j]) row.push_back(j);
    for (int a : row)
      for (int b : row) p[a * nv + b] = 1;
  }
  ptr.assign(1, 0);
  for (const auto& row : rows) {
    idx.insert(idx.end(), row.begin(), row.end());
    ptr.push_back(int(idx.size()));
  }
}
}  // namespace

ProblemStructure::ProblemStructure(const ProblemBatch& b) {
  int nv = b.nv, rows = 1 + b.tangents;
  Bits mass(nv * nv, 0), column(size_t(b.contacts) * nv, 0);
  for (int64_t k = 0; k < b.n; ++k) {
    const double *M = b.M + k * nv * nv, *J = b.J + k * b.contacts * rows * nv;
    for (int i = 0; i < nv * nv; ++i) mass[i] |= M[i] != 0;
    for (int c = 0; c < b.contacts; ++c)
      for (int r = 0; r < rows; ++r)
        for (int i = 0; i < nv; ++i) column[c * nv + i] |= J[(c * rows + r) * nv + i] != 0;
  }
  dof_ptr_.push_back(0);
  Bits both = mass;
  for (int c = 0; c < b.contacts; ++c) {
    for (int i = 0; i < nv; ++i)
      if (column[c * nv + i]) dof_.push_back(i);
    for (int x = dof_ptr_.back(); x < int(dof_.size()); ++x)
      for (int y = dof_ptr_.back(); y < x; ++y) both[dof_[x] * nv + dof_[y]] = 1;
    dof_ptr_.push_back(int(dof_.size()));
  }
  sign_.assign(dof_.size(), 1);
  fill_in(mass, nv, anc_ptr_, anc_idx_);
  fill_in(both, nv, fill_ptr_, fill_idx_);
  structure = {nv, anc_ptr_.data(), anc_idx_.data(), fill_ptr_.data(), fill_idx_.data(), dof_ptr_.data(), dof_.data(), sign_.data()};
}

}  // namespace cmbrl
