// Contact problems on their own, given by arrays: what the caller passes in, and which of their entries can be non-zero.
#pragma once
#include <cstdint>
#include <vector>

#include "scene/call.hpp"

namespace cmbrl {

struct ProblemBatch {  // C arrays, first axis n; null where an output is not wanted
  int64_t n;
  int nv, contacts, tangents;
  const double *M, *J, *v_free, *b, *mu, *R;  // (nv, nv), (contacts, 1 + tangents, nv), (nv), (contacts, 1 + tangents), (contacts), as b
  const double* kappa;  // (n) [J]; null: the exact law
  double tolerance;     // exact law: on the natural map, relative to |M v_free| / contacts
  const double* convex;  // (contacts): 1 where a contact slides by the convex law (newton.hpp); null: nowhere
  double *v, *impulse, *residual, *derivative;  // (nv), (contacts, 1 + tangents), (), dv'/dv_free (nv, nv)
  int32_t *status, *iterations;
};

// Union of the non-zeros of problems of a batch, in the order of elimination of a tree: from the last dof to the first.
class ProblemStructure {
 public:
  const Structure& of(const ProblemBatch& b, int64_t begin, int64_t end);  // stands until the next call

 private:
  Structure structure_{};
  std::vector<uint64_t> bits_;
  std::vector<int> mass_ptr_, mass_idx_, fill_ptr_, fill_idx_, dof_ptr_, dof_, sign_;
};

// One per instruction set and width.
struct ProblemBackend {
  int width;
  int64_t (*workspace_size)(const ProblemBatch&);  // bytes
  void (*solve)(const Structure&, const ProblemBatch&, int64_t begin, int64_t end, void* work);  // up to width of them
};

}  // namespace cmbrl
