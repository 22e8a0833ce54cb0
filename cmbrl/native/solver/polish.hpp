// From a point of the path to the solution at kappa = 0: Newton on the projections that state the exact law,
//   gamma = max(0, gamma - a u_n),   beta = P_{mu gamma}(beta - a u_t),   u = J v' + b + R lambda
// (Alart & Curnier, CMAME 1991), or the convex one, lambda = P_K(lambda - a u), with a proximal term pull / a on every row
// that is held, so that redundant contacts keep the matrix regular; it vanishes at the solution. Directions are solved for
// by the interior point's own elimination.
#pragma once
#include "solver/residuals.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G>
struct Polish : InteriorPoint<G> {
  using InteriorPoint<G>::m, InteriorPoint<G>::o, InteriorPoint<G>::w, InteriorPoint<G>::rho;
  Polish(const Structure& m_, const Options& o_, SolverWork<G>& w_) : InteriorPoint<G>(m_, o_, w_) { this->heads = false; }
  T momentum;          // relative momentum residual at the current point
  double pull = 1e-7;  // proximal term of a step; 1e-9 to 1e-4 solve the same problems

  // No impulses: where bodies would be without contact.
  void rest() {
    for (int k = 0; k < m.nv; ++k) w.delta[k] = T{};
    for (int i = 0; i < w.ncon; ++i) {
      Contact<G>& c = w.con[i];
      c.gam = c.s = c.eta0 = T{};
      CMBRL_FOR(r, c.rows - 1) c.b[r] = c.eta[r] = T{};
    }
  }

  // Slacks become the rows' velocities u; returns the natural map of the exact law, as a norm over all rows.
  T natural_map() {
    momentum = fresh_residuals(m, w, *this);
    T sum = T{};
    for (int i = 0; i < w.ncon; ++i) {
      Contact<G>& c = w.con[i];
      c.s -= c.r1;
      c.r1 = T{};
      T a = 1.0 / (c.root * c.root), zt[G::MT], size = T{}, slip = T{};
      CMBRL_FOR(r, c.rows - 1) {
        c.eta[r] = keep(c.rub, c.eta[r] - c.r2[r]);
        c.r2[r] = T{};
        zt[r] = keep(c.rub, c.b[r]) - a * c.eta[r];
        size += zt[r] * zt[r];
        slip += c.eta[r] * c.eta[r];
      }
      T mu = c.rows > 1 ? keep(c.rub, c.mu) : T{};
      size = vsqrt(size);
      T zn = c.gam - a * (c.s + select(c.convex, T{}, mu * vsqrt(slip)));
      Mask inside = (size <= mu * zn) & (zn >= 0.0);
      T head = select(inside, zn, vmax((mu * size + zn) / (1.0 + mu * mu), T{}));
      T scale = select(inside, splat(1), mu * head / vmax(size, splat(1e-300))), e = c.gam - head;
      sum += keep(c.on, e * e);
      for (int r = 1; r < c.rows; ++r) {
        e = keep(c.on & c.rub, c.b[r - 1] - scale * zt[r - 1]);
        sum += e * e;
      }
    }
    for (int i = 0; i < w.nlim; ++i) {
      Limit& l = w.lim[i];
      l.s -= l.r1;
      l.r1 = T{};
      T e = keep(l.on, l.gam - vmax(l.gam - l.s / (l.root * l.root), T{}));
      sum += e * e;
    }
    for (int i = 0; i < w.ndry; ++i) {
      DryFriction& d = w.dry[i];
      d.eta -= d.r2;
      d.r2 = T{};
      T e = keep(d.on, d.b - vmin(vmax(d.b - d.eta / (d.root * d.root), -d.b0), d.b0));
      sum += e * e;
    }
    return vsqrt(sum);
  }

  void linearise(Contact<G>& c, double eps) {
    int K = c.rows - 1;
    T weight = c.root * c.root, a = 1.0 / weight;
    T zn = vmax(c.gam - a * c.s, T{});
    Mask held = c.on & (zn > 0.0);
    T stiff = 1.0 / (c.Rn + eps * weight);
    c.Th[0][0] = keep(held, stiff);
    c.w[0] = select(held, -c.s * stiff, keep(c.on, -c.gam));
    if (c.rows == 1) return;
    Mask on = held & c.rub;
    T z[G::MT], size = T{};
    CMBRL_FOR(r, K) { z[r] = c.b[r] - a * c.eta[r]; size += z[r] * z[r]; }
    size = vmax(vsqrt(size), splat(1e-300));
    Mask sticks = size <= c.mu * zn;
    T inv = 1.0 / size, along = T{}, ahead = T{}, k = c.mu * zn * inv;  // k < 1 while sliding
    CMBRL_FOR(r, K) { z[r] *= inv; along += z[r] * c.b[r]; ahead += z[r] * c.eta[r]; }
    T den = 1.0 / (1.0 - k + k * (a * c.Rt + eps)), hold = 1.0 / (c.Rt + eps * weight), turn = k * a * den;
    T target = c.mu * (c.gam + c.w[0]) - along;
    CMBRL_FOR(i, K) {
      T across = a * (c.eta[i] - ahead * z[i]);  // what b has across z, without the cancellation: den may be 1 / eps
      T sliding = target * z[i] - den * across;
      c.w[1 + i] = select(on, select(sticks, -c.eta[i] * hold, sliding), keep(c.on & c.rub, -c.b[i]));
      c.Th[0][1 + i] = T{};
      c.Th[1 + i][0] = keep(on & ~sticks, c.mu * c.Th[0][0] * z[i]);
      CMBRL_FOR(j, K) {
        T same = i == j ? splat(1) : T{};
        c.Th[1 + i][1 + j] = keep(on, select(sticks, same * hold, turn * (same - z[i] * z[j])));
      }
    }
    if (o.convex) linearise_convex(c, eps);
  }

  // In the lanes of the convex law: along the cone's edge u = (1, mu z) / q, across it along the circle, and out of it, along
  // n = (mu, -z) / q; q^2 = 1 + mu^2.
  void linearise_convex(Contact<G>& c, double eps) {
    int K = c.rows - 1;
    T weight = c.root * c.root, a = 1.0 / weight, mu = c.mu, iq2 = 1.0 / (1.0 + mu * mu);
    T Rn = c.Rn + eps * weight, Rt = c.Rt + eps * weight, zn = c.gam - a * c.s, z[G::MT], size = T{};
    CMBRL_FOR(r, K) { z[r] = c.b[r] - a * c.eta[r]; size += z[r] * z[r]; }
    size = vmax(vsqrt(size), splat(1e-300));
    Mask sticks = c.on & (size <= mu * zn) & (zn > 0.0), slides = c.on & ~sticks & (mu * size + zn > 0.0);
    T inv = 1.0 / size, k = mu * (mu * size + zn) * iq2 * inv, along = T{}, ahead = T{};  // k < 1 while sliding
    CMBRL_FOR(r, K) { z[r] *= inv; along += z[r] * c.b[r]; ahead += z[r] * c.eta[r]; }
    T stiff = 1.0 / ((Rn + mu * mu * Rt) * iq2), den = 1.0 / (1.0 - k + k * a * Rt), turn = k * a * den;
    T out = along - mu * c.gam;  // what lambda has out of the cone, times q
    T push = -stiff * iq2 * (c.s + mu * ahead + mu * out * (Rn - Rt) * iq2), hold_n = 1.0 / Rn, hold_t = 1.0 / Rt;
    auto put = [&](T& x, T y) { x = select(c.convex, y, x); };
    put(c.w[0], select(sticks, -c.s * hold_n, select(slides, push + mu * out * iq2, keep(c.on, -c.gam))));
    put(c.Th[0][0], select(sticks, hold_n, keep(slides, stiff * iq2)));
    CMBRL_FOR(i, K) {
      T across = a * (c.eta[i] - ahead * z[i]);  // what b has across z, without the cancellation: den may be 1 / eps
      T sliding = (mu * push - out * iq2) * z[i] - den * across;
      put(c.w[1 + i], select(sticks, -c.eta[i] * hold_t, select(slides, sliding, keep(c.on, -c.b[i]))));
      put(c.Th[0][1 + i], keep(slides, stiff * iq2 * mu * z[i]));
      put(c.Th[1 + i][0], c.Th[0][1 + i]);
      CMBRL_FOR(j, K) {
        T same = i == j ? splat(1) : T{}, both = z[i] * z[j];
        put(c.Th[1 + i][1 + j], select(sticks, same * hold_t, keep(slides, stiff * iq2 * mu * mu * both + turn * (same - both))));
      }
    }
  }

  void linearise_exact(double eps) {
    for (int i = 0; i < w.ncon; ++i) linearise(w.con[i], eps);
    for (int i = 0; i < w.nlim; ++i) {
      Limit& l = w.lim[i];
      T weight = l.root * l.root;
      Mask held = l.on & (l.gam - l.s / weight > 0.0);
      l.Th = keep(held, 1.0 / (l.R + eps * weight));
      l.w = select(held, -l.s * l.Th, keep(l.on, -l.gam));
    }
    for (int i = 0; i < w.ndry; ++i) {
      DryFriction& d = w.dry[i];
      T weight = d.root * d.root, z = d.b - d.eta / weight;
      Mask sticks = d.on & (vabs(z) <= d.b0);
      d.Th = keep(sticks, 1.0 / (d.R + eps * weight));
      d.w = select(sticks, -d.eta * d.Th, keep(d.on, select(z > 0.0, d.b0, -d.b0) - d.b));
    }
    this->factorise();
  }

  // Full Newton steps in the lanes of `todo` until the natural map is below tolerance * scale; returns the lanes that got
  // there. A lane that a step takes far from every solution has left where Newton converges: more steps would be luck, and
  // cost the problems of the solver study a tenth more iterations in all.
  Mask run(Mask todo, T scale, double tolerance, int steps, T& natural, T& iterations) {
    Mask done = none();
    T lost = T{};
    for (int k = 0;; ++k) {
      T now = natural_map();
      if (k == 0) lost = vmax(10.0 * now, 0.3 * scale);
      natural = select(todo, now, natural);
      Mask ready = todo & (now <= tolerance * scale) & (momentum <= tolerance);
      done |= ready;
      todo &= ~ready & (now < lost);
      if (!any(todo) || k == steps) return done;
      iterations += select(todo, splat(1), T{});
      rho = splat(1);
      linearise_exact(pull);
      this->direction();
      this->advance(todo, splat(1));
    }
  }
};

}  // namespace cmbrl::CMBRL_ISA
