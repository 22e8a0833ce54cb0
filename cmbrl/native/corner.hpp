// The corner of a box against another box. Boxes of one size in a stack meet corner on corner, where the nearest side of B to a
// single corner says nothing; so both boxes choose: B's side that lies farthest outside all of A, or is least inside of it.
#pragma once
#include "workspace.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr double kBeside = 1e-6;  // m, how far beside the side a corner still touches it
constexpr double kAway = 1e3;     // m, the gap of a corner that is not over the side

// rel: the corner from B's centre; offset: from A's centre; axisA, axisB: unit, of both boxes. Returns the signed distance, the
// normal, and 1 for B's axes along its side.
template <int D>
static T corner_on_side(const Vec<D>& rel, const Vec<D>& offset, const Vec<D>* axisA, const Vec<D>* axisB, const double* halfB,
                        Vec<D>& normal, T* along) {
  Vec<D> centre = rel - offset;
  T place[D], apart[D];
  T best = splat(-1e300);
  CMBRL_FOR(k, D) {
    T extent = T{};
    CMBRL_FOR(j, D) extent += vabs(dot(axisB[k], axisA[j]) * dot(axisA[j], offset));
    place[k] = dot(axisB[k], rel);
    apart[k] = vabs(dot(axisB[k], centre)) - halfB[k] - extent;
    best = vmax(best, apart[k]);
  }
  Mask rest = all();
  T distance = T{};
  Mask beside = none();
  CMBRL_FOR(k, D) {
    Mask chosen = rest & (apart[k] == best);
    T side = select(dot(axisB[k], centre) < 0.0, splat(-1), splat(1));
    distance = select(chosen, side * place[k] - halfB[k], distance);
    CMBRL_FOR(x, D) normal[x] = select(chosen, side * axisB[k][x], normal[x]);
    along[k] = select(chosen, T{}, splat(1));
    rest &= ~chosen;
    beside |= ~chosen & (vabs(place[k]) > halfB[k] + kBeside);
  }
  return distance + select(beside, splat(kAway), T{});
}

}  // namespace cmbrl::CMBRL_ISA
