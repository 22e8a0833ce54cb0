// Batches of contact problems that come as arrays: the step's own contact solve on rows without bodies behind them.
#pragma once
#include "solver/problem_pack.hpp"
#include "solver/proximal.hpp"

namespace cmbrl::CMBRL_ISA {

// The softened law: every product equals kappa.
template <class G>
static void solve_on_path(ProblemPack<G>& pack, Options& o, T* X) {
  SolverWork<G>& w = pack.w;
  o.tolerance = 1e-9;
  o.theta = 1e-6;
  T kappa = pack.at(pack.b.kappa, 1, 0) / (pack.mass * pack.speed * pack.speed);
  for (int i = 0; i < w.ncon; ++i) w.con[i].kappa = kappa;
  Outcome out = contact_solve(pack.m, o, w);
  int status[W];
  for (int lane = 0; lane < W; ++lane) status[lane] = !out.done[lane] ? 2 : out.rung[lane] >= kSofter ? 1 : 0;
  pack.store(all(), out.residual, status, out.iterations);
  if (!pack.b.derivative) return;
  InteriorPoint<G> ip(pack.m, o, w);
  ip.rho = splat(1);
  ip.linearise_all(T{}, none());
  ip.factorise();
  pack.store_derivative(all(), X);
}

// The exact law: Newton on the law itself, from rest, which finds many answers in a few steps (after 8 instead of 5 a stack of
// 1 : 1e6 passes the natural map, but sinks in); else proximal points from low down on the path, which also tell how redundant
// contacts share their load (without them 26 of the 142 problems of the solver study are lost). The natural map decides; what it does
// not pass is flagged. Kappas ten times as large or as small solve the same 141.
template <class G>
static void solve_exactly(ProblemPack<G>& pack, Options& o, T* X) {
  SolverWork<G>& w = pack.w;
  o.tolerance = 1e-8;
  o.theta = 0.1;
  Mask open = all();
  T iterations = T{}, natural = splat(__builtin_inf());
  int solved[W] = {}, failed[W];
  for (int& f : failed) f = 2;
  ProximalPoints<G> polish(pack.m, o, w);
  auto finish = [&](Mask now) {  // lanes that are solved
    pack.store(now, natural / pack.scale, solved, iterations);
    if (pack.b.derivative) {
      polish.linearise_exact(1e-8);
      pack.store_derivative(now, X);
    }
    open &= ~now;
  };
  auto set_kappa = [&](double kappa) {
    for (int i = 0; i < w.ncon; ++i) w.con[i].kappa = splat(kappa);
  };
  polish.rest();
  finish(polish.run(open, pack.scale, pack.b.tolerance, 5, natural, iterations));
  if (!any(open)) return;
  set_kappa(1e-8);
  T used = contact_solve(pack.m, o, w).iterations;
  iterations += keep(open, used);
  for (int i = 0; i < w.ncon; ++i) pack.load_compliance(w.con[i], pack.mass);
  set_kappa(1e-11);
  for_solver_state(pack.m, w, w.save, [](T& x, T& kept) { kept = x; });
  InteriorPoint<G> path(pack.m, o, w);
  Mask there = resume(pack.m, w, path, open, iterations);
  for_solver_state(pack.m, w, w.save, [there](T& x, T& kept) { x = select(there, x, kept); });
  finish(polish.approach(open, pack.scale, pack.b.tolerance, 120, natural, iterations));
  if (!any(open)) return;
  pack.store(open, natural / pack.scale, failed, iterations);
  if (!pack.b.derivative) return;
  polish.linearise_exact(1e-8);
  pack.store_derivative(open, X);
}

template <class G>
static T* open_problems(const ProblemBatch& b, Arena& arena, SolverWork<G>& w) {  // returns room for the derivative
  int64_t nv = b.nv, n = b.contacts, dense = nv * nv;  // a packed matrix is at most as large as a full one
  w.take(arena, nv, dense, n * nv, nv, 0, 0);
  w.take_contacts(arena, n);
  w.take_factor(arena, nv, nv * (nv - 1) / 2);
  w.take_state(arena, nv, n, 0, 0);
  return arena.template take<T>(dense);
}
template <class G>
static int64_t problem_bytes(const ProblemBatch& b) {
  Arena arena{nullptr};
  SolverWork<G> probe;
  open_problems(b, arena, probe);
  return arena.used;
}

template <class G>
static void solve_problems(const Structure& m, const ProblemBatch& b, int64_t begin, int64_t end, void* memory) {
  Arena arena{static_cast<char*>(memory)};
  SolverWork<G> w;
  T* X = open_problems(b, arena, w);
  Options o{};
  o.max_iterations = 40;
  o.rungs = ~0u;
  o.convex = b.convex != nullptr;
  ProblemPack<G> pack{m, b, w, lanes_from(begin, end), {}, {}, {}};
  pack.load();
  pack.weigh();
  pack.normalise();
  if (b.kappa) solve_on_path(pack, o, X);
  else solve_exactly(pack, o, X);
}

}  // namespace cmbrl::CMBRL_ISA
