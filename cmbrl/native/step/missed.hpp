// Rows that were left out of a solve, under the velocity that it ended with: where one closes after all, the lane is stepped
// again with more rows.
#pragma once
#include "step/crowded.hpp"

namespace cmbrl::CMBRL_ISA {

// Lanes in which a row that was left out separates slower than a third of the speed it was expected to have.
template <class G>
static Mask missed_rows(const Model& m, const Options& o, Work<G>& w) {
  if (!(o.prune < 1e300)) return none();
  twists_under(m, w, w.vn, w.tn);
  Mask missed = passed_over(m, o, w);
  for (int i = 0; i < w.nleft; ++i) {
    const LeftOut<G>& c = w.left[i];
    Vec<G::N> t = c.A >= 0 ? w.tn[c.A] : zero<G::N>();
    if (c.B >= 0) t -= w.tn[c.B];
    missed |= c.lanes & (c.base + dot(c.W, t) < c.speed / 3);
  }
  for (int i = 0; i < w.nleft_lim; ++i) {
    const LeftOutLimit& l = w.left_lim[i];
    missed |= l.lanes & (l.base + along(m, w, l.way, w.vn) < l.speed / 3);
  }
  return missed;
}

// Solves a step that is set up; where rows that were left out close, again with those that close under the velocity found: at
// once, if that is so in so many lanes that packs of their own would take longer.
template <class G>
static Outcome solve_with_missed(const Model& m, const Options& o, Work<G>& w, Mask aside, Mask& missed) {
  Outcome out = solve_smoothed(m, o, w, o.forward, false);
  missed = missed_rows(m, o, w) & ~aside;
  bool admit = o.admit || count_of(missed) >= W / 2;
  while (admit && any(missed) && w.nguess < kGuesses) {
    std::memcpy(w.guess + w.nguess * m.nv, w.vn, m.nv * sizeof(T));
    std::memcpy(w.guess_twist + w.nguess * m.nbody, w.tn, m.nbody * sizeof *w.tn);
    ++w.nguess;
    for (int i = 0; w.leapt && i < m.nq; ++i) w.q[i] = w.began[i];
    set_up_step(m, o, w);
    if (any(aside)) drop_lanes(w, aside);
    Outcome more = solve_smoothed(m, o, w, o.forward, false);
    out = {more.done, more.rung, out.iterations + more.iterations, more.residual};
    missed = missed_rows(m, o, w) & ~aside;
  }
  return out;
}

}  // namespace cmbrl::CMBRL_ISA
