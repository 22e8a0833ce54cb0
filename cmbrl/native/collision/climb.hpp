// The farthest vertex of a convex hull of many: from one that is near, uphill along edges. No vertex but the farthest has none above it,
// since a linear function has no other maximum on a convex set (as Cameron's walks, Proc. IEEE Int. Conf. Robotics and Automation 1997).
#pragma once
#include "scene/model.hpp"

namespace cmbrl::CMBRL_ISA {

// The cell that a direction points to on a cube: along its largest coordinate, by the two that follow.
static inline int cell_of(const double* y) {
  double x[3] = {__builtin_fabs(y[0]), __builtin_fabs(y[1]), __builtin_fabs(y[2])};
  int axis = x[0] >= x[1] ? (x[0] >= x[2] ? 0 : 2) : (x[1] >= x[2] ? 1 : 2), cell = 2 * axis + (y[axis] < 0);
  double scale = 0.5 * Model::climb_side / __builtin_fmax(x[axis], 1e-300);
  for (int k = 1; k < 3; ++k) {
    double at = 0.5 * Model::climb_side + scale * y[(axis + k) % 3];  // may be NaN
    cell = cell * Model::climb_side + (at >= Model::climb_side ? Model::climb_side - 1 : at >= 0 ? int(at) : 0);
  }
  return cell;
}

// Along y, in the frame of the hull's body.
static inline int climb(const Model& m, const int* starts, const double* y) {
  auto height = [&](int k) {
    const double* x = m.hull_point + 3 * k;
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
  };
  int at = starts[cell_of(y)];
  for (double most = height(at);;) {
    int from = at;
    for (int k = m.next_ptr[from]; k < m.next_ptr[from + 1]; ++k)
      if (double along = height(m.vertex_next[k]); along > most) { most = along; at = m.vertex_next[k]; }
    if (at == from) return at;
  }
}

}  // namespace cmbrl::CMBRL_ISA
