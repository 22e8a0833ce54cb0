// A pack takes the time of the lane with the most rows. Where some have many more than the others, as of feet that are in the
// floor among others in the air, they are set aside, and stepped in packs of their kind.
#pragma once
#include "step/flight.hpp"

namespace cmbrl::CMBRL_ISA {

// How many rows take as long as the rest of a step.
constexpr double kRestOfStep = 16;

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
  double elsewhere = 0, best = 0.8 * (kRestOfStep + most[0]), limit = most[0];
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

// Takes lanes out of a step that is set up, and rows that no other lane has.
template <class G>
static void drop_lanes(Work<G>& w, Mask lanes) {
  int kept = 0, groups = 0;
  for (int g = 0; g < w.ngroups; ++g) {
    ActiveGroup group{w.groups[g].group, kept, kept};
    for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
      Contact<G>& c = w.con[i];
      c.on &= ~lanes;
      c.wide &= ~lanes;
      if (!any(c.on | c.wide)) continue;
      if (kept != i) std::memcpy(static_cast<void*>(w.con + kept), &c, sizeof c);
      ++kept;
    }
    group.end = kept;
    if (group.end > group.begin) w.groups[groups++] = group;
  }
  w.ncon = kept;
  w.ngroups = groups;
  for (int i = 0; i < w.nleft; ++i) w.left[i].lanes &= ~lanes;
  for (int i = 0; i < w.nlim; ++i) { w.lim[i].on &= ~lanes; w.lim[i].wide &= ~lanes; }
  for (int i = 0; i < w.nleft_lim; ++i) w.left_lim[i].lanes &= ~lanes;
  for (int i = 0; i < w.ndry; ++i) w.dry[i].on &= ~lanes;
}

// Sets up a step, and takes the lanes that it returns out of it.
template <class G>
static Mask set_up_uncrowded(const Model& m, const Options& o, Work<G>& w, T& rows) {
  set_up_step(m, o, w);
  rows = rows_of_lanes(w);
  Mask aside = crowded(rows);
  if (any(aside)) drop_lanes(w, aside);
  return aside;
}

}  // namespace cmbrl::CMBRL_ISA
