// Which kappa each row gets. Numerical softening is scaled by row, floor / w with w its inverse weight, so that light bodies do
// not feel what heavy ones need. On top of it: one constant kappa (barrier smoothing); the schedule whose solution is the
// Gaussian-smoothed impulse of a single contact,  kappa(z) = F rho(z) rho(-z),  rho(z) = (s N(z/s) - z Phi(-z/s)) / F  (proposition
// 5.3 of Zhang, Jin & Wang, ICML 2023, in closed form; with several contacts F = w + R of the row); or that paper's Algorithm 1:
// one kappa for the step from the gap of the nearest contact that carries no load, a constant to the derivative.
#pragma once
#include "solver/ladder.hpp"
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

struct Schedule { double kappa, slope; };  // and its derivative in z

static inline Schedule gaussian_schedule(double z, double speed, double F, double floor) {
  auto rho = [&](double x) {  // F rho
    double t = x / speed;
    double density = 0.3989422804014327 * __builtin_exp(-0.5 * t * t);
    if (t > 5) {  // Mills ratio by continued fraction: no cancellation in the tail
      double m = t + 8 / t;
      for (int k = 7; k >= 1; --k) m = t + k / m;
      return speed * density * (1 - t / m);
    }
    return speed * density - x * 0.5 * __builtin_erfc(t * 0.7071067811865476);
  };
  auto tail = [&](double x) { return 0.5 * __builtin_erfc(x / speed * 0.7071067811865476); };
  double a = rho(z), b = rho(-z), kappa = a * b / F;
  if (kappa < floor) return {floor, 0};
  return {kappa, (-tail(z) * b + a * tail(-z)) / F};
}

struct RowKappa { T kappa, slope, slope_R; };  // kappa and its derivatives in z and in the row's compliance R

static inline RowKappa kappa_of(const Smoothing& s, double h, double weight, T root, T z) {
  double floor = s.floor / weight;
  RowKappa k{splat(floor), T{}, T{}};
  if (s.mode == kConstant) k.kappa = splat(s.kappa);
  if (s.mode != kGaussian) return k;
  for (int i = 0; i < W; ++i) {
    double F = root[i] * root[i];
    Schedule g = gaussian_schedule(z[i], s.length / h, F, floor);
    k.kappa[i] = g.kappa;
    if (s.stop || g.kappa <= floor) continue;
    k.slope[i] = g.slope;
    k.slope_R[i] = -g.kappa / F;
  }
  return k;
}

// Twist of A against B under the free velocity.
template <class G>
static Vec<G::N> free_twist(const Model& m, const Work<G>& w, int group) {
  Vec<G::N> t = zero<G::N>();
  for (int k = m.grp_dptr[group]; k < m.grp_dptr[group + 1]; ++k) {
    int d = m.grp_dof[k];
    t += (m.grp_sign[k] > 0 ? w.vf[d] : -w.vf[d]) * w.S[d];
  }
  return t;
}

// The free closing coordinate z = J vf + c0 of every normal row decides. Dry friction yields at a speed of its own, whatever
// the contacts' softening is.
template <class G>
static void set_kappa(const Model& m, const Options& o, Work<G>& w, const Smoothing& s) {
  for (int g = 0; g < w.ngroups; ++g) {
    Vec<G::N> t = s.mode == kGaussian ? free_twist(m, w, w.groups[g].group) : zero<G::N>();
    for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
      Contact<G>& c = w.con[i];
      RowKappa k = kappa_of(s, o.h, m.con_invweight[c.index], c.root, dot(c.Wr[0], t) + c.cn0);
      c.kappa = k.kappa; c.slope = k.slope; c.slope_R = k.slope_R;
    }
  }
  for (int i = 0; i < w.nlim; ++i) {
    Limit& l = w.lim[i];
    RowKappa k = kappa_of(s, o.h, m.lim_invweight[l.index], l.root, along(m, w, l, w.vf) + l.c0);
    l.kappa = k.kappa; l.slope = k.slope; l.slope_R = k.slope_R;
  }
  for (int i = 0; i < w.ndry; ++i) w.dry[i].kappa = s.dry * w.dry[i].b0;
}

// The published rule, from the solution that the rows hold. A contact carries load where its impulse outweighs its slack.
template <class G>
static void raise_by_nearest(Work<G>& w, const Smoothing& s) {
  T nearest = w.left_out_gap;
  for (int i = 0; i < w.ncon; ++i) {
    const Contact<G>& c = w.con[i];
    Mask idle = c.on & (c.gam * c.root * c.root < c.s);
    nearest = select(idle, vmin(nearest, vabs(c.phi)), nearest);
  }
  T kappa;
  for (int i = 0; i < W; ++i) kappa[i] = s.kappa * __builtin_exp(-nearest[i] * nearest[i] / (s.length * s.length));
  for (int i = 0; i < w.ncon; ++i) w.con[i].kappa = vmax(w.con[i].kappa, kappa);
  for (int i = 0; i < w.nlim; ++i) w.lim[i].kappa = vmax(w.lim[i].kappa, kappa);
}

// Solves the rows at the kappas of `s`. again: for the derivative; the rows hold the solution of the simulated step.
template <class G>
static Outcome solve_smoothed(const Model& m, const Options& o, Work<G>& w, const Smoothing& s, bool again) {
  set_kappa(m, o, w, s);
  Outcome hard{all(), T{}, T{}, T{}};
  if (s.mode == kNearest) {
    if (!again) hard = contact_solve(m, o, w);
    raise_by_nearest(w, s);
  }
  if (again) {
    for (int i = 0; i < w.ncon; ++i) w.con[i].on = w.con[i].wide;
    for (int i = 0; i < w.nlim; ++i) w.lim[i].on = w.lim[i].wide;
  }
  Outcome out = contact_solve(m, o, w);
  return {hard.done & out.done, vmax(hard.rung, out.rung), hard.iterations + out.iterations, out.residual};
}

}  // namespace cmbrl::CMBRL_ISA
