// What parameters of a body do to its inertia: its mass, its centre of mass, the shape of its inertia. Each is of one body.
#pragma once
#include "dynamics/inertia_shape.hpp"

namespace cmbrl::CMBRL_ISA {

// Adds `coef` times the change of the inertia about O with one of the body's fields in P.
template <class G>
static void add_inertia(const Model& m, const Work<G>& w, int b, int field, double coef, Inertia<G>& dI) {
  const T* p = w.P + b * m.body_fields;
  typename G::V c;
  CMBRL_FOR(i, G::D) c[i] = p[1 + i];
  c = w.pos[b] + G::rotate(w.R[b], c);
  T k = splat(coef);
  if (field == 0) {
    dI.m += k;
    dI.h += k * c;
    G::add_steiner(dI.I, k, c);
  } else if (field <= G::D) {
    typename G::V e = zero<G::D>();
    e[field - 1] = k;
    e = G::rotate(w.R[b], e);
    dI.h += p[0] * e;
    G::add_steiner_derivative(dI.I, p[0], c, e);
  } else {
    T unit[G::SYM] = {}, world[G::SYM];
    unit[field - 1 - G::D] = k;
    G::sym_rotate(w.R[b], unit, world);
    CMBRL_FOR(i, G::SYM) dI.I[i] += world[i];
  }
}

// The change of a body's inertia about its centre, in world axes, with parameter k of a shape, or with the mass that it goes
// with; false: there is none.
template <class G>
static bool shape_change(const Model& m, const Work<G>& w, int k, T* world) {
  int s = m.par_shape[k];
  T dI[G::SYM];
  if (s < 0) return false;
  if (m.shape_mass[s] == k) {
    if (!reshaped(m, w, s)) return false;
    shape_inertia(m, w, s, dI);
  } else {
    int j = 0;
    while (m.shape_par[s * kShape<G> + j] != k) ++j;
    shape_derivative(m, w, s, j, dI);
    T mu = mass_scale(m, w, m.shape_mass[s]);
    CMBRL_FOR(i, G::SYM) dI[i] *= mu;
  }
  G::sym_rotate(w.R[m.shape_body[s]], dI, world);
  return true;
}

// The body whose inertia parameter k changes, and that change dI; -1: of none.
template <class G>
static int inertia_change(const Model& m, const Work<G>& w, int k, Inertia<G>& dI) {
  int b = -1;
  T world[G::SYM];
  dI = Inertia<G>{};
  if (shape_change(m, w, k, world)) {
    b = m.shape_body[m.par_shape[k]];
    CMBRL_FOR(i, G::SYM) dI.I[i] += world[i];
  }
  for (int e = m.par_ptr[k]; e < m.par_ptr[k + 1]; ++e) {
    if (m.par_idx[e] >= m.oDof) continue;
    b = m.par_idx[e] / m.body_fields;
    add_inertia(m, w, b, m.par_idx[e] % m.body_fields, m.par_coef[e], dI);
  }
  return b;
}

}  // namespace cmbrl::CMBRL_ISA
