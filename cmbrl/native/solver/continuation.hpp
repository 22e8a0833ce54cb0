// The path as a curve: from the centred start, residuals t r0 and products kappa + t zeta^2 shrink together with t, and where
// the path folds back (large friction), t grows for a while. Pseudo-arclength steps with a bordered Newton corrector
// (Allgower & Georg, Numerical Continuation Methods, 1990, ch. 6-7); lengths in the metric of relative changes.
#pragma once
#include "solver/solver.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G>
struct Continuation : InteriorPoint<G> {
  using Base = InteriorPoint<G>;
  using Base::m, Base::o, Base::w, Base::rho, Base::zeta, Base::count;
  using Base::Base;
  T t, unit_t, length;
  bool begun = false;       // lanes of `arrived` can go on from where they are
  Mask arrived = none();

  // All unknowns with their steps and what a relative change of them is; slot: place in a copy.
  template <class F>
  void for_unknowns(F f) {
    int slot = 0;
    for (int i = 0; i < m.nv; ++i) f(w.delta[i], w.rhs[i], T{}, slot++);
    for (int i = 0; i < w.ncon; ++i) {
      Contact<G>& c = w.con[i];
      f(c.gam, c.dgam, keep(c.on, 1.0 / c.gam), slot++);
      f(c.s, c.ds, keep(c.on, 1.0 / c.s), slot++);
      if (c.rows == 1) continue;
      T head = keep(c.on & c.rub, 1.0 / (c.mu * c.gam)), dual = keep(c.on & c.rub, 1.0 / c.eta0);
      f(c.eta0, c.deta0, dual, slot++);
      CMBRL_FOR(r, c.rows - 1) { f(c.b[r], c.db[r], head, slot++); f(c.eta[r], c.deta[r], dual, slot++); }
    }
    for (int i = 0; i < w.nlim; ++i) {
      Limit& l = w.lim[i];
      f(l.gam, l.dgam, keep(l.on, 1.0 / l.gam), slot++);
      f(l.s, l.ds, keep(l.on, 1.0 / l.s), slot++);
    }
    for (int i = 0; i < w.ndry; ++i) {
      DryFriction& d = w.dry[i];
      f(d.b, d.db, keep(d.on, 1.0 / d.b0), slot++);
      f(d.eta0, d.deta0, keep(d.on, 1.0 / d.eta0), slot++);
      f(d.eta, d.deta, keep(d.on, 1.0 / d.eta0), slot++);
    }
  }

  // Direction of the unknowns for dt = t, from the factor of the current point.
  void tangent() {
    rho = -t;
    T grow = t * zeta * zeta;
    for (int i = 0; i < w.ncon; ++i) {
      Contact<G>& c = w.con[i];
      T b0 = c.mu * c.gam, head = b0 * c.eta0, turn[G::MT] = {};
      CMBRL_FOR(r, c.rows - 1) { head += c.b[r] * c.eta[r]; turn[r] = b0 * c.eta[r] + c.eta0 * c.b[r]; }
      this->linearise(c, c.gam * c.s + grow, head + grow, turn);
    }
    for (int i = 0; i < w.nlim; ++i) this->linearise(w.lim[i], w.lim[i].gam * w.lim[i].s + grow);
    for (int i = 0; i < w.ndry; ++i) {
      DryFriction& d = w.dry[i];
      this->linearise(d, d.b0 * d.eta0 + d.b * d.eta + grow, d.b0 * d.eta + d.eta0 * d.b);
    }
    this->direction();
  }
  T along(const T* unit) {
    T sum = T{};
    for_unknowns([&](T&, T& dx, T scale, int k) { sum += unit[k] * scale * dx; });
    return sum;
  }
  T longest() const {
    T alpha = splat(1e3);
    auto pair = [&](T x, T dx) { alpha = vmin(alpha, Base::orthant(x, dx)); };
    for (int i = 0; i < w.ncon; ++i) {
      const Contact<G>& c = w.con[i];
      pair(c.gam, c.dgam);
      pair(c.s, c.ds);
      if (c.rows == 1) continue;
      with_tangents(c, [&](auto count) {
        constexpr int K = count.value;
        alpha = vmin(alpha, Base::template cone<K>(c.mu * c.gam, c.b, keep(c.on & c.rub, c.mu * c.dgam), c.db));
        alpha = vmin(alpha, Base::template cone<K>(c.eta0, c.eta, c.deta0, c.deta));
      });
    }
    for (int i = 0; i < w.nlim; ++i) { pair(w.lim[i].gam, w.lim[i].dgam); pair(w.lim[i].s, w.lim[i].ds); }
    for (int i = 0; i < w.ndry; ++i) {
      const DryFriction& d = w.dry[i];
      T none[1] = {T{}};
      alpha = vmin(alpha, vmin(Base::template cone<1>(d.b0, &d.b, none[0], &d.db), Base::template cone<1>(d.eta0, &d.eta, d.deta0, &d.deta)));
    }
    return alpha;
  }
  void move(Mask lanes, T alpha, T relative) {  // t changes by relative * alpha of itself
    alpha = vmin(alpha, 0.8 / vmax(-relative, splat(1e-300)));
    this->advance(lanes, alpha);
    t = select(lanes, t * (1.0 + alpha * relative), t);
  }

  // Newton back onto the path within the plane across `unit`; returns the lanes that are on it.
  Mask correct(Mask todo, const T* unit, T unit_t, T* kept) {
    Mask there = none();
    for (int k = 0;; ++k) {
      T centre = t * zeta * zeta;
      there = todo & (this->off_path(centre) < 0.1);  // at 1, cheetah 8 and 9 and two problems of the solver study are lost
      if (k == 4 || !any(todo & ~there)) return there;
      rho = T{};
      this->linearise_all(centre, none());
      this->factorise();
      this->direction();
      T across = along(unit);
      for_unknowns([&](T&, T& dx, T, int i) { kept[i] = dx; });
      tangent();
      T slope = unit_t + along(unit);
      T relative = -across / select(vabs(slope) > 1e-12, slope, splat(1e-12));
      for_unknowns([&](T&, T& dx, T, int i) { dx = kept[i] + relative * dx; });
      move(todo & ~there, vmin(0.9 * longest(), splat(1)), relative);
    }
  }

  // The numbers that follow set how long steps are. At about half or twice their size the stored problems of rungs 8 and 9 are
  // still solved there, but for cheetah 8 with longest steps of 4; and so are one to four of rungs 11 and 12.
  // Lanes of `todo` along the path to t = `until`, or to where kappa dominates; returns those that got there. What has been
  // here before goes on from where it arrived: the way there would be the same again, and so would be its end.
  Mask trace(Mask todo, const Strategy& st, double until, T& iterations) {
    this->start(st.start);  // residuals along the path are shares of these
    int size = m.nv + w.ncon * (3 + 2 * G::MT) + 2 * w.nlim + 3 * w.ndry;
    T *before = w.path, *unit = before + size, *kept = unit + size;  // other solves write into the first of them
    T kappa = this->mean_kappa();
    Mask busy = todo & (count > 0.0);
    if (begun) {
      busy &= arrived;
      for_unknowns([&](T& x, T&, T, int k) { x = select(busy, kept[k], x); });
    } else {
      for (int k = 0; k < size; ++k) unit[k] = T{};
      t = splat(1);
      unit_t = splat(-1);
      length = splat(0.5);
    }
    arrived = none();
    for (int it = 0; it < st.iterations && any(busy); ++it) {
      iterations += select(busy, splat(1), T{});
      this->linearise_all(T{}, none());  // Theta only
      this->factorise();
      tangent();
      T norm = T{}, sense = unit_t + along(unit);
      for_unknowns([&](T&, T& dx, T scale, int) { norm += scale * dx * scale * dx; });
      norm = select(sense < 0.0, splat(-1), splat(1)) / vsqrt(1.0 + norm);
      unit_t = norm;
      for_unknowns([&](T& x, T& dx, T scale, int k) { dx *= norm; unit[k] = scale * dx; before[k] = x; });
      T t_before = t, step = vmin(length, 0.7 * longest());
      busy &= step > 1e-5;  // the edge of a cone turns away from every straight step
      move(busy, step, unit_t);
      Mask there = correct(busy, unit, unit_t, kept), back = busy & ~there;
      for_unknowns([&](T& x, T&, T, int k) { x = select(back, before[k], x); });
      t = select(back, t_before, t);
      length = select(there, vmin(1.6 * length, splat(2)), select(back, 0.3 * step, length));
      arrived |= there & (t <= vmax(splat(until), 0.1 * kappa / (zeta * zeta)));
      busy &= ~arrived & (length > 1e-5) & (t < 1e4);
    }
    begun = true;
    for_unknowns([&](T& x, T&, T, int k) { kept[k] = x; });
    rho = t;
    return arrived;
  }

  // The same, and straight to kappa from there: near its end round-off blurs the direction of the path.
  Mask run(Mask todo, const Strategy& st, double until, T& iterations) {
    return this->descend(trace(todo, st, until, iterations), st, iterations);
  }
};

}  // namespace cmbrl::CMBRL_ISA
