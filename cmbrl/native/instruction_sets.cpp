#include "instruction_sets.hpp"

#include <stdexcept>

namespace cmbrl {

// instruction_sets.inc has a line CMBRL_SET(<name>) for each set that CMake compiles, from the baseline up.
#define CMBRL_SET(isa)                                                                                                       \
  namespace isa { extern const Backend backend; extern const ProblemBackend problem_backend; extern const NetBackend net_backend; } \
  namespace isa##_pair { extern const ProblemBackend problem_backend; }
#include "instruction_sets.inc"
#undef CMBRL_SET

static bool runs_here(const std::string& name) {
#if defined(__x86_64__)
  __builtin_cpu_init();
  if (name == "avx512")
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
  if (name == "avx2") return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
#endif
  return !name.empty();  // a baseline
}

static const Backend* const all_steps[] = {
#define CMBRL_SET(isa) &isa::backend,
#include "instruction_sets.inc"
#undef CMBRL_SET
};

// The best of the narrower sets, or the set itself: a processor that runs a set runs those before it.
static const Backend& narrower(const Backend& steps) {
  const Backend* best = &steps;
  for (const Backend* set : all_steps) {
    if (set == &steps) break;
    if (set->width < steps.width) best = set;
  }
  return *best;
}

const InstructionSet& find_isa(const std::string& name) {
  static const InstructionSet sets[] = {
#define CMBRL_SET(isa) {isa::backend, narrower(isa::backend), isa::problem_backend, isa##_pair::problem_backend, isa::net_backend},
#include "instruction_sets.inc"
#undef CMBRL_SET
  };
  const InstructionSet* best = nullptr;
  std::string known;
  for (const InstructionSet& set : sets) {
    if (!runs_here(set.steps.name)) continue;
    known += (known.empty() ? "" : ", ") + std::string(set.steps.name);
    if (name.empty() || name == set.steps.name) best = &set;
  }
  if (!best) throw std::invalid_argument("instruction set '" + name + "' is not among those of this build that this processor has: " + known);
  return *best;
}

}  // namespace cmbrl
