// What candidates of one pair of geoms have in common, found once for all of them: how far each is away at least, with less than a
// tenth of the work of its closest features. Only what is near is looked at closely (candidates.hpp).
#pragma once
#include "contact.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr int kFew = 3;        // candidates that are as quickly looked at
constexpr double kTie = 1e-9;  // m, within which another side of a box may be the one that a corner is over, by round-off

// A frame on B as that of A's body sees it: coordinate k of a point x is base[k] + up[k] x.
template <class G>
struct FrameInA {
  typename G::V up[G::D];
  T base[G::D];

  // centre and axes, the k-th with entries axes[k + r D] if `columns`, in the frame of B's body
  FrameInA(const Work<G>& w, int A, int B, const double* centre, const double* axes, bool columns) {
    constexpr int D = G::D;
    typename G::V x = load<D>(centre), apart = (A >= 0 ? w.pos[A] : zero<D>() - w.O) - (B >= 0 ? w.pos[B] + G::rotate(w.R[B], x) : x - w.O);
    CMBRL_FOR(k, D) {
      double e[D];
      CMBRL_FOR(r, D) e[r] = columns ? axes[r * D + k] : axes[k * D + r];
      typename G::V axis = B >= 0 ? G::rotate(w.R[B], load<D>(e)) : load<D>(e);
      up[k] = A >= 0 ? G::unrotate(w.R[A], axis) : axis;
      base[k] = dot(axis, apart);
    }
  }
};

// Segments, points and boxes of A and B lie in boxes along the axes of the one around all of B's.
template <class G>
struct AlongBox : FrameInA<G> {
  AlongBox(const Model& m, const Work<G>& w, int cluster, int i)
      : FrameInA<G>(w, m.con_bodyA[i], m.con_bodyB[i], m.cluster_boxB + cluster * (2 + G::D) * G::D, m.cluster_boxB + (cluster * (2 + G::D) + 1) * G::D, false) {}
  // Candidate i's distance is at least this.
  T distance(const Model& m, int i) const {
    constexpr int D = G::D;
    typename G::V x = load<D>(m.con_posA + i * D), axis = load<D>(m.con_axisA + i * D);
    const double* b = m.con_extentB + i * 2 * D;
    T most = splat(-1e300);
    CMBRL_FOR(k, D) most = vmax(most, vabs(this->base[k] + dot(this->up[k], x) - b[k]) - vabs(dot(this->up[k], axis)) - b[D + k]);
    return most;
  }
};

// Corners of A's box are all over the same side of B's, that which lies farthest outside all of A (corner.hpp).
template <class G>
struct CornersOverSide : FrameInA<G> {
  using FrameInA<G>::up, FrameInA<G>::base;
  const double* half;
  T side[G::D];
  Mask over[G::D];

  CornersOverSide(const Model& m, const Work<G>& w, int i)
      : FrameInA<G>(w, m.con_bodyA[i], m.con_bodyB[i], m.con_posB + i * G::D, m.con_rotB + i * G::D * G::D, true), half(m.con_halfB + i * G::D) {
    constexpr int D = G::D;
    typename G::V offset = load<D>(m.con_axisA + i * D), x = load<D>(m.con_posA + i * D) - offset;
    T apart[D], best = splat(-1e300);
    CMBRL_FOR(k, D) {
      T extent = T{}, centre = base[k] + dot(up[k], x);
      CMBRL_FOR(j, D) {
        double e[D];
        CMBRL_FOR(r, D) e[r] = m.con_rotA[i * D * D + r * D + j];
        typename G::V of_a = load<D>(e);
        extent += vabs(dot(up[k], of_a) * dot(of_a, offset));
      }
      apart[k] = vabs(centre) - half[k] - extent;
      best = vmax(best, apart[k]);
      side[k] = select(centre < 0.0, splat(-1), splat(1));
    }
    CMBRL_FOR(k, D) over[k] = apart[k] >= best - kTie;
  }
  // Candidate i's distance is at least this.
  T distance(const Model& m, int i) const {
    constexpr int D = G::D;
    typename G::V x = load<D>(m.con_posA + i * D);
    T place[D], least = splat(1e300);
    Mask beyond[D];
    CMBRL_FOR(k, D) {
      place[k] = base[k] + dot(up[k], x);
      beyond[k] = vabs(place[k]) > half[k] + kBeside + kTie;
    }
    CMBRL_FOR(k, D) {
      Mask beside = none();
      CMBRL_FOR(j, D) if (j != k) beside |= beyond[j];
      T d = side[k] * place[k] - half[k] + keep(beside, splat(kAway));
      least = vmin(least, select(over[k], d, least));
    }
    return least;
  }
};

}  // namespace cmbrl::CMBRL_ISA
