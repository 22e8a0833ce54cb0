// A control step (substeps with one control) of a pack: forward, with full Jacobian, with a tape, and backward from the tape.
#pragma once
#include "step/crowded.hpp"
#include "step/missed.hpp"
#include "step/tangents.hpp"
#include "step/tape.hpp"

namespace cmbrl::CMBRL_ISA {

static void scaled(const Model& m, const T* v, double k, T* out) {
  for (int i = 0; i < m.nv; ++i) out[i] = k * v[i];
}

struct Recorded { Mask done; T rung; };

// The step's rows solved again at the backward smoothing where it differs: the lanes that have a derivative there. vn and
// shift become those of that smoothing, which is what is differentiated; qtan and vstep stay where the state goes.
template <class G>
static Recorded solve_backward(const Model& m, const Options& o, Work<G>& w) {
  if (!o.backward_differs) return {all(), T{}};
  Outcome out = solve_smoothed(m, o, w, o.backward, true);
  late_shift(m, o, w);
  return {out.done, out.rung};
}

// missed: a row that was left out closes; aside: has many more rows than the others, and was not stepped.
struct StepStats { Mask done, missed, aside; T rows, rung, iterations, residual; };

// The k-th solve of a control step, from where w is; next velocity and displacement are left in w.
template <class G, class Record>
static void solve_once(const Model& m, const Options& o, Work<G>& w, int k, StepStats& st, Record record) {
  w.nguess = 0;
  w.substep = k;
  if (k > 0) w.tried = nullptr;
  if (k == 0 && o.set_aside) st.aside = set_up_uncrowded(m, o, w, st.rows);
  else set_up_step(m, o, w);
  Mask missed;
  Outcome r = solve_with_missed(m, o, w, k == 0 ? st.aside : none(), missed);
  st.done &= r.done;
  st.missed |= missed;
  st.rung = vmax(st.rung, r.rung);
  st.iterations += r.iterations;
  st.residual = vmax(st.residual, r.residual);
  displacement(m, o, w);
  Recorded kept = record(k, st.done & ~st.missed & ~st.aside);
  st.done &= kept.done;
  st.rung = vmax(st.rung, kept.rung);
}
static inline StepStats no_stats() { return {all(), none(), none(), T{}, T{}, T{}, T{}}; }

// Forward control step on (w.q, w.v, w.u), in place. record(solve, stepped) runs after each solve, before the state moves on;
// a step is done where what it records is. stepped: the lanes that need no other attempt so far.
template <class G, class Record>
static StepStats control_step(const Model& m, const Options& o, Work<G>& w, Record record) {
  StepStats st = no_stats();
  if (o.leapfrog) { scaled(m, w.v, 0.5 * o.h, w.qtan); integrate(m, w.q, w.qtan); }
  for (int s = 0; s < o.substeps; ++s) {
    if (s % 16 == 15 && o.stopped && o.stopped()) break;
    solve_once(m, o, w, s, st, record);
    integrate(m, w.q, w.qtan);
    for (int i = 0; i < m.nv; ++i) w.v[i] = w.vstep[i];
  }
  if (o.leapfrog) { scaled(m, w.v, -0.5 * o.h, w.qtan); integrate(m, w.q, w.qtan); }
  return st;
}

// The same with tangents of (q, v) in tq, tv (nv x tangent_columns); record leaves the rows solved at the backward smoothing.
// unit: they are the identity.
template <class G, class Record>
static StepStats control_step_tangents(const Model& m, const Options& o, Work<G>& w, bool unit, Record record) {
  int nv = m.nv, ncol = tangent_columns(w);
  if (o.leapfrog) { scaled(m, w.v, 0.5 * o.h, w.qtan); push_tangent(m, w.qtan, w.tq, w.tv, splat(0.5 * o.h), ncol); }
  StepStats st = control_step(m, o, w, [&](int s, Mask stepped) {
    Recorded solved = record(s, stepped);
    implicit_system(m, o, w);
    widen(w.tq, nv, ncol, tangent_columns(w));
    widen(w.tv, nv, ncol, tangent_columns(w));
    ncol = tangent_columns(w);
    advance_tangents(m, o, w, ncol, unit && s == 0);
    return solved;
  });
  if (o.leapfrog) push_tangent(m, w.qtan, w.tq, w.tv, splat(-0.5 * o.h), ncol);  // qtan: the shift just made
  return st;
}

// The tangents of a control step's start, by itself, its controls and parameters.
template <class G>
static void unit_tangents(const Model& m, Work<G>& w) {
  first_columns(m, w);
  int nv = m.nv, ncol = tangent_columns(w);
  for (int i = 0; i < nv * ncol; ++i) w.tq[i] = w.tv[i] = T{};
  for (int i = 0; i < nv; ++i) w.tq[i * ncol + i] = w.tv[i * ncol + nv + i] = splat(1);
}

// Through dqtan = h dv' - S(...): lq, lu, lp take their parts, lv that of v'; that of v waits in tv.
template <class G>
static void late_cotangents(const Model& m, const Options& o, Work<G>& w) {
  int nv = m.nv;
  T *along = w.tmp, *before = w.tv;
  for (int i = 0; i < nv; ++i) along[i] = before[i] = T{};
  pull_cotangent(m, w.qtan, w.lq, along, splat(1));
  if (w.leapt) through_leap(m, w, w.lq, before, w.lu, w.lp);
  for (int i = 0; i < nv; ++i) {
    w.lv[i] += o.h * along[i];
    for (int k = 0; k < nv; ++k) {
      w.lq[k] -= w.Sq[i * nv + k] * along[i];
      w.lv[k] -= w.Sn[i * nv + k] * along[i];
      before[k] -= w.Sv[i * nv + k] * along[i];
    }
    for (int k = 0; k < m.nu; ++k) w.lu[k] -= w.Su[i * m.nu + k] * along[i];
    for (int k = 0; k < w.np; ++k) w.lp[k] -= w.Sp[i * w.np + k] * along[i];
  }
}

// Through v' = u - y: lv becomes that of u; lq, lp take their parts, that of v waits in tv.
template <class G>
static void split_cotangents(const Model& m, Work<G>& w) {
  int nv = m.nv;
  T *y = w.pvec, *before = w.tv;
  for (int i = 0; i < nv; ++i) { y[i] = w.lv[i]; before[i] = T{}; }
  solve_transposed(w.K, nv, m.mass, y);
  for_drags(m, w, [&](int i, int k, T damping) { w.lv[k] -= damping * y[i]; });
  for (int i = 0; i < nv; ++i) {
    for (int k = 0; k < nv; ++k) { w.lq[k] -= w.Sq[i * nv + k] * y[i]; before[k] -= w.Sv[i * nv + k] * y[i]; }
    for (int k = 0; k < m.nu; ++k) w.lu[k] -= w.Su[i * m.nu + k] * y[i];
    for (int k = 0; k < w.np; ++k) w.lp[k] -= w.Sp[i * w.np + k] * y[i];
  }
}

// Cotangents (w.lq, w.lv) of the next state become those of the state; w.lu is added to; w.lp: by column.
template <class G>
static void control_step_backward(const Model& m, const Options& o, Work<G>& w, const double* const* tape, const TapeRows& rows) {
  int nv = m.nv;
  int64_t stride = tape_stride(m);
  first_columns(m, w);
  for (int k = 0; k < m.ntheta; ++k) w.lp[k] = T{};
  const double* block[W];
  for (int s = o.substeps - 1; s >= 0; --s) {
    for (int lane = 0; lane < W; ++lane) block[lane] = tape[lane] + s * stride;
    w.substep = s;
    tape_read(m, o, w, block, rows);
    if (o.leapfrog && s == o.substeps - 1) {
      scaled(m, w.vstep, -0.5 * o.h, w.tmp);
      pull_cotangent(m, w.tmp, w.lq, w.lv, splat(-0.5 * o.h));
    }
    set_kappa(m, o, w, o.backward);
    late_shift(m, o, w);
    implicit_system(m, o, w);
    if (w.late) late_cotangents(m, o, w);
    else pull_cotangent(m, w.qtan, w.lq, w.lv, splat(o.h));
    if (o.split) split_cotangents(m, w);
    solve_transposed(w.H, nv, pattern_of(m, w), w.lv);
    for (int i = 0; i < nv; ++i) { w.pvec[i] = w.lv[i]; w.lv[i] = w.late || o.split ? w.tv[i] : T{}; }
    for (int i = 0; i < nv; ++i)
      for (int k = 0; k < nv; ++k) {
        w.lq[k] += w.Gq[i * nv + k] * w.pvec[i];
        w.lv[k] += w.Gv[i * nv + k] * w.pvec[i];
      }
    for (int i = 0; i < nv; ++i)
      for (int k = 0; k < m.nu; ++k) w.lu[k] += w.Gu[i * m.nu + k] * w.pvec[i];
    for (int i = 0; i < nv; ++i)
      for (int k = 0; k < w.np; ++k) w.lp[k] += w.Gp[i * w.np + k] * w.pvec[i];
  }
  if (o.leapfrog) {  // the shift before the first step; its q is not needed, only the step h/2 v
    scaled(m, w.v, 0.5 * o.h, w.tmp);
    pull_cotangent(m, w.tmp, w.lq, w.lv, splat(0.5 * o.h));
  }
}

}  // namespace cmbrl::CMBRL_ISA
