// Softness by mass: MuJoCo's compliances are (1 - d)/d times an inverse weight, which the masses around a row determine
// (load_weights.hpp). Here: what rows take from it, as factors on the file's.
#pragma once
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

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

// f(parameter, change of weight j with it), of those that have columns.
template <class G, class F>
static inline void for_weights(const Model& m, const Work<G>& w, int j, F f) {
  const T* slope = w.weight_slope + m.weight_slopes[j];
  for (int i = m.weight_span[2 * j]; i < m.weight_span[2 * j + 1]; ++i, ++slope)
    if (int k = m.inertial_par[i]; w.column[k] >= 0) f(k, *slope);
}

}  // namespace cmbrl::CMBRL_ISA
