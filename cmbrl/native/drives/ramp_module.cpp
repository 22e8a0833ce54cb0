// cmbrl.native.followed: targets that follow commands at a limited rate. See cmbrl.models.between.ramp, which gives the formulas.
#include <cmath>

#include "base/arrays.hpp"

namespace cmbrl {

// One servo, whose numbers are `stride` apart.
struct Servo {
  int64_t rows, stride;
  const double* command;
  const int64_t* first;
  double *mean, *slope;

  void at_once(double dt) const {
    for (int64_t i = 0; i < rows; ++i) {
      double c = command[i * stride], jump = i == first[i] ? 0 : c - command[(i - 1) * stride];
      mean[i * stride] = c;
      slope[i * stride] = -0.5 * jump * std::fabs(jump) / dt;
    }
  }

  void limited(double dt, double ramp) const {
    double most = dt / ramp, target = 0, by_ramp = 0;  // where a row begins, and its derivative
    for (int64_t i = 0; i < rows; ++i) {
      double c = command[i * stride];
      if (i == first[i]) target = c, by_ramp = 0;
      double gap = c - target, size = std::fabs(gap), sign = std::copysign(1.0, gap);
      bool behind = size > most;
      mean[i * stride] = target + sign * (behind ? 0.5 * most : size - 0.5 * size * size / most);
      slope[i * stride] = behind ? by_ramp - 0.5 * sign * most / ramp : by_ramp * size / most - 0.5 * sign * size * size / dt;
      by_ramp = behind ? by_ramp - sign * most / ramp : 0;
      target = behind ? target + sign * most : c;
    }
  }
};

static nb::tuple followed(const Array& command, const Index& first, double dt, const Array& ramp) {
  check(command, "command", {-1, -1});
  int64_t rows = command.shape(0), servos = command.shape(1);
  check(ramp, "ramp", {servos});
  if (first.ndim() != 1 || int64_t(first.shape(0)) != rows) refuse("first has not one number for each row of command");
  double *mean, *slope;
  size_t n = rows, m = servos;
  auto means = make_array<double>({n, m}, &mean), slopes = make_array<double>({n, m}, &slope);
  for (int64_t k = 0; k < servos; ++k) {
    Servo servo{rows, servos, command.data() + k, first.data(), mean + k, slope + k};
    if (double own = ramp.data()[k]; own > 0) servo.limited(dt, own);
    else servo.at_once(dt);
  }
  return nb::make_tuple(means, slopes);
}

void bind_drives(nb::module_& module) {
  module.def("followed", &followed, nb::arg("command"), nb::arg("first"), nb::arg("dt"), nb::arg("ramp"),
             "Targets (N, nu) in the mean of each row, and their derivatives in each one's own ramp, of commands (N, nu) whose "
             "episodes begin at `first` (N,) int64.");
}

}  // namespace cmbrl
