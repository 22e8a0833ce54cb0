// Contact problems for one instruction set and width (CMBRL_ISA, CMBRL_WIDTH). Compiled twice per set: in the width of its
// registers, and two lanes wide for a problem alone, whose data then stay in the first cache.
#include "solver/problems.hpp"

namespace cmbrl::CMBRL_ISA {

// f(Rows) for the number of tangents: 1 in the plane, 2 in space, and with rows that turn 2, or 3 and 5.
template <class F>
static auto with_rows(int tangents, F f) {
  return tangents == 1 ? f(Rows<1>{}) : tangents == 2 ? f(Rows<2>{}) : tangents == 3 ? f(Rows<3>{}) : f(Rows<5>{});
}

extern const ProblemBackend problem_backend;
const ProblemBackend problem_backend = {
    W,
    [](const ProblemBatch& b) { return with_rows(b.tangents, [&](auto rows) { return problem_bytes<decltype(rows)>(b); }); },
    [](const Structure& m, const ProblemBatch& b, int64_t begin, int64_t end, void* work) {
      with_rows(b.tangents, [&](auto rows) { solve_problems<decltype(rows)>(m, b, begin, end, work); });
    },
};

}  // namespace cmbrl::CMBRL_ISA
