// Stages of a Runge-Kutta step of fourth order (rk4.hpp): when in the step each is, and what it counts.
#pragma once

namespace cmbrl {

constexpr int kStages = 4;
constexpr double kStageAt[kStages] = {0, 0.5, 0.5, 1}, kStageWeight[kStages] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};

}  // namespace cmbrl
