// The contact solve with its fallbacks.
#pragma once
#include "solver/continuation.hpp"
#include "solver/polish.hpp"

namespace cmbrl::CMBRL_ISA {

struct Outcome { Mask done; T rung, iterations, residual; };  // rung: the last one that was climbed

// Rungs; hopeless lanes skip those from kJudged on, but for those from kHopeless on; those from kSofter on are softer than the model.
constexpr int kRungs = 16, kFriction = 2, kJudged = 4, kCurve = 8, kSofter = 10, kHopeless = 12;

template <class G, class F>
static void for_kappa(SolverWork<G>& w, F f) {
  for (int i = 0; i < w.ncon; ++i) f(w.con[i].on, w.con[i].kappa, w.con[i].own_kappa, w.con[i].raised_kappa);
  for (int i = 0; i < w.nlim; ++i) f(w.lim[i].on, w.lim[i].kappa, w.lim[i].own_kappa, w.lim[i].raised_kappa);
}
// Lanes whose rows differ in kappa.
template <class G>
static Mask uneven_kappa(SolverWork<G>& w) {
  T least = splat(1e300), most = T{};
  for_kappa(w, [&](Mask on, T& kappa, T&, T&) { least = vmin(least, select(on, kappa, least)); most = vmax(most, keep(on, kappa)); });
  return least < most;
}
// Rows of `lanes` get the kappa of the softest of them, or more: paths along which all rows soften alike fold less.
template <class G>
static void level_kappa(SolverWork<G>& w, Mask lanes, T most) {
  for_kappa(w, [&](Mask on, T& kappa, T&, T&) { most = vmax(most, keep(on, kappa)); });
  for_kappa(w, [&](Mask, T& kappa, T&, T&) { kappa = select(lanes, most, kappa); });
}
// A kappa that is not the row's own is a constant to the derivative.
template <class G>
static void freeze_raised_kappa(SolverWork<G>& w) {
  auto freeze = [](auto& row) {
    Mask own = row.kappa == row.own_kappa;
    row.slope = keep(own, row.slope);
    row.slope_R = keep(own, row.slope_R);
  };
  for (int i = 0; i < w.ncon; ++i) freeze(w.con[i]);
  for (int i = 0; i < w.nlim; ++i) freeze(w.lim[i]);
}

// From a point of the path on to the kappas that are set now; returns the lanes that got there.
template <class G>
static Mask resume(const Structure& m, SolverWork<G>& w, InteriorPoint<G>& ip, Mask todo, T& iterations) {
  ip.measure(1);
  ip.linear = fresh_residuals(m, w, ip);
  ip.rho = splat(1);
  return ip.descend(todo, Strategy{0.9, 0.3, 1, true, false, 20}, iterations);
}

// Lanes of `found` that hold up against residuals computed afresh; where round-off spoilt them, after Newton steps from there:
// iterative refinement.
template <class G>
static Mask settled(const Structure& m, const Options& o, SolverWork<G>& w, InteriorPoint<G>& ip, Mask found, T& residual) {
  residual = fresh_residuals(m, w, ip);
  for (int k = 0; k < 10; ++k) {  // without, 390 wild hoppers of 4,000 climb instead of 98; hopper 1 needs more than 3
    Mask todo = found & ~((residual <= o.tolerance) & (ip.off_path(T{}) <= o.theta));
    if (!any(todo)) break;
    ip.refine(todo, k < 3 ? 0 : 1e-9);  // hopper 1 needs the yield
    residual = fresh_residuals(m, w, ip);
  }
  return found & (residual <= 10 * o.tolerance) & (ip.off_path(T{}) <= 10 * o.theta);  // NaN fails, and at 1 so does hopper 1
}

// From solutions at raised kappas back to the rows' own, in the lanes of `found`: at once; by halves of the way that is left; or,
// where round-off spoils the path, by Newton steps alone (hopper 1). Returns the lanes that got there; the others stay.
template <class G>
static Mask return_to_own_kappa(const Structure& m, const Options& o, SolverWork<G>& w, InteriorPoint<G>& ip, Mask found, Outcome& out) {
  Mask back = none();
  for_solver_state(m, w, w.path, [](T& x, T& kept) { kept = x; });
  for_kappa(w, [](Mask, T& kappa, T&, T& raised) { raised = kappa; });
  auto forget = [&](Mask lanes) {
    for_solver_state(m, w, w.path, [lanes](T& x, T& kept) { x = select(lanes, kept, x); });
    for_kappa(w, [&](Mask, T& kappa, T&, T& raised) { kappa = select(lanes, raised, kappa); });
  };
  for (int parts : {1, 8, 0}) {
    Mask todo = found & ~back, there = todo;
    for (int k = parts; k > 0 && any(there); --k) {
      for_kappa(w, [&](Mask, T& kappa, T& own, T&) { kappa = select(there, k > 1 ? vsqrt(kappa * own) : own, kappa); });
      there = resume(m, w, ip, there, out.iterations);
    }
    if (!parts) for_kappa(w, [&](Mask, T& kappa, T& own, T&) { kappa = select(there, own, kappa); });
    there = settled(m, o, w, ip, there, out.residual);
    back |= there;
    forget(todo & ~there);
    if (!any(found & ~back)) break;
  }
  return back;
}

// One attempt at the lanes that are still open: the path as a curve, down to `until`. What the model does not
// have: kappa of at least `soften` times the energy of the fastest row; compliance of contacts, by their weight.
struct Rung { Strategy strategy; double until = 0, soften = 0, compliance = 0; };

// How many rungs from k on a pack of copies tries at once, one a lane: of those that differ in numbers only, up to where is judged.
static int rungs_at_once(bool alike, unsigned allowed, int k) {
  int end = k < kFriction ? k : k < kJudged ? kJudged : k < kCurve ? kCurve : k, n = 1;
  while (alike && n < W && k + n < end && allowed >> (k + n) & 1) ++n;
  return n;
}
static Course course_of(const Rung* rung, int many) {
  Course course(rung->strategy);
  for (int lane = 1; lane < many; ++lane) course.take(up_to(lane) & ~up_to(lane - 1), rung[lane].strategy);
  return course;
}
// Of rungs at once, the first that `found` something decides, as if those after it had not been tried: where that `holds`, all
// lanes get it. many: how many of them that makes.
template <class G>
static Mask first_wins(const Structure& m, SolverWork<G>& w, Mask found, Mask holds, int& many) {
  int first = first_of(found);
  if (first < 0) return none();
  many = first + 1;
  if (!holds[first]) return none();
  for_solver_state(m, w, w.path, [first](T& x, T&) { x = splat(x[first]); });
  return all();
}

// Contact solve at the kappas set in the rows. Each rung names a state of tests/native/ladder_problems.json that it solves and
// those before it do not. Lanes that not even a little friction leads through have no solution, most likely: they skip what
// is as hard as the model, and go to the softest kappa and to compliance.
template <class G>
static Outcome contact_solve(const Structure& m, const Options& o, SolverWork<G>& w) {
  w.below.fill(pattern_of(m, w), m.nv, w.dynamic);
  InteriorPoint<G> ip(m, o, w);
  Continuation<G> curve(m, o, w);
  static constexpr double tau = 0.9;
  const Strategy first{G::NT == 1 ? 0.98 : 0.95, 0.3, 1, true, false, o.max_iterations};
  Strategy quick = first;  // one lane that has stuck holds up its pack: it tries again, patiently, in a pack of its kind
  if (o.rungs == 1 && !o.last_attempt) quick.patience = 5;
  const Rung ladder[] = {
      {quick},  // aggressive: all but a few in a hundred
      {first},  // all rows alike in kappa: hopper 1
      {{tau, 0.3, 3, false, true, 60, 0.1}},  // friction grows from a tenth: hopper 2
      {{tau, 0.3, 3, false, true, 60, 0.3}},  // from 0.3 of it, and what is hopeless shows: cheetah 3
      {{tau, 0.4, 3, false, false, 60}},  // cautious, at the full friction: cheetah 4
      {{tau, 0.3, 3, false, true, 60, 0.5}},  // friction grows from a half: cheetah 5
      {{tau, 0.3, 3, false, true, 60, 0.7}},  // from 0.7: cheetah 6
      {{tau, 0.3, 3, false, true, 120, 0.3, 1.3}},  // slowly: cheetah 7
      {{tau, 0.3, 3, false, true, 600}, 1e-6},  // the path as a curve, where it folds back: cheetah 8
      {{tau, 0.3, 3, false, true, 600}, 1e-9},  // further along it, from there on: cheetah 9
      {first, 0, 1e-7},  // softer: g1 10
      {first, 0, 1e-5},  // softer still: cube_toss 11
      {first, 0, 1e-3},  // and more: cube_toss 12
      {{tau, 0.3, 3, false, true, 60, 0.3}, 0, 0, 1e-3},  // compliant, where rows contradict each other: stuck hopper 13
      {{tau, 0.3, 3, false, true, 60, 0.1}, 0, 1e-7, 1e-2},  // more compliant: stuck hopper 14
      {{tau, 0.3, 3, false, true, 60, 0.1}, 0, 1e-3, 1e-1}  // and softer: stuck hopper 15
  };
  static_assert(sizeof ladder / sizeof *ladder == kRungs);
  Outcome out{none(), T{}, T{}, T{}};
  Mask given_up = none();
  bool alike = w.lanes == 1;
  out.done = settled(m, o, w, ip, ip.run(all(), ladder[0].strategy, out.iterations), out.residual);
  if (!any(~out.done)) return out;
  for_kappa(w, [](Mask, T& kappa, T& own, T&) { own = kappa; });
  for (int k = 1, many; k < kRungs; k += many) {
    if (k == kJudged && !o.convex) given_up = alike && any(ip.grown) ? none() : ~ip.grown;
    many = 1;
    if (~o.rungs >> k & 1) continue;
    many = rungs_at_once(alike, o.rungs, k);
    const Rung& rung = ladder[k];
    Mask todo = k < kHopeless ? ~out.done & ~given_up : ~out.done;
    if (k == 1) todo &= uneven_kappa(w);
    if (!any(todo)) continue;
    for_solver_state(m, w, w.save, [](T& x, T& kept) { kept = x; });
    if (k == 1) level_kappa(w, todo, T{});
    if (rung.soften > 0) {
      ip.measure(1);
      level_kappa(w, todo, rung.soften * ip.zeta * ip.zeta);
    }
    for (int i = 0; rung.compliance > 0 && i < w.ncon; ++i) {
      T soft = keep(todo, rung.compliance * w.con[i].root * w.con[i].root);
      w.con[i].Rn += soft;
      w.con[i].Rt += soft;
    }
    Mask found;
    if (rung.until > 0) found = curve.run(todo, rung.strategy, rung.until, out.iterations);
    else found = ip.run(many > 1 ? up_to(many - 1) : todo, course_of(&rung, many), out.iterations);
    Mask now = settled(m, o, w, ip, found, out.residual);
    if (many > 1) now = first_wins(m, w, found, now, many);
    out.rung = select(todo, splat(k + many - 1), out.rung);
    if (k < kSofter && any(now)) {
      Mask softer = now & ~return_to_own_kappa(m, o, w, ip, now, out);
      out.rung = select(softer, splat(kSofter), out.rung);
    }
    for_solver_state(m, w, w.save, [todo](T& x, T& kept) { x = select(todo, x, kept); });
    out.done |= now;
  }
  freeze_raised_kappa(w);
  for (int lane = 1; alike && lane < W; ++lane) out.iterations[0] = __builtin_fmax(out.iterations[0], out.iterations[lane]);
  out.residual = fresh_residuals(m, w, ip);  // of all lanes together
  return out;
}

}  // namespace cmbrl::CMBRL_ISA
