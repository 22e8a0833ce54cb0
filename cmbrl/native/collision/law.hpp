// Contact and limit laws: what a gap asks of the velocity after the step, and how softly.
// Every row reads  c = J v' + R x - carry J v + c0(phi),  0 <= x _|_ c >= 0 (normal), Coulomb with maximal dissipation (tangent).
// MuJoCo's solref/solimp written for impulses: its documentation, "Computation > Constraint model"; the pyramid's regulariser
// as an equivalent (R_n, R_t) pair: R_e (lambda_n^2/(2 n) + lambda_t^2/(4 mu^2)) is the cost of its n edges, so that
// R_n = R_e/n and R_t = R_e/(2 mu^2), with R_e = 2 mu^2 (1 + mu^2)/impratio times the compliance of a frictionless row.
#pragma once
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

struct Law { T c0, dc0, R, dR, carry; };  // derivatives with respect to the gap

// Bounds are those that MuJoCo clips solimp to; without a width its sigmoid is flat, at the mean of both ends.
static inline T share(T d) { return vmin(vmax(d, splat(1e-4)), splat(0.9999)); }
static inline void impedance(T r, T d0, T dmax, T width, double mid, double power, T& d, T& dd) {
  constexpr double kNoWidth = 1e-15;
  mid = mid < 1e-4 ? 1e-4 : mid > 0.9999 ? 0.9999 : mid;
  power = power < 1 ? 1 : power;
  d0 = share(d0);
  dmax = share(dmax);
  Mask flat = width <= kNoWidth;
  T wd = vmax(width, splat(kNoWidth));
  T x = vmax(-r, T{}) / wd;  // before touching, the impedance of first contact
  Mask inside = (r < 0.0) & (x < 1.0) & ~flat;
  x = vmin(x, splat(1));
  T y, dy;
  if (power == 2) {
    Mask low = x <= mid;
    T e = 1.0 - x;
    y = select(low, x * x / mid, 1.0 - e * e / (1 - mid));
    dy = select(low, 2.0 * x / mid, 2.0 * e / (1 - mid));
  } else {
    for (int i = 0; i < W; ++i) {
      bool low = x[i] <= mid;
      double e = low ? x[i] : 1 - x[i], b = low ? mid : 1 - mid;
      double t = __builtin_pow(e / b, power - 1);
      y[i] = low ? e * t : 1 - e * t;
      dy[i] = power * t;
    }
  }
  d = d0 + select(flat, splat(0.5), y) * (dmax - d0);
  dd = select(inside, -dy * (dmax - d0) / wd, T{});
}

static inline void stiffness_damping(T ref0, T ref1, T dmax, double least_time, T& K, T& B) {
  dmax = share(dmax);
  Mask standard = ref0 > 0.0;
  T tc = vmax(ref0, splat(least_time));
  T dr = select(standard, ref1, splat(1));
  K = select(standard, 1.0 / (dmax * dmax * tc * tc * dr * dr), -ref0 / (dmax * dmax));
  B = select(standard, 2.0 / (dmax * tc), -ref1 / dmax);
}

static inline Law soft_law(T gap, double margin, double h, double least_time, T ref0, T ref1, T d0, T dmax, T width, double mid, double power, T inverse_weight) {
  Law L;
  T r = gap - margin, d, dd, K, B;
  impedance(r, d0, dmax, width, mid, power, d, dd);
  stiffness_damping(ref0, ref1, dmax, least_time, K, B);
  Mask apart = r > 0.0;  // quiet until it would close within the step
  L.c0 = select(apart, r / h, h * K * d * r);
  L.dc0 = select(apart, splat(1 / h), h * K * (d + dd * r));
  L.R = (1.0 - d) / d * inverse_weight;
  L.dR = -dd / (d * d) * inverse_weight;
  L.carry = 1.0 - h * B;
  return L;
}

static inline T vexp(T x) {
  T y;
  for (int i = 0; i < W; ++i) y[i] = __builtin_exp(x[i]);
  return y;
}

constexpr double kFaint = 25;  // a logistic contact is left out where it would take exp(-25) of the approach

template <class G>
static void contact_law(const Model& m, const Options& o, Known<G>& c, const T* p) {
  int i = c.index;
  double h = o.h;
  T mu = p[kMu], mu2 = mu * mu, one = splat(1);
  T phi = c.phi, scale = p[kRscale];
  Law L;
  T ratio = one;  // R_t / R_n
  switch (m.con_law[i]) {
    case kMujoco: {
      T weight = scale * m.con_invweight[i];
      if (m.con_pyramid[i] && (c.rows > 1 || c.edge)) {
        double share = c.edge ? 2 : 2.0 / m.con_pyramid[i];  // R_e of an edge, R_e / n of all of them
        weight = select(c.rub, weight * mu2 * (1.0 + mu2) * (share / m.con_impratio[i]), weight);
        ratio = select(c.rub, (0.5 * m.con_pyramid[i]) / mu2, one);
      } else {
        ratio = splat(1 / m.con_impratio[i]);
      }
      L = soft_law(phi, m.con_margin[i], h, m.least_time(h), p[kSolref0], p[kSolref1], p[kD0], p[kDmax], p[kWidth], m.con_mid[i], m.con_power[i], weight);
      break;
    }
    case kSpringDamper: {  // implicit spring k, damper d: R = 1/(h (h k + d)), erp = h k/(h k + d)
      T hk = h * p[kSolref0], sum = hk + p[kSolref1];
      Mask apart = phi > 0.0;
      T erp = select(apart, one, hk / sum);
      L = {erp * phi / h, erp / h, scale / (h * sum), T{}, T{}};
      break;
    }
    case kLogistic: {  // a share s = 1/(1 + exp(stiffness phi)) of the approach of a lone contact ends: R = w (1 - s)/s
      T R = scale * m.con_invweight[i] * vexp(vmin(p[kSolref0] * phi, splat(kFaint)));
      L = {T{}, T{}, R, p[kSolref0] * R, T{}};
      break;
    }
    default: {  // rigid: the gap at the end of the step is not negative; old penetration decays with a time constant
      T rate = select(phi > 0.0, splat(1 / h), 1.0 / (h + vmax(p[kSolref0], T{})));
      L = {rate * phi, rate, T{}, T{}, T{}};
    }
  }
  c.cn0 = L.c0; c.dc_dphi = L.dc0;
  c.Rn = L.R; c.dRn_dphi = L.dR;
  c.Rt = L.R * ratio; c.dRt_dphi = L.dR * ratio;
  c.carry = L.carry;
  c.convex = o.convex ? c.rub & (phi <= m.con_margin[i]) : none();  // what does not touch yet is not lifted at a distance
}

}  // namespace cmbrl::CMBRL_ISA
