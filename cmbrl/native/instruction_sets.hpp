// Which copies of the hot code there are, and which of them this processor runs best.
#pragma once
#include <string>

#include "scene/call.hpp"
#include "nets/net_backend.hpp"
#include "solver/problem_batch.hpp"

namespace cmbrl {

struct InstructionSet {
  const Backend &steps, &few_steps;  // few: as many as a narrower pack holds, whose arrays lie nearer to the processor
  const ProblemBackend &problems, &few_problems;
  const NetBackend& nets;
};

const InstructionSet& find_isa(const std::string& name);  // empty: the best; throws std::invalid_argument

}  // namespace cmbrl
