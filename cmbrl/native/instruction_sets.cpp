#include "instruction_sets.hpp"

#include <stdexcept>

namespace cmbrl {

#define CMBRL_DECLARE(isa)                                                                      \
  namespace isa { extern const Backend backend; extern const ProblemBackend problem_backend; } \
  namespace isa##_pair { extern const ProblemBackend problem_backend; }
#define CMBRL_ENTRY(isa) {isa::backend, isa::problem_backend, isa##_pair::problem_backend}

#if defined(__x86_64__)
CMBRL_DECLARE(sse2)
CMBRL_DECLARE(avx2)
CMBRL_DECLARE(avx512)
const InstructionSet& find_isa(const std::string& name) {
  static const InstructionSet sets[] = {CMBRL_ENTRY(sse2), CMBRL_ENTRY(avx2), CMBRL_ENTRY(avx512)};
  __builtin_cpu_init();
  bool avx512 = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
  bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  int best = avx512 ? 2 : avx2 ? 1 : 0;
  for (int k = best; k >= 0; --k)
    if (name.empty() || name == sets[k].steps.name) return sets[k];
  throw std::invalid_argument("unknown instruction set, or one that this processor lacks; known: sse2, avx2, avx512");
}
#else
CMBRL_DECLARE(generic)
const InstructionSet& find_isa(const std::string&) {
  static const InstructionSet set = CMBRL_ENTRY(generic);
  return set;
}
#endif

}  // namespace cmbrl
