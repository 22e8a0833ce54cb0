// Coriolis, centrifugal and gyroscopic forces that MuJoCo takes implicitly as it takes damping: of all dofs under its integrator
// "implicit", of free bodies that carry nothing under "implicitfast". With C = dbias/dv they add h C to the D of split damping
// (split.hpp), which is no longer symmetric. Since the bias b is quadratic in the velocity,
//   C(v) e = b(v + e) - b(v) - b(e) + b(0),
// so that its derivatives are those of inverse dynamics at four velocities.
#pragma once
#include "dynamics/dynamics.hpp"

namespace cmbrl::CMBRL_ISA {

static inline bool gyroscopic(const Model& m, const Options& o) { return o.split && m.ngyro > 0; }

// D += h C, after inverse_dynamics at v and mass_matrix.
template <class G>
static void add_gyroscopic(const Model& m, const Options& o, Work<G>& w) {
  int nv = m.nv;
  for (int i = 0; i < nv * nv; ++i) w.gyro_q[i] = w.gyro_v[i] = T{};
  inverse_dynamics_derivatives(m, w, o.h, w.gyro_q, w.gyro_v);
  for (int i = 0; i < nv; ++i) {
    if (!m.gyro_dof[i]) continue;  // a whole tree has them or none of it
    Row<T> row(w.D, m.mass, i);
    const int *columns = m.mass.columns(i), *above = m.tree().columns(i);
    *row.diagonal += w.gyro_v[i * (nv + 1)];
    for (int a = 0, k = 0; a < m.tree().count(i); ++a, ++k) {
      while (columns[k] != above[a]) ++k;  // both rise
      row.before[k] += w.gyro_v[i * nv + above[a]];
      row.mirror[k] += w.gyro_v[above[a] * nv + i];
    }
  }
}

// f(x, weight) of the four velocities x whose weighted biases are C(v) e. In w.v and among the twists while f runs.
template <class G, class F>
static void for_polarised(const Model& m, Work<G>& w, const T* e, F f) {
  T *kept = w.v, *x = w.gyro_x;
  auto at = [&](double by_v, double by_e, double weight) {
    for (int i = 0; i < m.nv; ++i) x[i] = m.gyro_dof[i] ? by_v * kept[i] + by_e * e[i] : T{};
    w.v = x;
    inverse_dynamics<G>(m, w, x, nullptr, w.tmp);
    f(weight);
    w.v = kept;
  };
  at(1, 1, 1);
  at(1, 0, -1);
  at(0, 1, -1);
  at(0, 0, 1);
}

// Adds -h d(C(v) e)/dq to Sq and -h d(C(v) e)/dv to Sv. Leaves twists of other velocities.
template <class G>
static void gyroscopic_terms(const Model& m, const Options& o, Work<G>& w, const T* e, T* Sq, T* Sv) {
  int k = 0;
  for_polarised(m, w, e, [&](double weight) { inverse_dynamics_derivatives(m, w, -o.h * weight, Sq, k++ < 2 ? Sv : w.gyro_v); });
}

}  // namespace cmbrl::CMBRL_ISA
