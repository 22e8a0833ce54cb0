// Contact problems for one instruction set and width (CMBRL_ISA, CMBRL_WIDTH). Compiled twice per set: in the width of its
// registers, and two lanes wide for a problem alone, whose data then stay in the first cache.
#include "problems.hpp"

namespace cmbrl::CMBRL_ISA {

extern const ProblemBackend problem_backend;
const ProblemBackend problem_backend = {
    W,
    [](const ProblemBatch& b) { return b.tangents == 1 ? problem_bytes<Rows<1>>(b) : problem_bytes<Rows<2>>(b); },
    [](const Structure& m, const ProblemBatch& b, int64_t begin, int64_t end, void* work) {
      b.tangents == 1 ? solve_problems<Rows<1>>(m, b, begin, end, work) : solve_problems<Rows<2>>(m, b, begin, end, work);
    },
};

}  // namespace cmbrl::CMBRL_ISA
