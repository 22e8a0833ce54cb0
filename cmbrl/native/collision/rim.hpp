// The point of a rim (a circle about its centre, across the vector `axis` as long as its radius R) that is nearest to a plane
// with unit normal n, and how it moves as the rim turns: centre - arm, where
//   arm = R g(q) down,   down = n - (n.a) a,   a = axis / R,   q = |down|^2, the squared sine of the tilt.
// With g = 1 / sqrt(q) that is the lowest point. As the disc comes to lie flat, that point is any and leaps; below a tilt of
// kFlat, g is the parabola in q that goes on with equal value and slope, and the point runs to the centre of the disc.
#pragma once
#include "collision/corner.hpp"

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

// MuJoCo's points of a disc over a plane: the lowest of its circle, or the x axis of its frame where it lies flat, and those that
// `along` (cosine and sine) of candidate i turns from there, about the disc's axis, which points out of the cylinder. Where it is
// all but flat, they turn with it. The end that lies higher has the lowest one only.
template <class G>
struct Disc {
  using V = typename G::V;
  static constexpr double kExactlyFlat = 1e-30, kSteady = 1e-12;  // squared sines of the tilt
  V axis, n, across;  // axis: of unit length; across: from the lowest point to the centre, the same
  T radius, q;
  double cosine, sine;

  Disc(const Model& m, const Work<G>& w, int i, const V& arm, const V& n_) : n(n_), radius(vsqrt(dot(arm, arm))) {
    axis = (1.0 / radius) * arm;
    cosine = m.con_along[3 * i]; sine = m.con_along[3 * i + 1];
    V down = n - dot(n, axis) * axis, x;
    q = dot(down, down);
    CMBRL_FOR(r, G::D) x[r] = splat(-m.con_rotA[(i * G::D + r) * G::D]);
    x = G::rotate(w.R[m.con_bodyA[i]], x);
    Mask tilted = q >= kExactlyFlat;
    T scale = 1.0 / vsqrt(vmax(q, splat(kExactlyFlat)));
    CMBRL_FOR(r, G::D) across[r] = select(tilted, scale * down[r], x[r]);
  }
  V turned(const V& about, const V& x) const {
    if constexpr (G::D == 3) return cross(about, x);
    else return zero<G::D>();  // no scene in a plane has such a disc
  }
  T missing() const { return sine != 0 ? keep(dot(n, axis) > 0.0, splat(kAway)) : T{}; }
  V arm() const { return radius * (cosine * across + sine * turned(axis, across)); }
  V arm_shift(const typename G::Ang& turn) const {  // of a turn of the body
    V daxis = G::turn(turn, axis), steady = G::turn(turn, across), dacross;
    V ddown = zero<G::D>() - dot(n, daxis) * axis - dot(n, axis) * daxis;
    T scale = 1.0 / vsqrt(vmax(q, splat(kSteady))), along = dot(across, ddown);
    CMBRL_FOR(r, G::D) dacross[r] = select(q >= kSteady, scale * (ddown[r] - along * across[r]), steady[r]);
    return radius * (cosine * dacross + sine * (turned(daxis, across) + turned(axis, dacross)));
  }
};

}  // namespace cmbrl::CMBRL_ISA
