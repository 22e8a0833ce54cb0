// The point of an ellipsoid that is nearest to a plane with unit normal n, and how it moves as the ellipsoid turns: centre - arm,
//   arm = S n / sqrt(n.S n),   S = sum of r_k^2 e_k e_k^T over its half axes r_k along e_k.
// A scene has S in the frame of the body, in place of the frame of a box; in a plane of motion that of its outline.
#pragma once
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G>
struct Oval {
  using V = typename G::V;
  const T* S;  // D x D, in the world
  V n, Sn;
  T height;    // of the centre over the point

  Oval(const T* S_, const V& n_) : S(S_), n(n_), Sn(times(n_)) { height = vsqrt(dot(n, Sn)); }
  V times(const V& x) const {
    V y;
    CMBRL_FOR(r, G::D) {
      y[r] = S[r * G::D] * x[0];
      for (int c = 1; c < G::D; ++c) y[r] += S[r * G::D + c] * x[c];
    }
    return y;
  }
  V arm() const { return (1.0 / height) * Sn; }
  V arm_shift(const typename G::Ang& turn) const {  // of a turn of the ellipsoid
    V change = G::turn(turn, Sn) - times(G::turn(turn, n));
    return (1.0 / height) * (change - (0.5 * dot(n, change) / (height * height)) * Sn);
  }
};

// S of candidate i in the world.
template <class G>
static void oval_matrix(const Model& m, const Work<G>& w, int i, T* S) {
  int A = m.con_bodyA[i];
  typename G::V half[G::D];  // columns of R S, of the body's frame
  CMBRL_FOR(c, G::D) {
    typename G::V x;
    CMBRL_FOR(r, G::D) x[r] = splat(m.con_rotA[(i * G::D + r) * G::D + c]);
    half[c] = G::rotate(w.R[A], x);
  }
  CMBRL_FOR(r, G::D) {
    typename G::V row;
    CMBRL_FOR(c, G::D) row[c] = half[c][r];
    row = G::rotate(w.R[A], row);
    CMBRL_FOR(c, G::D) S[r * G::D + c] = row[c];
  }
}

}  // namespace cmbrl::CMBRL_ISA
