// Control steps of a batch, and their derivatives, pack by pack.
#pragma once
#include "step/lanes.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G>
static void forward_pack(const Model& m, const Options& o, const Batch& b, const Lanes& l, Work<G>& w) {
  int nv = m.nv, ncol = 2 * nv + m.nu + int(b.nwanted);
  int64_t stride = tape_stride(m), impulses = m.ncontact * (1 + G::NT);
  Mask finite = gather_states(m, b, l, w);
  w.lanes = l.n;
  w.tried = o.again ? w.vstep : nullptr;  // it has no other use until the step is solved
  T unused = T{};
  if (w.tried) gather(b.v_next, nv, nv, l, w.tried, unused);
  for (int lane = 0; b.impulse && lane < l.n; ++lane) std::memset(b.impulse + l.at[lane] * impulses, 0, impulses * sizeof(double));
  auto record = [&](int s, Mask stepped) {
    double share = o.rk4 ? kStageWeight[s % kStages] : 1;
    if (b.impulse)
      for (int i = 0; i < w.ncon; ++i)
        for (int lane = 0; lane < l.n; ++lane) {
          const Contact<G>& c = w.con[i];
          double* x = b.impulse + l.at[lane] * impulses + c.of[lane] * (1 + G::NT);
          if (!c.on[lane]) continue;
          if (c.edge) { CMBRL_FOR(r, 1 + G::NT) x[r] += share * edge_impulse(c, r)[lane]; continue; }
          x[0] += share * c.gam[lane];
          for (int r = 1; r < c.rows && r <= G::NT; ++r)
            if (c.rub[lane]) x[r] += share * tangential_impulse(c, r)[lane];
        }
    if (!b.tape && !b.jacobian) return Recorded{all(), T{}};
    Recorded solved = solve_backward(m, o, w);
    if (!b.tape) return solved;
    double* block[W];
    for (int lane = 0; lane < W; ++lane) {
      bool last = o.last_attempt || (stepped & solved.done)[lane];  // else it is stepped, and written, again
      block[lane] = lane < l.n && last ? b.tape + (l.at[lane] * o.solves() + s) * stride : nullptr;
    }
    tape_write(m, w, block, *b.tape_rows);
    return solved;
  };
  StepStats st{none(), none(), none(), T{}, T{}, T{}, T{}};
  if (b.jacobian) unit_tangents(m, w);
  if (any(finite) && o.rk4) st = b.jacobian ? rk4_control_step_tangents(m, o, w, record) : rk4_control_step(m, o, w, record);
  else if (any(finite)) st = b.jacobian ? control_step_tangents(m, o, w, true, record) : control_step(m, o, w, record);
  if (b.jacobian) {
    int64_t half = int64_t(nv) * ncol;
    int before = 2 * nv + m.nu;
    for (int i = 0; i < nv; ++i) {
      scatter_row(b, w, w.tq + i * (before + w.np), before, 2 * half, l, b.jacobian + i * ncol);
      scatter_row(b, w, w.tv + i * (before + w.np), before, 2 * half, l, b.jacobian + half + i * ncol);
    }
  }
  T clean = T{};
  for (int i = 0; i < m.nq; ++i) clean += 0.0 * w.q[i];
  for (int i = 0; i < nv; ++i) clean += 0.0 * w.v[i];
  st.done &= finite & (clean == 0.0);
  scatter(w.q, m.nq, m.nq, l, b.q_next);
  scatter(w.v, nv, nv, l, b.v_next);
  for (int lane = 0; lane < l.n; ++lane) {
    int64_t i = l.at[lane];
    bool final = st.done[lane] || o.last_attempt || !finite[lane];
    b.status[i] = st.aside[lane] ? kCrowded : !final ? kUnsolved : !st.done[lane] ? 2 : st.missed[lane] ? kMissed : st.rung[lane] >= kSofter ? 1 : 0;
    b.iterations[i] = int32_t((st.aside[lane] ? st.rows : st.iterations)[lane]);
    b.rung[i] = int32_t(st.rung[lane]);
    b.residual[i] = st.residual[lane];
  }
  if (!any(~finite)) return;
  auto spoil_all = [&](int64_t n, double* out) { spoil(~finite, n, l, out); };
  spoil_all(m.nq, b.q_next);
  spoil_all(nv, b.v_next);
  spoil_all(1, b.residual);
  spoil_all(2 * nv * ncol, b.jacobian);
  spoil_all(impulses, b.impulse);
  spoil_all(stride * o.solves(), b.tape);
}

template <class G>
static void forward_packs(const Model& m, const Options& o, const Batch& b, const int64_t* elements, int64_t begin, int64_t end, StepMemory& memory) {
  Work<G> w = open<G>(m, b.jacobian ? Purpose::jacobian : Purpose::step, memory);
  want_parameters(m, w, b.wanted, b.nwanted);
  for (int64_t e = begin; e < end; e += W) {
    if (e > begin && o.stopped && o.stopped()) return;
    Lanes l = lanes_from(e, end, elements);
    gather_parameters(m, b, l, w, e == begin);
    forward_pack(m, o, b, l, w);
  }
}

template <class G>
static void backward_packs(const Model& m, const Options& o, const Batch& b, const int64_t* elements, int64_t begin, int64_t end, StepMemory& memory) {
  Work<G> w = open<G>(m, Purpose::product, memory);
  want_parameters(m, w, b.wanted, b.nwanted);
  int nv = m.nv;
  int64_t stride = tape_stride(m) * o.solves();
  for (int64_t e = begin; e < end; e += W) {
    if (e > begin && o.stopped && o.stopped()) return;
    Lanes l = lanes_from(e, end, elements);
    gather_parameters(m, b, l, w, e == begin);
    T clean = T{};
    gather(b.u, b.u_stride, m.nu, l, w.u, clean);
    gather(b.gq_next, nv, nv, l, w.lq, clean);
    gather(b.gv_next, nv, nv, l, w.lv, clean);
    for (int i = 0; i < m.nu; ++i) w.lu[i] = T{};
    const double* tape[W];
    for (int lane = 0; lane < W; ++lane) {
      tape[lane] = b.tape + l.at[lane] * stride;
      clean[lane] += 0.0 * tape[lane][0];  // NaN throughout after an input that was not finite
    }
    Mask finite = clean == 0.0;
    int good = first_of(finite);
    if (good >= 0) {
      if (any(~finite)) {
        for (int lane = 0; lane < W; ++lane) tape[lane] = tape[finite[lane] ? lane : good];
        copy_lane(~finite, good, m.nu, w.u);
      }
      if (o.rk4) rk4_control_step_backward(m, o, w, tape, *b.tape_rows);
      else control_step_backward(m, o, w, tape, *b.tape_rows);
    }
    scatter(w.lq, nv, nv, l, b.gq);
    scatter(w.lv, nv, nv, l, b.gv);
    scatter(w.lu, m.nu, m.nu, l, b.gu);
    scatter_row(b, w, w.lp, 0, b.nwanted, l, b.gtheta);
    spoil(~finite, nv, l, b.gq);
    spoil(~finite, nv, l, b.gv);
    spoil(~finite, m.nu, l, b.gu);
    spoil(~finite, b.nwanted, l, b.gtheta);
  }
}

}  // namespace cmbrl::CMBRL_ISA
