// How an interior point goes on: the same in all lanes, or in each by the numbers of another rung of the ladder.
#pragma once
#include "base/pack.hpp"

namespace cmbrl::CMBRL_ISA {

// follow: along the path from a large kappa down, centred at each of them, instead of straight to the end, with a share
// `friction` of the coefficients of friction, which then grows back: paths of large friction fold, those of small do not.
// patience: a lane that gets on by a tenth of what is left, or less, in so many iterations has come to a fold. With 20 of them no
// end of 85,000 wild states is another, of which 2,400 climb the ladder; with 15 that of one is, with 8 of eleven.
struct Strategy {
  double tau, sigma, start;
  bool corrector, follow;
  int iterations;
  double friction = 1, growth = 1e3;
  int patience = 20;
};

// Strategies of the lanes: all the same, or those of several rungs of the ladder that lanes of one state try at once. They differ
// in what is a vector here.
struct Course {
  double tau, start;
  bool corrector;
  int patience;
  Mask follow = none();
  T sigma = T{}, friction = T{}, growth = T{}, iterations = T{};

  Course(const Strategy& st) : tau(st.tau), start(st.start), corrector(st.corrector), patience(st.patience) { take(all(), st); }
  void take(Mask lanes, const Strategy& st) {
    follow = (follow & ~lanes) | (st.follow ? lanes : none());
    sigma = select(lanes, splat(st.sigma), sigma);
    friction = select(lanes, splat(st.friction), friction);
    growth = select(lanes, splat(st.growth), growth);
    iterations = select(lanes, splat(st.iterations), iterations);
  }
};

}  // namespace cmbrl::CMBRL_ISA
