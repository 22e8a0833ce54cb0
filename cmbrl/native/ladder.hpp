// The contact solve with its fallbacks.
#pragma once
#include "continuation.hpp"
#include "polish.hpp"

namespace cmbrl::CMBRL_ISA {

struct Outcome { Mask done, fallback; T iterations, residual; };

// For small kappa: along the path to t = `until`, Newton on the exact law, and from its solution to kappa.
template <class G>
static Mask through_law(const Structure& m, const Options& o, SolverWork<G>& w, Mask todo, const Strategy& st, double until, T& iterations) {
  Continuation<G> curve(m, o, w);
  todo = curve.trace(todo, st, until, iterations);
  Polish<G> polish(curve);
  T scale = T{}, natural = T{};
  for (int i = 0; i < w.ncon; ++i) scale = vmax(scale, keep(w.con[i].on, w.con[i].gam));
  todo = polish.run(todo, scale, 1e-9, 12, natural, iterations);
  polish.onto_path(todo);
  fresh_residuals(m, w, polish);
  polish.rho = splat(1);
  return polish.descend(todo, st, iterations);
}

// Contact solve at the kappas set in the rows, with the ladder: aggressive, conservative, friction growing from several
// shares of it (where the path of the full friction folds), and the same with slightly compliant contacts.
template <class G>
static Outcome contact_solve(const Structure& m, const Options& o, SolverWork<G>& w) {
  InteriorPoint<G> ip(m, o, w);
  Continuation<G> curve(m, o, w);
  struct Rung { Strategy strategy; double compliance, arclength = 0; bool law = false; };
  static constexpr double tau = 0.9;
  const Rung ladder[] = {{{G::NT == 1 ? 0.95 : 0.9, 0.3, 1, true, false, o.max_iterations}, 0},
                         {{tau, 0.4, 3, false, false, 60}, 0},
                         {{tau, 0.3, 3, false, true, 60, 0.3}, 0},
                         {{tau, 0.3, 3, false, true, 60, 0.1}, 0},
                         {{tau, 0.3, 3, false, true, 60, 0.5}, 0},
                         {{tau, 0.3, 3, false, true, 60, 0.2}, 0},
                         {{tau, 0.3, 3, false, true, 60, 0.7}, 0},
                         {{tau, 0.3, 3, false, true, 120, 0.3, 1.3}, 0},
                         {{tau, 0.3, 3, false, true, 600}, 0, 1e-6},
                         {{tau, 0.3, 3, false, true, 600}, 0, 1e-9},
                         {{tau, 0.3, 30, false, true, 600}, 0, 1e-9},
                         {{tau, 0.3, 3, false, false, 600}, 0, 1e-6, true},
                         {{tau, 0.3, 3, false, false, 600}, 0, 1e-3, true},
                         {{tau, 0.3, 3, false, false, 600}, 0, 1e-9, true},
                         {{tau, 0.3, 3, false, true, 60, 0.3}, 1e-3},
                         {{tau, 0.3, 3, false, true, 150, 0.1, 1.3}, 1e-2}};
  const int rungs = int(sizeof ladder / sizeof *ladder);
  Outcome out{none(), none(), T{}, T{}};
  out.done = ip.run(all(), ladder[0].strategy, out.iterations);
  for (int rung = 1; rung < rungs && any(~out.done); ++rung) {
    Mask before = out.done;
    for_solver_state(m, w, [](T& x, T& kept) { kept = x; });
    bool compliant = ladder[rung].compliance > 0;
    for (int i = 0; compliant && i < w.ncon; ++i) {
      T soft = keep(~before, ladder[rung].compliance * w.con[i].root * w.con[i].root);
      w.con[i].Rn += soft;
      w.con[i].Rt += soft;
    }
    Mask now;
    if (ladder[rung].law) now = through_law(m, o, w, ~before, ladder[rung].strategy, ladder[rung].arclength, out.iterations);
    else if (ladder[rung].arclength > 0) now = curve.run(~before, ladder[rung].strategy, ladder[rung].arclength, out.iterations);
    else now = ip.run(~before, ladder[rung].strategy, out.iterations);
    for_solver_state(m, w, [before](T& x, T& kept) { x = select(before, kept, x); });
    out.done |= now;
    if (compliant) out.fallback |= now;
  }
  out.residual = fresh_residuals(m, w, ip);
  for (int k = 0; k < 10; ++k) {  // Newton steps from fresh residuals where round-off spoilt them: iterative refinement
    Mask todo = out.done & ~((out.residual <= o.tolerance) & (ip.off_path(T{}) <= o.theta));
    if (!any(todo)) break;
    ip.refine(todo, k < 3 ? 0 : 1e-9);
    out.residual = fresh_residuals(m, w, ip);
  }
  out.done &= (out.residual <= 10 * o.tolerance) & (ip.off_path(T{}) <= 10 * o.theta);  // NaN fails
  return out;
}

}  // namespace cmbrl::CMBRL_ISA
