// The point of a rim (a circle about its centre, across the vector `axis` as long as its radius R) that is nearest to a plane
// with unit normal n, and how it moves as the rim turns: centre - arm, where
//   arm = R g(q) down,   down = n - (n.a) a,   a = axis / R,   q = |down|^2, the squared sine of the tilt.
// With g = 1 / sqrt(q) that is the lowest point. As the disc comes to lie flat, that point is any and leaps; below a tilt of
// kFlat, g is the parabola in q that goes on with equal value and slope, and the point runs to the centre of the disc.
#pragma once
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr double kFlat = 1e-3;  // [rad]; cmbrl.scene.kinematics has it too

template <class V>
struct Rim {
  V axis, n, down;
  T RR, g, dg;

  Rim(const V& axis_, const V& n_) : axis(axis_), n(n_), RR(dot(axis_, axis_)) {
    down = n - (dot(n, axis) / RR) * axis;
    T q = dot(down, down), steep = vmax(q, splat(kFlat * kFlat)), root = 1.0 / vsqrt(steep);
    Mask tilted = q >= kFlat * kFlat;
    g = select(tilted, root, (0.5 / kFlat) * (3.0 - q * (1 / (kFlat * kFlat))));
    dg = select(tilted, -0.5 * root / steep, splat(-0.5 / (kFlat * kFlat * kFlat)));
  }
  V arm() const { return (vsqrt(RR) * g) * down; }
  V arm_shift(const V& daxis) const {  // of a turn that moves the axis by daxis
    V ddown = (-1.0 / RR) * (dot(n, daxis) * axis + dot(n, axis) * daxis);
    return vsqrt(RR) * (2.0 * dot(down, ddown) * dg * down + g * ddown);
  }
};

}  // namespace cmbrl::CMBRL_ISA
