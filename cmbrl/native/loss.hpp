// The loss of parameter candidates on a log, one candidate a lane.
#pragma once
#include "lanes.hpp"

namespace cmbrl::CMBRL_ISA {

// A step of all lanes, with more rows where one that was left out closes.
template <class G>
static StepStats loss_step(const Model& m, const Options& o, Work<G>& w) {
  for (int i = 0; i < m.nq; ++i) w.start[i] = w.q[i];
  for (int i = 0; i < m.nv; ++i) w.start[m.nq + i] = w.v[i];
  Options now = o;
  for (;;) {
    StepStats st = control_step(m, now, w, [](int, Mask) { return Recorded{all(), T{}}; });
    if (!any(st.missed)) return st;
    now.prune = wider(now.prune);
    for (int i = 0; i < m.nq; ++i) w.q[i] = w.start[i];
    for (int i = 0; i < m.nv; ++i) w.v[i] = w.start[m.nq + i];
  }
}

// Open-loop Huber loss of one pack of candidates over all starts: lanes share the state, so they share the active set.
template <class G>
static void candidate_loss(const Model& m, const Options& o, const LossBatch& b, int64_t first, StepMemory& memory) {
  Work<G> w = open<G>(m, Purpose::step, memory);
  Lanes l = lanes_from(first, b.ncandidate);
  const double* theta[W];
  for (int lane = 0; lane < W; ++lane) theta[lane] = b.theta + l.at[lane] * m.ntheta;
  load_parameters(m, w, theta);
  auto huber = [&](T r) {
    T a = vabs(r);
    return select(a < b.huber, 0.5 * r * r, b.huber * (a - 0.5 * b.huber));
  };
  for (int64_t s = 0; s < b.nstart; ++s) {
    int64_t row = b.starts[s];
    T loss = T{};
    double clean = 0;  // NaN from an input that is not finite, and then so is the loss
    auto spread = [&](const double* x, int n, T* out) {
      for (int i = 0; i < n; ++i) { out[i] = splat(x[i]); clean += 0.0 * x[i]; }
    };
    spread(b.q + row * m.nq, m.nq, w.q);
    spread(b.v + row * m.nv, m.nv, w.v);
    for (int k = 0; k < b.horizon; ++k, ++row) {
      if (o.stopped && o.stopped()) return;
      spread(b.u + row * m.nu, m.nu, w.u);
      StepStats st = loss_step(m, o, w);
      const double *qn = b.q_next + row * m.nq, *vn = b.v_next + row * m.nv;
      for (int j = 0; j < m.njoint; ++j) {
        int a = m.jnt_qadr[j], d = m.jnt_vadr[j];
        if (m.jnt_type[j] != kBall) { loss += huber((w.q[a] - qn[a]) / b.scale_q[d]); continue; }
        T inverse[4] = {splat(qn[a]), splat(-qn[a + 1]), splat(-qn[a + 2]), splat(-qn[a + 3])}, e[4];
        quat_mul(inverse, w.q + a, e);  // rotation error as twice the vector part (small angles)
        CMBRL_FOR(r, 3) loss += huber(2.0 * select(e[0] < 0.0, -e[1 + r], e[1 + r]) / b.scale_q[d + r]);
      }
      for (int i = 0; i < m.nv; ++i) loss += huber((w.v[i] - vn[i]) / b.scale_v[i]);
      loss += clean;
      loss = select(st.done & (loss < 1e15), loss, loss + b.fail_penalty);
      loss = select(loss < 1e15, loss, splat(1e15));
    }
    for (int lane = 0; lane < l.n; ++lane) b.loss[l.at[lane] * b.loss_stride + s] = loss[lane];
  }
}

}  // namespace cmbrl::CMBRL_ISA
