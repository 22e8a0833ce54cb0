// A pack takes the time of the lane with the most rows. Where some have many more than the others, as of feet that are in the
// floor among others in the air, they are set aside, and stepped in packs of their kind.
#pragma once
#include "flight.hpp"

namespace cmbrl::CMBRL_ISA {

// How many rows take as long as the rest of a step; as setting up twice.
constexpr double kRestOfStep = 16, kSetUp = 4;

template <class G>
static T rows_of_lanes(const Work<G>& w) {
  T rows = T{};
  for (int i = 0; i < w.ncon; ++i) rows += select(w.con[i].on | w.con[i].wide, splat(1), T{});
  return rows;
}

// Lanes to set aside, those with the most rows: as many as saves the most, if that is a fifth at least.
static Mask crowded(T rows) {
  double most[W];
  for (int lane = 0; lane < W; ++lane) {
    int k = lane;
    for (; k > 0 && most[k - 1] < rows[lane]; --k) most[k] = most[k - 1];
    most[k] = rows[lane];
  }
  double elsewhere = kSetUp, best = 0.8 * (kRestOfStep + most[0]), limit = most[0];
  for (int k = 1; k < W; ++k) {
    elsewhere += (kRestOfStep + most[k - 1]) / W;
    double time = kRestOfStep + most[k] + elsewhere;
    if (time < best) { best = time; limit = most[k]; }
  }
  return rows > limit;
}

// The lanes of `from_good` get the state of `good`.
template <class G>
static void copy_state(const Model& m, Mask from_good, int good, Work<G>& w) {
  copy_lane(from_good, good, m.nq, w.q);
  copy_lane(from_good, good, m.nv, w.v);
  copy_lane(from_good, good, m.nu, w.u);
}

// Sets up a step without the lanes that it returns.
template <class G>
static Mask set_up_uncrowded(const Model& m, const Options& o, Work<G>& w, T& rows) {
  set_up_step(m, o, w);
  rows = rows_of_lanes(w);
  Mask aside = crowded(rows);
  if (!any(aside)) return aside;
  for (int i = 0; w.leapt && i < m.nq; ++i) w.q[i] = w.began[i];
  copy_state(m, aside, first_of(~aside), w);
  set_up_step(m, o, w);
  return aside;
}

}  // namespace cmbrl::CMBRL_ISA
