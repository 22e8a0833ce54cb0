// How a touch of round shapes moves (round_contact.hpp). In the two tangents of its normal n, with A's motion u at the touch and the
// turn w that n has as part of A,
//   dn = N u + M w,   da = P u + R w,
// where a is the touch on A. N is symmetric. The four stand where such a touch has nothing else: N in axisA, M and P in slide, whose last
// number, with axisB, is R.
#pragma once
#include "collision/edges.hpp"

namespace cmbrl::CMBRL_ISA {

// How what is beside a touch of hulls turns with A: as a part of it; that of a cylinder that rolls on a side, across n alone; and where
// the side is A's, along n alone.
constexpr double kLeans = 1, kRolls = 2, kLifts = 3;

// A cylinder that lies on a side touches under its axis, axisB, however it turns about that: what A's turn, so far as it does no more
// than that, moves the touch by. It is the part of it across n, which the axis is nearly.
template <class G>
static typename G::V rolled(const Feature<G>& F, const typename G::Ang& turn) {
  if constexpr (G::D == 3) {
    T tilt = dot(F.axisB, F.n), about = dot(turn, F.axisB) - tilt * dot(turn, F.n);
    return (about / vmax(1.0 - tilt * tilt, splat(0.5))) * cross(F.axisB, F.beside);
  }
  return zero<G::D>();
}

// Adds dn, and makes of u what the touch moves by; in lanes that bend.
template <class G>
static void bend_shift(const Feature<G>& F, const typename G::V& turned, typename G::V& u, typename G::V& dn) {
  if constexpr (G::D == 3) {
    typename G::V t[2];
    tangents(G{}, F.n, t);
    T x[2] = {dot(t[0], u), dot(t[1], u)}, w[2] = {dot(t[0], turned), dot(t[1], turned)};
    const T *N = F.axisA.x, *M = F.slide.x, *P = M + 4, R[4] = {M[8], F.axisB[0], F.axisB[1], F.axisB[2]};
    CMBRL_FOR(i, 2) {
      T turns = N[i] * x[0] + N[i + 1] * x[1] + M[2 * i] * w[0] + M[2 * i + 1] * w[1];
      T moves = P[2 * i] * x[0] + P[2 * i + 1] * x[1] + R[2 * i] * w[0] + R[2 * i + 1] * w[1] - x[i];
      dn += (F.bends * turns) * t[i];
      u += (F.bends * moves) * t[i];
    }
  }
}

}  // namespace cmbrl::CMBRL_ISA
