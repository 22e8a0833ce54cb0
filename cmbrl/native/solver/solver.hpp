// Interior point for one step: predictor-corrector to a fixed central-path parameter kappa, split form
//   gamma s = kappa,   (mu gamma, beta) o (eta0, eta) = kappa (1, 0)          [Mehrotra 1992; Dojo, arXiv 2203.00806]
// Lanes stop by themselves; masks keep them still.
#pragma once
#include "solver/newton.hpp"
#include "solver/strategy.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G>
struct InteriorPoint : Newton<G> {
  using Newton<G>::m, Newton<G>::o, Newton<G>::w, Newton<G>::rho;
  using Newton<G>::twist, Newton<G>::add_wrench, Newton<G>::linearise_all, Newton<G>::factorise, Newton<G>::direction;
  T zeta, count;
  T speed;   // largest at which anything moves along a row: velocities are known to some 1e-16 of it
  Mask grown = none();  // lanes that a path with little friction has led to its end
  T linear;  // size of the linear residuals at the start, relative to the speeds of the rows; at least 1

  using Newton<G>::Newton;

  // What the rows are like before anything pushes: their speeds, left in r1 and r2, and the size zeta of a centred start.
  void measure(double factor) {
    zeta = speed = count = T{};
    auto widen = [&](Mask on, T c, T free, T kappa, T root) {
      speed = vmax(speed, keep(on, vmax(-c, vabs(free))));
      zeta = vmax(zeta, keep(on, vmax(factor * vabs(c) / root, vsqrt(kappa))));
    };
    for (int g = 0; g < w.ngroups; ++g) {
      Vec<G::N> t = twist(w.groups[g].group, w.vf);
      for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
        Contact<G>& c = w.con[i];
        c.r1 = dot(c.Wr[0], t) + c.cn0;
        widen(c.on, c.r1, c.r1 - c.cn0, c.kappa, c.root);
        for (int r = 1; r < c.rows; ++r) {
          c.r2[r - 1] = dot(c.Wr[r], t) + c.ct0[r - 1];
          widen(c.on, c.r2[r - 1], c.r2[r - 1] - c.ct0[r - 1], c.kappa, c.root);
        }
        count += select(c.on, splat(1), T{}) + select(c.on & c.rub, splat(1), T{});
      }
    }
    for (int i = 0; i < w.nlim; ++i) {
      Limit& l = w.lim[i];
      l.r1 = along(m, w, l, w.vf) + l.c0;
      widen(l.on, l.r1, l.r1 - l.c0, l.kappa, l.root);
      count += select(l.on, splat(1), T{});
    }
    for (int i = 0; i < w.ndry; ++i) {
      DryFriction& d = w.dry[i];
      d.r2 = along(m, w, d.line, w.vf) + d.c0;
      widen(d.on, d.r2, d.r2, d.kappa, d.root);
      count += select(d.on, splat(1), T{});
    }
    zeta = vmax(zeta, splat(1e-12));
    if (factor > 1) zeta = vmax(zeta, splat(1));  // else a weightless body under a heavy one (F23) is not solved
  }

  // Centred start: every product equals zeta^2 (in rows scaled by the inverse weight).
  void start(double factor) {
    measure(factor);
    for (int k = 0; k < m.nv; ++k) w.rv[k] = w.delta[k] = T{};
    linear = splat(1);
    auto compare = [&](Mask on, T r, T root) { linear = vmax(linear, keep(on, factor * vabs(r) / (root * zeta))); };
    for (int g = 0; g < w.ngroups; ++g) {
      Vec<G::N> F = zero<G::N>();
      for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
        Contact<G>& c = w.con[i];
        c.gam = zeta / c.root;
        c.s = zeta * c.root;
        c.eta0 = c.s / c.mu;
        c.r1 = c.s + this->lift(c, c.eta0) - (c.r1 + c.Rn * c.gam);
        compare(c.on, c.r1, c.root);
        F += keep(c.on, c.gam) * c.Wr[0];
        for (int r = 1; r < c.rows; ++r) {
          c.b[r - 1] = c.eta[r - 1] = T{};
          c.r2[r - 1] = -c.r2[r - 1];
        }
        c.dgam = c.ds = c.deta0 = T{};  // what a failed solve left here must not be seen: 0 * NaN is NaN
        for (int r = 1; r < c.rows; ++r) c.db[r - 1] = c.deta[r - 1] = T{};
      }
      add_wrench(w.groups[g].group, F, w.rv);
    }
    for (int i = 0; i < w.nlim; ++i) {
      Limit& l = w.lim[i];
      l.gam = zeta / l.root;
      l.s = zeta * l.root;
      l.r1 = l.s - (l.r1 + l.R * l.gam);
      l.dgam = l.ds = T{};
      compare(l.on, l.r1, l.root);
      add_pull(m, w, l, keep(l.on, l.gam), w.rv);
    }
    for (int i = 0; i < w.ndry; ++i) {
      DryFriction& d = w.dry[i];
      d.b = d.eta = d.db = d.deta = d.deta0 = T{};
      d.r2 = -d.r2;
      d.eta0 = zeta * zeta / d.b0;
    }
    rho = splat(1);  // rv now holds J^T x0, the momentum residual -(M delta - J^T x) at the start
  }

  T complementarity(T alpha) const {  // mean product after a step
    T nu = T{};
    for (int i = 0; i < w.ncon; ++i) {
      const Contact<G>& c = w.con[i];
      nu += keep(c.on, (c.gam + alpha * c.dgam) * (c.s + alpha * c.ds));
      if (c.rows == 1) continue;
      T x = c.mu * (c.gam + alpha * c.dgam) * (c.eta0 + alpha * c.deta0);
      with_tangents(c, [&](auto count) { CMBRL_FOR(r, count.value) x += (c.b[r] + alpha * c.db[r]) * (c.eta[r] + alpha * c.deta[r]); });
      nu += keep(c.on & c.rub, x);
    }
    for (int i = 0; i < w.nlim; ++i)
      nu += keep(w.lim[i].on, (w.lim[i].gam + alpha * w.lim[i].dgam) * (w.lim[i].s + alpha * w.lim[i].ds));
    for (int i = 0; i < w.ndry; ++i) {
      const DryFriction& d = w.dry[i];
      nu += keep(d.on, d.b0 * (d.eta0 + alpha * d.deta0) + (d.b + alpha * d.db) * (d.eta + alpha * d.deta));
    }
    return nu / vmax(count, splat(1));
  }

  // A step in the lanes of `moving`; the others may have found no direction at all (NaN) and stay where they are.
  void advance(Mask moving, T alpha) {
    auto add = [&](T& x, T dx) { x += keep(moving, alpha * dx); };
    for (int i = 0; i < w.ndyn; ++i) add(w.delta[w.dyn_list[i]], w.rhs[w.dyn_list[i]]);
    for (int i = 0; i < w.ncon; ++i) {
      Contact<G>& c = w.con[i];
      add(c.gam, c.dgam);
      add(c.s, c.ds);
      if (c.rows == 1) continue;
      add(c.eta0, c.deta0);
      with_tangents(c, [&](auto count) { CMBRL_FOR(r, count.value) { add(c.b[r], c.db[r]); add(c.eta[r], c.deta[r]); } });
    }
    for (int i = 0; i < w.nlim; ++i) { add(w.lim[i].gam, w.lim[i].dgam); add(w.lim[i].s, w.lim[i].ds); }
    for (int i = 0; i < w.ndry; ++i) { add(w.dry[i].b, w.dry[i].db); add(w.dry[i].eta0, w.dry[i].deta0); add(w.dry[i].eta, w.dry[i].deta); }
    rho *= 1.0 - keep(moving, alpha);
  }

  // Largest distance of a product x y from kappa + centre, relative to that and to what round-off makes of it: x and y come
  // down from zeta, and y is a velocity.
  T off_path(T centre) const {
    T worst = T{}, start = 4e-16 / o.theta * zeta, noise = 1e-14 / o.theta * speed;
    auto widen = [&](Mask on, T error, T kappa, T x, T y, T root) {
      T blur = vmax(start * (x * root + y / root), x * vmax(noise, 4e-16 / o.theta * y));
      worst = vmax(worst, keep(on, vabs(error) / vmax(kappa + centre, blur)));
    };
    for (int i = 0; i < w.ncon; ++i) {
      const Contact<G>& c = w.con[i];
      widen(c.on, c.gam * c.s - c.kappa - centre, c.kappa, c.gam, c.s, c.root);
      if (c.rows == 1) continue;
      T b0 = c.mu * c.gam, head = b0 * c.eta0 - c.kappa - centre;
      with_tangents(c, [&](auto count) {
        CMBRL_FOR(r, count.value) {
          head += c.b[r] * c.eta[r];
          widen(c.on & c.rub, b0 * c.eta[r] + c.eta0 * c.b[r], c.kappa, b0, c.eta0, c.root);
        }
      });
      widen(c.on & c.rub, head, c.kappa, b0, c.eta0, c.root);
    }
    for (int i = 0; i < w.nlim; ++i) {
      const Limit& l = w.lim[i];
      widen(l.on, l.gam * l.s - l.kappa - centre, l.kappa, l.gam, l.s, l.root);
    }
    for (int i = 0; i < w.ndry; ++i) {
      const DryFriction& d = w.dry[i];
      widen(d.on, d.b0 * d.eta0 + d.b * d.eta - d.kappa - centre, d.kappa, d.b0, d.eta0, d.root);
      widen(d.on, d.b0 * d.eta + d.eta0 * d.b, d.kappa, d.b0, d.eta0, d.root);
    }
    return worst;
  }

  T mean_kappa() const {
    T sum = T{};
    for (int i = 0; i < w.ncon; ++i)
      sum += keep(w.con[i].on, w.con[i].kappa) + keep(w.con[i].on & w.con[i].rub, w.con[i].kappa);
    for (int i = 0; i < w.nlim; ++i) sum += keep(w.lim[i].on, w.lim[i].kappa);
    for (int i = 0; i < w.ndry; ++i) sum += keep(w.dry[i].on, w.dry[i].kappa);
    return sum / vmax(count, splat(1));
  }

  // One Newton step to kappa in the lanes of `todo`, from residuals that were just computed; with yield, a matrix that
  // round-off cannot spoil, so that a few of them end at the same point.
  void refine(Mask todo, double yield) {
    rho = splat(1);
    this->yield = yield;
    linearise_all(T{}, none());
    this->yield = 0;
    factorise();
    T alpha = vmin(direction() * 0.99, splat(1));
    advance(todo, alpha);
  }

  void set_friction(T share) {
    for (int i = 0; i < w.ncon; ++i) {
      Contact<G>& c = w.con[i];
      if (c.rows > 1) c.mu = select(c.rub, share * c.full_mu, splat(1));
    }
  }

  // Runs the lanes of `todo`; returns those that converged. Lanes outside keep alpha = 0 and so keep their start.
  Mask run(Mask todo, const Course& st, T& iterations) {
    start(st.start);
    return descend(todo, st, iterations);
  }

  Mask descend(Mask todo, const Course& st, T& iterations) {  // from the current point
    T kappa = mean_kappa(), centre = keep(st.follow, rho * zeta * zeta), floor = 1e-6 * zeta * zeta;
    Mask busy = todo & (count > 0.0), done = todo & ~busy;
    T before = T{};  // what was left of the path when patience was last asked
    T slow = T{};  // short steps in a row: the path has folded, more of them would lead nowhere
    T share = o.convex ? splat(1) : st.friction;  // convex paths do not fold
    bool grows_friction = any(share < 1.0);
    if (grows_friction) set_friction(share);
    for (int it = 0; any(busy); ++it) {
      T nu = complementarity(T{});
      T off = off_path(centre);
      Mask ready = busy & (centre <= 0.0) & (share >= 1.0) & (off <= o.theta) & (rho * linear <= o.tolerance);
      done |= ready;
      busy &= ~ready;
      if (w.lanes == 1) busy &= up_to(first_of(done));  // what an earlier rung has solved is no longer for the later ones
      if (it % st.patience == 0) {
        T left = nu - kappa;
        if (it > 0) busy &= (left < 0.9 * before) | (left <= 100.0 * kappa);
        before = left;
      }
      busy &= splat(it) < st.iterations;
      if (!any(busy)) break;
      iterations += select(busy, splat(1), T{});
      T excess = vmax(nu - kappa, T{});
      // Far from both ends of the path a step may go nearer to the boundary: a sixth fewer iterations to a small kappa (wild
      // hopper: 7.6 instead of 9.1). From ten times as far out, a third more wild cubes need a second attempt; up to the end,
      // a seventh more hoppers (Relaxed).
      Mask midway = (nu < 1e-3 * zeta * zeta) & (excess > 100.0 * kappa);
      T alpha, tau = st.corrector ? select(midway, splat(0.999), splat(st.tau)) : splat(st.tau);
      if (st.corrector) {
        linearise_all(T{}, none());
        factorise();
        T affine = vmin(direction() * tau, splat(1));
        T ratio = vmax(complementarity(affine) - kappa, T{}) / vmax(excess, splat(1e-300));
        T sigma = vmin(ratio * ratio * ratio, splat(1));
        // Where the step is cut short, its second-order term says little: without it 3 % fewer iterations of wild hoppers, 8 %
        // of the G1 (Relaxed), but more second attempts (98 wild hoppers of 4,000 for 82). No stored problem needs this.
        Mask shortened = affine < 0.2;
        linearise_all(select(excess > 0.0, sigma * excess, T{}), ~shortened);
      } else {
        if (any(st.follow)) {
          // Friction grows near the end of its path: at 1000 times the floor, or a thousandth, cheetah 5 to 7 need later rungs.
          // Nearer to the path than this before a centre shrinks, cheetah 5 and 6 need rung 7; four times as far is
          // too far for stacks of 1 : 1e6.
          Mask next = st.follow & (off < 0.5), grows = next & (share < 1.0) & (centre <= vmax(kappa, floor));
          grown |= grows;
          if (any(grows)) {
            share = select(grows, vmin(st.growth * share, splat(1)), share);
            set_friction(share);
            before = select(grows, splat(1e300), before);  // more friction takes them back
          }
          centre = select(next & ~grows, st.sigma * centre, centre);
          // Zero ends the path; a centre that only dwindled would never do so, and cheetah 5 and 6 need rung 7.
          centre = select(centre > 0.1 * kappa, centre, T{});
        }
        linearise_all(select(st.follow, centre, st.sigma * excess), none());
        factorise();
      }
      alpha = vmin(direction() * tau, splat(1));
      advance(busy, alpha);
      // Short steps in a row lead nowhere: without this, twice the iterations of the solver study's problems. If ten times as
      // long ones counted, the stack F1c would be given up at 20 Hz; after two of them, six more wild hoppers.
      slow = select(alpha < 1e-3, slow + 1.0, T{});
      busy &= slow < 4.0;
    }
    if (grows_friction) set_friction(splat(1));
    return done;
  }
};

}  // namespace cmbrl::CMBRL_ISA
