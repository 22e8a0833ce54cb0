// Softness by mass: MuJoCo's compliances are (1 - d)/d times an inverse weight, which the masses and armatures around a row
// determine. As a function of their scales mu it is close to a sum of reciprocals,  w (1 + sum_k a_k (1/mu_k - 1)),  exact for
// free bodies and where all of them scale together; armatures A that the file does not have, whose nominal value is 0, divide
// it, as a multiple of w, by 1 + that multiple sum_k c_k A_k (scene/inverse_weights.py).
#pragma once
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr double kLeastMass = 1e-9;  // of a scale: a weightless body leaves numbers finite

template <class G>
static inline T scale_of_mass(const Model& m, const Work<G>& w, int i) {
  int k = m.mass_par[i];
  return vmax(1.0 + w.dtheta[k] / m.par_nominal[k], splat(kLeastMass));
}

// Whether entry e of a weight is a scale, and not an armature that the file does not have.
static inline bool of_scale(const Model& m, int e) { return m.par_nominal[m.mass_par[m.weight_mass[e]]] > 0; }

template <class G>
static void load_weights(const Model& m, Work<G>& w) {
  for (int i = 0; i < m.nmass; ++i)
    w.lighter[i] = m.par_nominal[m.mass_par[i]] > 0 ? 1.0 / scale_of_mass(m, w, i) - 1.0 : w.dtheta[m.mass_par[i]];
  for (int j = 0; j < m.nweight; ++j) {
    T scaled = splat(1), added = T{};
    for (int e = m.weight_ptr[j]; e < m.weight_ptr[j + 1]; ++e)
      (of_scale(m, e) ? scaled : added) += m.weight_coef[e] * w.lighter[m.weight_mass[e]];
    w.heavier[j] = 1.0 + scaled * added;
    w.weight[j] = scaled / w.heavier[j];
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
    int k = m.mass_par[m.weight_mass[e]];
    if (!of_scale(m, e)) { f(k, -m.weight_coef[e] * w.weight[j] * w.weight[j]); continue; }
    T mu = scale_of_mass(m, w, m.weight_mass[e]) * w.heavier[j];
    f(k, -m.weight_coef[e] / (m.par_nominal[k] * mu * mu));
  }
}

}  // namespace cmbrl::CMBRL_ISA
