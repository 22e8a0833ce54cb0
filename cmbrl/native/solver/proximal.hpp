// Newton where the law alone does not say how redundant contacts share their load, or says so by its last digits only:
// proximal points (Rockafellar, SIAM J. Control Optim. 1976). Rows yield by eps / a to the change of their impulse since the
// last point, which is a regular problem for Newton and leaves the solutions of the law where they are; eps follows Newton. How
// it does so decides how many steps are taken, not what is solved: each number may be three times as large or as small.
#pragma once
#include "solver/polish.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G>
struct ProximalPoints : Polish<G> {
  using Polish<G>::m, Polish<G>::w, Polish<G>::Polish;

  // What a proximal point is made of, and the rows' own law, with places in a copy.
  template <class F>
  void for_point(F f) {
    T* kept = w.path;
    for (int i = 0; i < m.nv; ++i) f(w.delta[i], *kept++);
    for (int i = 0; i < w.ncon; ++i) {
      f(w.con[i].gam, *kept++);
      CMBRL_FOR(r, w.con[i].rows - 1) f(w.con[i].b[r], *kept++);
    }
  }
  template <class F>
  void for_law(F f) {
    T* kept = w.path + m.nv + w.ncon * (1 + G::MT);
    for (int i = 0; i < w.ncon; ++i) {
      Contact<G>& c = w.con[i];
      f(c.Rn, *kept++);
      f(c.Rt, *kept++);
      f(c.cn0, *kept++);
      CMBRL_FOR(r, c.rows - 1) f(c.ct0[r], *kept++);
    }
  }

  void anchor(T eps) {
    for (int i = 0; i < w.ncon; ++i) {
      Contact<G>& c = w.con[i];
      T yield = eps * c.root * c.root;
      c.Rn += yield;
      c.Rt += yield;
      c.cn0 -= yield * c.gam;
      CMBRL_FOR(r, c.rows - 1) c.ct0[r] -= yield * c.b[r];
    }
  }

  // From the current point, in some `budget` of Newton steps a lane; returns the lanes of `todo` that got there. Contacts only.
  Mask approach(Mask todo, T scale, double tolerance, int budget, T& natural, T& iterations) {
    Mask done = none();
    T eps = splat(1e-4), lowest = splat(1e-9), spent = T{}, unused = T{};
    this->pull = 0;
    for_law([](T& x, T& kept) { kept = x; });
    for (;;) {
      this->natural_map();  // rows whose law has just changed get their velocities before they are judged
      done |= this->run(todo, scale, tolerance, 0, natural, iterations);
      todo &= ~done & (spent < double(budget));
      if (!any(todo)) break;
      for_point([](T& x, T& kept) { kept = x; });
      anchor(eps);
      T goal = vmax(splat(0.1 * tolerance), 1e-3 * vmin(natural / scale, eps)), steps = T{};
      Mask found = this->run(todo, scale * goal / tolerance, tolerance, 10, unused, steps), back = todo & ~found;
      for_point([back](T& x, T& kept) { x = select(back, kept, x); });
      for_law([](T& x, T& kept) { x = kept; });
      T share = select(found, select(steps <= 3.0, splat(0.1), select(steps <= 5.0, splat(0.3), splat(1))), splat(10));
      lowest = select(found, vmax(0.5 * lowest, splat(1e-9)), 10.0 * eps);  // where round-off stopped Newton, not at once again
      eps = vmin(vmax(share * eps, lowest), splat(0.1));
      spent += vmax(steps, splat(1));
      iterations += steps;
    }
    this->pull = 1e-7;
    return done;
  }
};

}  // namespace cmbrl::CMBRL_ISA
