// Ties: equality constraints between two bodies (connect, weld) or two lines (a polynomial). Their rows pull both ways with
// MuJoCo's soft law, c = J v' + R x - carry J v + h K d r [+ h dJ/dt v] = 0, whatever the sign of x: so x = -(J v' + ...) / R
// needs no interior point, and J^T J / R joins the mass matrix, whose pattern holds the dofs that a tie couples
// (scene_data.cpp). As in MuJoCo only rows of bodies look at how J changes.
#pragma once
#include "step/tie_sway.hpp"

namespace cmbrl::CMBRL_ISA {

// The ties of a step, their pull at vn = v into rhs, and J^T J / R into M.
template <class G>
static void tie_forces(const Model& m, const Options& o, Work<G>& w) {
  constexpr int kRows = Tie<G>::kRows;
  if (m.ntie) drifts(m, w);
  for (int i = 0; i < m.ntie; ++i) {
    Tie<G>& t = w.ties[i];
    int begin = m.tie_ptr[i], end = m.tie_ptr[i + 1];
    if (m.tie_type[i] == kPolynomial) tie_lines(m, w, i, t);
    else tie_bodies(m, w, i, t);
    tie_law(m, o.h, i, t);
    tie_sway(m, w, i, t, t.sway);
    T pull[kRows];
    CMBRL_FOR(r, t.rows) {
      t.sway[r] *= o.h;
      pull[r] = t.stiff * t.r[r] + t.sway[r];
    }
    for (int k = begin; k < end; ++k) {
      T *column = w.tie_J + k * kRows, slow = (1.0 - t.carry) * w.v[m.tie_dof[k]];
      tie_column(m, w, i, t, k, column);
      CMBRL_FOR(r, t.rows) pull[r] += slow * column[r];
    }
    CMBRL_FOR(r, t.rows) pull[r] *= t.inv[r];
    for (int k = begin; k < end; ++k) {
      const T* column = w.tie_J + k * kRows;
      T share[kRows];
      CMBRL_FOR(r, t.rows) share[r] = column[r] * t.inv[r];
      CMBRL_FOR(r, t.rows) w.rhs[m.tie_dof[k]] -= column[r] * pull[r];
      Row<T> row(w.M, m.mass, m.tie_dof[k]);
      const int* columns = m.mass.columns(m.tie_dof[k]);
      CMBRL_FOR(r, t.rows) *row.diagonal += share[r] * column[r];
      for (int l = begin, x = 0; l < k; ++l, ++x) {
        while (columns[x] != m.tie_dof[l]) ++x;  // both rise
        T y = T{};
        CMBRL_FOR(r, t.rows) y += share[r] * w.tie_J[l * kRows + r];
        row.before[x] += y;
        row.mirror[x] += y;
      }
    }
  }
}

// Ties' part of Gq, Gv for a step from v to vn, whose M holds J^T J / R. v null: of the momentum -J^T J vn / R of an
// acceleration `vn` instead (late impulses), without Gv.
template <class G>
static void tie_terms(const Model& m, const Options& o, const Work<G>& w, const T* vn, const T* v, T* Gq, T* Gv) {
  constexpr int kRows = Tie<G>::kRows;
  int nv = m.nv;
  for (int i = 0; i < m.ntie; ++i) {
    const Tie<G>& t = w.ties[i];
    int begin = m.tie_ptr[i], end = m.tie_ptr[i + 1];
    T stiff = v ? t.stiff : T{}, dstiff = v ? t.dstiff : T{}, x[kRows];
    auto closing = [&](int k) {
      int d = m.tie_dof[k];
      return v ? vn[d] - t.carry * v[d] : vn[d];
    };
    CMBRL_FOR(r, t.rows) x[r] = v ? stiff * t.r[r] + t.sway[r] : T{};
    for (int k = begin; k < end; ++k) CMBRL_FOR(r, t.rows) x[r] += w.tie_J[k * kRows + r] * closing(k);
    CMBRL_FOR(r, t.rows) x[r] *= -t.inv[r];
    for (int l = begin; l < end; ++l) {  // by the coordinate of dof l
      int dl = m.tie_dof[l];
      const T* column = w.tie_J + l * kRows;
      T change[kRows], bend[kRows], gains[kRows] = {}, grows = T{};  // of the rows, by the velocity too; of the residual's size
      CMBRL_FOR(r, t.rows) grows += t.dsize[r] * column[r];
      CMBRL_FOR(r, t.rows) change[r] = stiff * column[r] + (dstiff * t.r[r] + t.dR / t.inv[r] * x[r]) * grows;
      if (v) {
        tie_sway_change(m, w, i, t, l, true, gains);
        tie_sway_change(m, w, i, t, l, false, bend);
        CMBRL_FOR(r, t.rows) {
          change[r] += o.h * bend[r];
          gains[r] = o.h * gains[r] + (1.0 - t.carry) * column[r];
        }
      }
      for (int k = begin; k < end; ++k) {
        tie_bend(m, w, i, t, k, l, bend);
        T turned = T{}, y = closing(k);
        CMBRL_FOR(r, t.rows) { turned += x[r] * bend[r]; change[r] += bend[r] * y; }
        Gq[m.tie_dof[k] * nv + dl] += turned;
      }
      for (int k = begin; k < end; ++k) {
        T q = T{}, back = T{};
        CMBRL_FOR(r, t.rows) {
          T held = w.tie_J[k * kRows + r] * t.inv[r];
          q += held * change[r];
          back += held * gains[r];
        }
        Gq[m.tie_dof[k] * nv + dl] -= q;
        if (v) Gv[m.tie_dof[k] * nv + dl] -= back;
      }
    }
  }
}

}  // namespace cmbrl::CMBRL_ISA
