// Drag and lift of an ellipsoid that moves in a fluid, as MuJoCo computes them for geoms with fluidshape="ellipsoid": added
// mass, blunt, slender and angular drag, viscous resistance, Magnus and Kutta lift (MuJoCo documentation, "Fluid forces").
#pragma once
#include "base/jet.hpp"

namespace cmbrl::CMBRL_ISA {

// Constants of an ellipsoid, per density or viscosity, in the order of scene/forces/fluid_ellipsoids.py.
struct EllipsoidInFluid {
  double mass[3], inertia[3];  // added by the fluid
  double viscous_force, viscous_torque, blunt, slender, kutta, magnus, turning[3];
  double section[3], area;     // squares of the products of the other two semiaxes, largest section
};
constexpr int kEllipsoidNumbers = sizeof(EllipsoidInFluid) / sizeof(double);

struct Fluid { T density, viscosity; };  // forces are linear in them

template <class S>
static inline void cross_into(const S* a, const S* b, S* y) {
  for (int i = 0; i < 3; ++i) y[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

// f (torque, force) along the axes, of the velocities x about and along them. S: a pack, or a jet of packs.
template <class S>
static void ellipsoid_wrench(const EllipsoidInFluid& e, const Fluid& fluid, const S* x, S* f) {
  constexpr double tiny = 1e-15;  // MuJoCo's smallest divisor
  constexpr double pi = 3.14159265358979323846;
  const S *w = x, *v = x + 3;
  auto weighted = [](const double* k, const S* a, S* y) { for (int i = 0; i < 3; ++i) y[i] = k[i] * a[i]; };
  auto square = [](const S* a, const S* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; };
  S momentum[3], spin[3], normal[3], turning[3], a[3], b[3];
  weighted(e.mass, v, momentum);
  weighted(e.inertia, w, spin);
  weighted(e.section, v, normal);  // of the section across the velocity
  weighted(e.turning, w, turning);
  S speed = root(square(v, v)), across = square(normal, v), normal2 = square(normal, normal);
  S section = pi * root(normal2 * inverse(at_least(across, tiny)));
  S lift = e.kutta * (section * across * inverse(at_least(speed * normal2, tiny)));
  S drag = speed * (e.slender * e.area + (e.blunt - e.slender) * section);
  S resistance = root(square(turning, turning));
  cross_into(momentum, v, a);
  cross_into(spin, w, b);
  for (int i = 0; i < 3; ++i) f[i] = a[i] + b[i] - resistance * w[i];
  cross_into(momentum, w, a);
  cross_into(w, v, b);
  for (int i = 0; i < 3; ++i) f[3 + i] = a[i] + e.magnus * b[i] - drag * v[i];
  cross_into(normal, v, a);
  cross_into(a, v, b);
  for (int i = 0; i < 3; ++i) {
    f[i] = fluid.density * f[i] - (fluid.viscosity * e.viscous_torque) * w[i];
    f[3 + i] = fluid.density * (f[3 + i] + lift * b[i]) - (fluid.viscosity * e.viscous_force) * v[i];
  }
}

}  // namespace cmbrl::CMBRL_ISA
