// Which kappa each row gets: constant (barrier smoothing), or the schedule whose solution is the Gaussian-smoothed impulse
// of a single contact,  kappa(z) = F rho(z) rho(-z),  rho(z) = (s N(z/s) - z Phi(-z/s)) / F   (adaptive smoothing).
// Proposition 5.3 of Zhang, Jin & Wang, ICML 2023, in closed form; with several contacts F is the constant weight of the row.
#pragma once
#include "workspace.hpp"

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

static inline void scheduled(const Smoothing& s, double h, T z, double F, T& kappa, T& slope) {
  if (s.mode == kConstant) { kappa = splat(s.kappa); slope = T{}; return; }
  for (int i = 0; i < W; ++i) {
    Schedule k = gaussian_schedule(z[i], s.length / h, F, s.kappa);
    kappa[i] = k.kappa;
    slope[i] = s.stop ? 0 : k.slope;
  }
}

// Free closing coordinate z = J vf + c0 of every normal row decides; dry friction keeps the floor.
template <class G>
static void set_kappa(const Model& m, const Options& o, Work<G>& w, const Smoothing& s) {
  for (int g = 0; g < w.ngroups; ++g) {
    Vec<G::N> t = zero<G::N>();
    if (s.mode == kGaussian)
      for (int k = m.grp_dptr[w.groups[g].group]; k < m.grp_dptr[w.groups[g].group + 1]; ++k) {
        int d = m.grp_dof[k];
        t += (m.grp_sign[k] > 0 ? w.vf[d] : -w.vf[d]) * w.S[d];
      }
    for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
      Contact<G>& c = w.con[i];
      scheduled(s, o.h, dot(c.Wr[0], t) + c.cn0, m.con_invweight[c.index], c.kappa, c.slope);
    }
  }
  for (int i = 0; i < w.nlim; ++i) {
    Limit& l = w.lim[i];
    scheduled(s, o.h, l.sign * w.vf[l.dof] + l.c0, m.lim_invweight[l.index], l.kappa, l.slope);
  }
  for (int i = 0; i < w.ndry; ++i) w.dry[i].kappa = splat(s.kappa);
}

}  // namespace cmbrl::CMBRL_ISA
