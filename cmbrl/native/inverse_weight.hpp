// Softness by mass: MuJoCo's compliances are (1 - d)/d times an inverse weight, which the masses and armatures around a row
// determine. As a function of their scales mu it is close to a sum of reciprocals,  w (1 + sum_k a_k (1/mu_k - 1)),  exact for
// free bodies and where all of them scale together (scene/inverse_weights.py).
#pragma once
#include "workspace.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr double kLeastMass = 1e-9;  // of a scale: a weightless body leaves numbers finite

template <class G>
static inline T scale_of_mass(const Model& m, const Work<G>& w, int i) {
  int k = m.mass_par[i];
  return vmax(1.0 + w.dtheta[k] / m.par_nominal[k], splat(kLeastMass));
}

template <class G>
static void load_weights(const Model& m, Work<G>& w) {
  for (int i = 0; i < m.nmass; ++i) w.lighter[i] = 1.0 / scale_of_mass(m, w, i) - 1.0;
  for (int j = 0; j < m.nweight; ++j) {
    w.weight[j] = splat(1);
    for (int e = m.weight_ptr[j]; e < m.weight_ptr[j + 1]; ++e) w.weight[j] += m.weight_coef[e] * w.lighter[m.weight_mass[e]];
  }
}

// The factor on the inverse weight of a limit or of dry friction; -1: no mass softens it.
template <class G>
static inline T weight_of(const Work<G>& w, int j) { return j < 0 ? splat(1) : w.weight[j]; }

// Of a contact: both bodies' inverse weights by their shares of the sum.
template <class G>
static inline T contact_weight(const Model& m, const Work<G>& w, int i) {
  T x = splat(1);
  CMBRL_FOR(side, 2) if (int j = m.con_weight[2 * i + side]; j >= 0) x += m.con_share[2 * i + side] * (w.weight[j] - 1.0);
  return x;
}

// f(parameter, change of weight j with it).
template <class G, class F>
static inline void for_weights(const Model& m, const Work<G>& w, int j, F f) {
  for (int e = m.weight_ptr[j]; e < m.weight_ptr[j + 1]; ++e) {
    T mu = scale_of_mass(m, w, m.weight_mass[e]);
    int k = m.mass_par[m.weight_mass[e]];
    f(k, -m.weight_coef[e] / (m.par_nominal[k] * mu * mu));
  }
}

}  // namespace cmbrl::CMBRL_ISA
