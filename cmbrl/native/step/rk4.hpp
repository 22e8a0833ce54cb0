// Runge-Kutta steps of fourth order, as MuJoCo takes them: the contact solve at each of four stages gives an acceleration there,
//   a_i = (u_i - v_i)/h,   v_i = v + c_i h a_(i-1),   q_i = q (+) c_i h v_(i-1),   v' = v + h sum b_i a_i,   q' = q (+) h sum b_i v_i,
// in which nothing is implicit. A stage is a step of its own to the tape and to the derivative, whose products are chained here.
#pragma once
#include "step/control.hpp"
#include "dynamics/stages.hpp"

namespace cmbrl::CMBRL_ISA {

// Where a step starts, its stages' velocities, and what adds up over them; ncol tangents of these, or cotangents.
template <class G>
struct Stages {
  T *q, *v, *velocity, *sum_v, *sum_a;  // sum_a: of a_i h
  T *tq, *tv, *sum_tv, *sum_ta;
  T *lv, *lu, *lq0, *lv0;

  Stages(const Model& m, Work<G>& w, int64_t ncol) {
    int64_t nv = m.nv;
    Work<G>::carve(w.memory->stages, [&](Arena& A) {
      q = A.take<T>(m.nq); v = A.take<T>(nv); velocity = A.take<T>(kStages * nv); sum_v = A.take<T>(nv); sum_a = A.take<T>(nv);
      lv = A.take<T>(kStages * nv); lu = A.take<T>(kStages * nv); lq0 = A.take<T>(nv); lv0 = A.take<T>(nv);
      tq = A.take<T>(ncol * nv); tv = A.take<T>(ncol * nv); sum_tv = A.take<T>(ncol * nv); sum_ta = A.take<T>(ncol * nv);
    });
  }
};

// One step; moved(i) runs after stage i is solved, before the state moves on to the next stage, or to the end (then i is the last).
template <class G, class Record, class Moved>
static void rk4_step(const Model& m, const Options& o, Work<G>& w, Stages<G>& s, int step, StepStats& st, Record record, Moved moved) {
  int nv = m.nv;
  std::memcpy(s.q, w.q, m.nq * sizeof(T));
  std::memcpy(s.v, w.v, nv * sizeof(T));
  for (int i = 0; i < nv; ++i) s.sum_v[i] = s.sum_a[i] = T{};
  for (int k = 0; k < kStages; ++k) {
    solve_once(m, o, w, kStages * step + k, st, record);
    for (int i = 0; i < nv; ++i) {
      s.sum_v[i] += kStageWeight[k] * w.v[i];
      s.sum_a[i] += kStageWeight[k] * (w.vstep[i] - w.v[i]);
    }
    bool last = k + 1 == kStages;
    double next = last ? 1 : kStageAt[k + 1];
    scaled(m, last ? s.sum_v : w.v, next * o.h, w.qtan);
    moved(k);
    std::memcpy(w.q, s.q, m.nq * sizeof(T));
    integrate(m, w.q, w.qtan);
    for (int i = 0; i < nv; ++i) w.v[i] = s.v[i] + (last ? s.sum_a[i] : next * (w.vstep[i] - w.v[i]));
  }
}

template <class G, class Record>
static StepStats rk4_control_step(const Model& m, const Options& o, Work<G>& w, Record record) {
  StepStats st = no_stats();
  Stages<G> s(m, w, 0);
  for (int step = 0; step < o.substeps; ++step) {
    if (step % 16 == 15 && o.stopped && o.stopped()) break;
    rk4_step(m, o, w, s, step, st, record, [](int) {});
  }
  return st;
}

// The same with tangents of (q, v) in tq, tv, as in control_step_tangents.
template <class G, class Record>
static StepStats rk4_control_step_tangents(const Model& m, const Options& o, Work<G>& w, Record record) {
  int nv = m.nv, ncol = tangent_columns(w);
  StepStats st = no_stats();
  Stages<G> s(m, w, w.most_tangents);
  auto begin = [&] {
    std::memcpy(s.tq, w.tq, nv * ncol * sizeof(T));
    std::memcpy(s.tv, w.tv, nv * ncol * sizeof(T));
    for (int i = 0; i < nv * ncol; ++i) s.sum_tv[i] = s.sum_ta[i] = T{};
  };
  auto solve_stage = [&](int k, Mask stepped) {  // rhs_all: the tangents of u
    Recorded solved = record(k, stepped);
    implicit_system(m, o, w);
    int more = tangent_columns(w);
    for (T* x : {w.tq, w.tv, s.tq, s.tv, s.sum_tv, s.sum_ta}) widen(x, nv, ncol, more);
    ncol = more;
    w.below_H.fill(pattern_of(m, w), nv);
    auto carry = [&](int c, auto n, T* to) { carried<n>(m, w, {w.Gq, w.Gv, w.Gu, w.Gp, nullptr}, c, ncol, to); };
    solve_tangents(m, o, w, carry, carry, 0, ncol, ncol);
    return solved;
  };
  auto move = [&](int k) {
    bool last = k + 1 == kStages;
    double next = last ? 1 : kStageAt[k + 1];
    for (int i = 0; i < nv * ncol; ++i) {
      T a = w.rhs_all[i] - w.tv[i];
      s.sum_tv[i] += kStageWeight[k] * w.tv[i];
      s.sum_ta[i] += kStageWeight[k] * a;
      w.rhs_all[i] = s.tv[i] + (last ? s.sum_ta[i] : next * a);
      w.tq[i] = s.tq[i];
    }
    push_tangent(m, w.qtan, w.tq, last ? s.sum_tv : w.tv, splat(next * o.h), ncol);
    std::swap(w.tv, w.rhs_all);
  };
  for (int step = 0; step < o.substeps; ++step) {
    if (step % 16 == 15 && o.stopped && o.stopped()) break;
    begin();
    rk4_step(m, o, w, s, step, st, solve_stage, move);
  }
  return st;
}

// As control_step_backward.
template <class G>
static void rk4_control_step_backward(const Model& m, const Options& o, Work<G>& w, const double* const* tape, const TapeRows& rows) {
  int nv = m.nv;
  int64_t stride = tape_stride(m);
  first_columns(m, w);
  for (int k = 0; k < m.ntheta; ++k) w.lp[k] = T{};
  Stages<G> s(m, w, 0);
  const double* block[W];
  for (int step = o.substeps - 1; step >= 0; --step) {
    for (int i = 0; i < nv; ++i) s.sum_v[i] = s.lv0[i] = T{};
    for (int k = 0; k < kStages; ++k)
      for (int i = 0; i < nv; ++i) {
        T x{};
        for (int lane = 0; lane < W; ++lane) x[lane] = tape[lane][(kStages * step + k) * stride + m.nq + i];
        s.velocity[k * nv + i] = x;
        s.sum_v[i] += kStageWeight[k] * x;
      }
    scaled(m, s.sum_v, o.h, w.tmp);
    pull_cotangent(m, w.tmp, w.lq, s.lv0, splat(o.h));  // lv0: of the mean velocity, for now
    for (int k = 0; k < kStages; ++k)
      for (int i = 0; i < nv; ++i) {
        s.lu[k * nv + i] = kStageWeight[k] * w.lv[i];
        s.lv[k * nv + i] = kStageWeight[k] * (s.lv0[i] - w.lv[i]);
      }
    for (int i = 0; i < nv; ++i) { s.lq0[i] = w.lq[i]; s.lv0[i] = w.lv[i]; }
    for (int k = kStages - 1; k >= 0; --k) {
      for (int lane = 0; lane < W; ++lane) block[lane] = tape[lane] + (kStages * step + k) * stride;
      w.substep = kStages * step + k;
      tape_read(m, o, w, block, rows);
      set_kappa(m, o, w, o.backward);
      late_shift(m, o, w);
      implicit_system(m, o, w);
      T *of_u = s.lu + k * nv, *of_v = s.lv + k * nv;
      for (int i = 0; i < nv; ++i) { w.pvec[i] = of_u[i]; w.lq[i] = T{}; }
      solve_transposed(w.H, nv, pattern_of(m, w), w.pvec);
      for (int i = 0; i < nv; ++i) {
        T p = w.pvec[i];
        for (int j = 0; j < nv; ++j) { w.lq[j] += w.Gq[i * nv + j] * p; of_v[j] += w.Gv[i * nv + j] * p; }
        for (int j = 0; j < m.nu; ++j) w.lu[j] += w.Gu[i * m.nu + j] * p;
        for (int j = 0; j < w.np; ++j) w.lp[j] += w.Gp[i * w.np + j] * p;
      }
      if (k > 0) {
        double at = kStageAt[k];
        T *u_before = of_u - nv, *v_before = of_v - nv;
        scaled(m, s.velocity + (k - 1) * nv, at * o.h, w.tmp);
        pull_cotangent(m, w.tmp, w.lq, v_before, splat(at * o.h));
        for (int i = 0; i < nv; ++i) { u_before[i] += at * of_v[i]; v_before[i] -= at * of_v[i]; }
      }
      for (int i = 0; i < nv; ++i) { s.lq0[i] += w.lq[i]; s.lv0[i] += of_v[i]; }
    }
    for (int i = 0; i < nv; ++i) { w.lq[i] = s.lq0[i]; w.lv[i] = s.lv0[i]; }
  }
}

}  // namespace cmbrl::CMBRL_ISA
