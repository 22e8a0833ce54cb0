// The residuals that decide whether a result may pass, computed from scratch, and copies of a solver's state.
#pragma once
#include "solver/solver.hpp"

namespace cmbrl::CMBRL_ISA {

// Linear residuals computed afresh at the current point (they shrink by 1 - alpha only up to round-off), left in the rows
// and in rv; returns them relative: momentum to the impulses, rows to the speeds of all rows.
template <class G>
static T fresh_residuals(const Structure& m, SolverWork<G>& w, const InteriorPoint<G>& ip) {
  int nv = m.nv;
  T *r = w.rv, scale = splat(1e-12), momentum = T{}, speed = splat(1e-6), row = T{};
  for (int k = 0; k < nv; ++k)
    if (!w.dynamic[k]) { w.delta[k] = T{}; solve_up(w.H0, ip.pat, k, w.delta); }
  for (int k = 0; k < nv; ++k) { w.vn[k] = w.vf[k] + w.delta[k]; r[k] = -w.M[m.mass.row(k)] * w.delta[k]; }
  for (int i = 0; i < nv; ++i) {
    T sum = r[i], delta = w.delta[i];
    Row<T> mass(w.M, m.mass, i);
    for (int a = 0; a < mass.n; ++a) {
      int j = m.mass.columns(i)[a];
      T M_ij = mass.before[a];
      sum -= M_ij * w.delta[j];
      r[j] -= M_ij * delta;
    }
    r[i] = sum;
  }
  for (int i = 0; i < nv; ++i) scale = vmax(scale, vmax(vabs(r[i]), w.M[m.mass.row(i)] * vabs(w.vf[i])));
  auto compare = [&](Mask on, T c, T slack, T compliance) {
    T error = slack - c - compliance;
    speed = vmax(speed, keep(on, vmax(vabs(c), vabs(compliance))));
    row = vmax(row, keep(on, vabs(error)));
    return error;
  };
  for (int g = 0; g < w.ngroups; ++g) {
    Vec<G::N> t = ip.twist(w.groups[g].group, w.vn), F = zero<G::N>();
    for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
      Contact<G>& c = w.con[i];
      speed = vmax(speed, keep(c.on, vabs(c.cn0)));
      c.r1 = compare(c.on, dot(c.Wr[0], t) + c.cn0, c.s + ip.lift(c, c.eta0), c.Rn * c.gam);
      F += keep(c.on, c.gam) * c.Wr[0];
      for (int k = 1; k < c.rows; ++k) {
        c.r2[k - 1] = compare(c.on & c.rub, dot(c.Wr[k], t) + c.ct0[k - 1], c.eta[k - 1], c.Rt * c.b[k - 1]);
        F += keep(c.on & c.rub, c.b[k - 1]) * c.Wr[k];
      }
    }
    ip.add_wrench(w.groups[g].group, F, r);
  }
  for (int i = 0; i < w.nlim; ++i) {
    Limit& l = w.lim[i];
    speed = vmax(speed, keep(l.on, vabs(l.c0)));
    l.r1 = compare(l.on, along(m, w, l, w.vn) + l.c0, l.s, l.R * l.gam);
    add_pull(m, w, l, keep(l.on, l.gam), r);
  }
  for (int i = 0; i < w.ndry; ++i) {
    DryFriction& d = w.dry[i];
    d.r2 = compare(d.on, along(m, w, d.line, w.vn) + d.c0, d.eta, d.R * d.b);
    add_pull(m, w, d.line, keep(d.on, d.b), r);
  }
  for (int i = 0; i < nv; ++i) momentum = vmax(momentum, vabs(r[i]));
  return vmax(row / speed, momentum / scale);
}

template <class G, class F>
static void for_solver_state(const Structure& m, SolverWork<G>& w, T* save, F f) {
  int k = 0;
  for (int i = 0; i < m.nv; ++i) f(w.delta[i], save[k++]);
  for (int i = 0; i < w.ncon; ++i) {
    Contact<G>& c = w.con[i];
    f(c.gam, save[k++]); f(c.s, save[k++]);
    if (c.rows == 1) continue;
    f(c.eta0, save[k++]);
    CMBRL_FOR(r, c.rows - 1) { f(c.b[r], save[k++]); f(c.eta[r], save[k++]); }
  }
  for (int i = 0; i < w.nlim; ++i) { f(w.lim[i].gam, save[k++]); f(w.lim[i].s, save[k++]); }
  for (int i = 0; i < w.ndry; ++i) { f(w.dry[i].b, save[k++]); f(w.dry[i].eta0, save[k++]); f(w.dry[i].eta, save[k++]); }
}

}  // namespace cmbrl::CMBRL_ISA
