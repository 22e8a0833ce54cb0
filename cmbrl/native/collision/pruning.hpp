// Which rows are left out of the solve: those that are predicted to separate fast. The velocity that it ends with is the judge
// (missed.hpp).
#pragma once
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

// How fast [m/s] a row of inverse weight w separates to be left out: its impulse kappa / speed moves bodies by 1e-4 m/s at most.
static inline double speed_that_matters(const Options& o, const Smoothing& s, double weight) {
  double kappa = s.mode == kConstant || s.mode == kNearest ? weight * s.kappa : 0;
  double reach = s.mode == kGaussian ? 6 * s.length / o.h : 0;  // beyond six deviations kappa is at its floor
  return __builtin_fmax(__builtin_fmax(o.prune, reach), 1e4 * __builtin_fmax(s.floor, kappa));
}

}  // namespace cmbrl::CMBRL_ISA
