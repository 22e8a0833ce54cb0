// A control step (substeps with one control) of a pack: forward, with full Jacobian, with a tape, and backward from the tape.
#pragma once
#include "step/crowded.hpp"
#include "step/impact.hpp"
#include "step/missed.hpp"
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

// dx = q dq + v dv + u du + p dtheta; q, v: with a pattern, or full.
struct Slopes { const T *q, *v, *u, *p; const Pattern* pattern; };

// What columns c to c + n move besides the state: parameters, and controls.
template <int n, class G>
static void add_own(const Model& m, const Work<G>& w, const Slopes& s, int c, T* out) {
  int input = c - (w.nbefore - m.nu), parameter = c - w.nbefore;
  for (int i = 0; parameter + n > 0 && i < m.nv; ++i)
    for (int j = parameter < 0 ? -parameter : 0; j < n; ++j) out[i * n + j] += s.p[i * w.np + parameter + j];
  if (!w.driven) {
    for (int i = 0; input + n > 0 && i < m.nv; ++i)
      for (int j = input < 0 ? -input : 0; j < n && parameter + j < 0; ++j) out[i * n + j] += s.u[i * m.nu + input + j];
    return;
  }
  input = c - (w.nbefore - w.ndriven);
  for (int i = 0; input + n > 0 && parameter < 0 && i < m.nv; ++i)
    for (int k = 0; k < m.nu; ++k)
      for (int j = input < 0 ? -input : 0; j < n && parameter + j < 0; ++j)
        out[i * n + j] += s.u[i * m.nu + k] * w.driven[k * w.ndriven + input + j];
}

// Columns c to c + n of dx by the tangents before the step, into out (nv x n). They are gathered first: rows of all columns lie
// far apart, and would drive each other out of the nearest cache.
template <int n, class G>
static void carried(const Model& m, const Work<G>& w, const Slopes& s, int c, int ncol, T* __restrict out) {
  int nv = m.nv;
  T *__restrict x = w.gathered, *__restrict y = x + nv * n;
  for (int i = 0; i < nv; ++i)
    CMBRL_FOR(j, n) { x[i * n + j] = w.tq[i * ncol + c + j]; y[i * n + j] = w.tv[i * ncol + c + j]; out[i * n + j] = T{}; }
  for (int i = 0; i < nv; ++i) {
    T sum[n];
    CMBRL_FOR(j, n) sum[j] = out[i * n + j];
    auto take = [&](int k) {
      T a = s.q[i * nv + k], b = s.v[i * nv + k];
      CMBRL_FOR(j, n) { sum[j] += a * x[k * n + j]; sum[j] += b * y[k * n + j]; }
    };
    auto give = [&](int k) {
      T a = s.q[k * nv + i], b = s.v[k * nv + i];
      CMBRL_FOR(j, n) { T to = out[k * n + j] + a * x[i * n + j]; out[k * n + j] = to + b * y[i * n + j]; }
    };
    if (s.pattern) {
      take(i);
      const int* columns = s.pattern->columns(i);
      for (int a = 0; a < s.pattern->count(i); ++a) { take(columns[a]); give(columns[a]); }
    } else {
      for (int k = 0; k < nv; ++k) take(k);
    }
    CMBRL_FOR(j, n) out[i * n + j] = sum[j];
  }
  add_own<n>(m, w, s, c, out);
}
template <class G>
static void carry_tangents(const Model& m, const Work<G>& w, const Slopes& s, T* out, int ncol) {
  for_blocks(ncol, [&](int c, auto n) {
    carried<n>(m, w, s, c, ncol, w.tangent_block);
    for (int i = 0; i < m.nv; ++i) CMBRL_FOR(j, n) out[i * ncol + c + j] = w.tangent_block[i * n + j];
  });
}

// tv <- dv' - (Sq dq + Sv dv + Su du + Sp dtheta + Sn dv') / h, from the tangents before the step and dv' in rhs_all; tq becomes
// the tangent of the place of impact.
template <class G>
static void late_tangents(const Model& m, const Options& o, Work<G>& w, int ncol) {
  int nv = m.nv;
  T *out = w.Z, *leap = w.Z + nv * ncol;  // scratch of the same width, free by now
  carry_tangents(m, w, {w.Sq, w.Sv, w.Su, w.Sp, nullptr}, out, ncol);
  for (int i = 0; i < nv; ++i)
    for (int k = 0; k < nv; ++k)
      for (int c = 0; c < ncol; ++c) out[i * ncol + c] += w.Sn[i * nv + k] * w.rhs_all[k * ncol + c];
  if (w.leapt) {
    carry_tangents(m, w, {w.Lq, w.Lv, w.Lu, w.Lp, nullptr}, leap, ncol);
    push_tangent(m, w.leap, w.tq, leap, splat(1), ncol);
  }
  for (int i = 0; i < nv * ncol; ++i) w.tv[i] = w.rhs_all[i] - out[i] * (1 / o.h);
}

// out = (Aq Av Au Ap).
template <class G>
static void columns_of(const Model& m, const Work<G>& w, const T* Aq, const T* Av, const T* Au, const T* Ap, T* out, int ncol) {
  int nv = m.nv, nu = m.nu;
  for (int i = 0; i < nv; ++i) {
    T* row = out + i * ncol;
    for (int k = 0; k < nv; ++k) { row[k] = Aq[i * nv + k]; row[nv + k] = Av[i * nv + k]; }
    for (int k = 0; k < nu; ++k) row[2 * nv + k] = Au[i * nu + k];
    for (int k = 0; k < w.np; ++k) row[2 * nv + nu + k] = Ap[i * w.np + k];
  }
}

// Columns of rhs_all from `first` on: H^-1 rhs, and what split damping makes of it,  dv' = du - dy,  where K dy = D du + late.
// rhs and late write columns c to c + n into an (nv x n) matrix.
template <class G, class Right, class Late>
static void solve_tangents(const Model& m, const Options& o, Work<G>& w, Right rhs, Late late, int first, int count, int ncol) {
  Pattern pat = pattern_of(m, w);
  int nv = m.nv;
  T *u = w.tangent_block, *y = u + nv * kBlock;
  for_blocks(count, [&](int c, auto size) {
    constexpr int n = size;
    rhs(c, size, u);
    solve_columns<n>(w.H, nv, pat, w.below_H, u, n);
    if (o.split) {
      late(c, size, y);
      for_drags(m, w, [&](int i, int k, T damping) { CMBRL_FOR(x, n) y[i * n + x] += damping * u[k * n + x]; });
      solve_columns<n>(w.K, nv, m.mass, w.below_K, y, n);
    }
    for (int i = 0; i < nv; ++i)
      CMBRL_FOR(x, n) w.rhs_all[i * ncol + first + c + x] = o.split ? u[i * n + x] - y[i * n + x] : u[i * n + x];
  });
}

// Columns of a matrix whose rows are `stride` apart; no data: zeros.
static inline auto columns_from(int nv, const T* data, int64_t stride) {
  return [=](int c, auto n, T* to) {
    for (int i = 0; i < nv; ++i)
      CMBRL_FOR(k, n) to[i * n + k] = data ? data[i * stride + c + k] : T{};
  };
}

// rhs_all = dv' of the first substep from the identity.
template <class G>
static void solve_first_tangents(const Model& m, const Options& o, Work<G>& w, int ncol) {
  int nv = m.nv, nu = m.nu;
  auto some = [&](const T* G_, const T* S, int first, int count) {
    solve_tangents(m, o, w, columns_from(nv, G_, count), columns_from(nv, S, count), first, count, ncol);
  };
  some(w.Gq, w.Sq, 0, nv);
  some(w.Gv, w.Sv, nv, nv);
  some(w.Gu, o.split ? w.Su : nullptr, 2 * nv, nu);
  some(w.Gp, w.Sp, 2 * nv + nu, w.np);
}

// Right-hand sides of a leapfrog's first substep, whose tangents are the identity shifted by h/2 v.
template <class G>
static void first_right_sides(const Model& m, const Options& o, Work<G>& w, int ncol) {
  int nv = m.nv;
  columns_of(m, w, w.Gq, w.Gv, w.Gu, w.Gp, w.rhs_all, ncol);
  for (int j = 0; j < m.njoint; ++j) {
    int d = m.jnt_vadr[j];
    if (m.jnt_type[j] != kBall) {
      for (int i = 0; i < nv; ++i) w.rhs_all[i * ncol + nv + d] += 0.5 * o.h * w.rhs_all[i * ncol + d];
      continue;
    }
    for (int i = 0; i < nv; ++i) {  // columns times d(q shifted)/d(q, v), kept in tq
      T* row = w.rhs_all + i * ncol;
      T old[3] = {row[d], row[d + 1], row[d + 2]};
      CMBRL_FOR(c, 3) {
        T a = T{}, b = T{};
        CMBRL_FOR(k, 3) { a += old[k] * w.tq[(d + k) * ncol + d + c]; b += old[k] * w.tq[(d + k) * ncol + nv + d + c]; }
        row[d + c] = a;
        row[nv + d + c] += b;
      }
    }
  }
}

// Columns: dq (nv), dv (nv), u (nu), then theta. tq, tv hold d(q, v)/d(columns) and are advanced by one step.
template <class G>
static void advance_tangents(const Model& m, const Options& o, Work<G>& w, int ncol, bool first) {
  Pattern pat = pattern_of(m, w);
  bool sparse = !w.early && !w.ahead;  // G has the pattern of the factor but for what looks at the free velocity
  auto carry = [&](const Slopes& s) { return [&m, &w, s, ncol](int c, auto n, T* to) { carried<n>(m, w, s, c, ncol, to); }; };
  auto late = carry({w.Sq, w.Sv, w.Su, w.Sp, &m.mass});
  w.below_H.fill(pat, m.nv);
  if (o.split) w.below_K.fill(m.mass, m.nv);
  if (first && !o.leapfrog) {
    solve_first_tangents(m, o, w, ncol);
  } else if (first) {
    first_right_sides(m, o, w, ncol);
    solve_tangents(m, o, w, columns_from(m.nv, w.rhs_all, ncol), late, 0, ncol, ncol);
  } else {
    solve_tangents(m, o, w, carry({w.Gq, w.Gv, w.Gu, w.Gp, sparse ? &pat : nullptr}), late, 0, ncol, ncol);
  }
  if (w.late) late_tangents(m, o, w, ncol);  // tv becomes the tangent of the displacement / h
  push_tangent(m, w.qtan, w.tq, w.late ? w.tv : w.rhs_all, splat(o.h), ncol);
  T* moved = w.tv;
  w.tv = w.rhs_all;
  w.rhs_all = moved;
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
