#include "problem_batch.hpp"

#include <algorithm>

namespace cmbrl {

namespace {
// Pattern of the factor below the diagonal: eliminating k couples all dofs that k is coupled to. p: nv x nv, row-major.
void fill_in(uint8_t* p, int nv, std::vector<int>& ptr, std::vector<int>& idx) {
  for (int k = nv - 1; k > 0; --k) {
    const uint8_t* row = p + k * nv;
    for (int a = 1; a < k; ++a)
      if (row[a])
        for (int b = 0; b < a; ++b) p[a * nv + b] |= row[b];
  }
  ptr.reserve(nv + 1);
  ptr.push_back(0);
  for (int k = 0; k < nv; ++k) {
    for (int j = 0; j < k; ++j)
      if (p[k * nv + j]) idx.push_back(j);
    ptr.push_back(int(idx.size()));
  }
}
}  // namespace

ProblemStructure::ProblemStructure(const ProblemBatch& b, int64_t begin, int64_t end) {
  int nv = b.nv, rows = 1 + b.tangents;
  std::vector<uint8_t> pattern(2 * nv * nv + b.contacts * nv, 0);
  uint8_t *mass = pattern.data(), *both = mass + nv * nv, *column = both + nv * nv;
  for (int64_t k = begin; k < end; ++k) {
    const double *M = b.M + k * nv * nv, *J = b.J + k * b.contacts * rows * nv;
    for (int i = 0; i < nv * nv; ++i) mass[i] |= M[i] != 0;
    for (int c = 0; c < b.contacts; ++c)
      for (int r = 0; r < rows; ++r)
        for (int i = 0; i < nv; ++i) column[c * nv + i] |= J[(c * rows + r) * nv + i] != 0;
  }
  std::copy(mass, mass + nv * nv, both);
  dof_.reserve(b.contacts * nv);
  dof_ptr_.reserve(b.contacts + 1);
  dof_ptr_.push_back(0);
  for (int c = 0; c < b.contacts; ++c) {
    for (int i = 0; i < nv; ++i)
      if (column[c * nv + i]) dof_.push_back(i);
    for (int x = dof_ptr_.back(); x < int(dof_.size()); ++x)
      for (int y = dof_ptr_.back(); y < x; ++y) both[dof_[x] * nv + dof_[y]] = 1;
    dof_ptr_.push_back(int(dof_.size()));
  }
  sign_.assign(dof_.size(), 1);
  anc_idx_.reserve(nv * nv / 2);
  fill_idx_.reserve(nv * nv / 2);
  fill_in(mass, nv, anc_ptr_, anc_idx_);
  fill_in(both, nv, fill_ptr_, fill_idx_);
  structure = {nv, anc_ptr_.data(), anc_idx_.data(), {fill_ptr_.data(), fill_idx_.data()}, dof_ptr_.data(), dof_.data(), sign_.data()};
}

}  // namespace cmbrl
