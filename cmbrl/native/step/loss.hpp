// The loss of parameter candidates on a log: candidates side by side in the lanes, and windows where there are few.
#pragma once
#include "step/lanes.hpp"

namespace cmbrl::CMBRL_ISA {

// A loss that grows no further, also of motion faster than any robot's [m/s, rad/s]: that explodes, and its solves are the dearest.
constexpr double kLost = 1e15, kFastest = 1e4;

// A step of all lanes, with more rows where one that was left out closes.
template <class G>
static StepStats loss_step(const Model& m, const Options& o, Work<G>& w) {
  for (int i = 0; i < m.nq; ++i) w.start[i] = w.q[i];
  for (int i = 0; i < m.nv; ++i) w.start[m.nq + i] = w.v[i];
  Options now = o;
  for (;;) {
    auto record = [](int, Mask) { return Recorded{all(), T{}}; };
    StepStats st = now.rk4 ? rk4_control_step(m, now, w, record) : control_step(m, now, w, record);
    if (!any(st.missed)) return st;
    now.prune = wider(now.prune);
    for (int i = 0; i < m.nq; ++i) w.q[i] = w.start[i];
    for (int i = 0; i < m.nv; ++i) w.v[i] = w.start[m.nq + i];
  }
}

// Which candidate and which window each lane has: few candidates leave lanes for windows side by side. Lanes too many repeat one.
struct Shared {
  int candidates, windows;
  int64_t first;
  Shared(const LossBatch& b, int64_t first_) : first(first_) {
    candidates = int(b.ncandidate - first < W ? b.ncandidate - first : W);
    windows = W / candidates;
  }
  int64_t candidate(int lane) const { return first + lane % candidates; }
  int64_t window(int lane, int64_t s, int64_t end) const {
    int beside = lane / candidates;
    if (beside >= windows) beside = windows - 1;
    return s + beside < end ? s + beside : end - 1;
  }
};

// Open-loop Huber losses of a pack of candidates over the windows [begin, end). Lanes of one window share the state, or nearly,
// so they share the active set.
template <class G>
static void candidate_loss(const Model& m, const Options& o, const LossBatch& b, int64_t first, int64_t begin, int64_t end, StepMemory& memory) {
  Work<G> w = open<G>(m, Purpose::step, memory);
  Shared shared(b, first);
  const double* theta[W];
  for (int lane = 0; lane < W; ++lane) theta[lane] = b.theta + shared.candidate(lane) * m.ntheta;
  load_parameters(m, w, theta);
  auto huber = [&](T r) {
    T a = vabs(r);
    return select(a < b.huber, 0.5 * r * r, b.huber * (a - 0.5 * b.huber));
  };
  for (int64_t s = begin; s < end; s += shared.windows) {
    T loss = T{}, clean = T{};  // clean: NaN from an input that is not finite: the loss is lost
    Lanes at{{}, W}, row{{}, W};
    for (int lane = 0; lane < W; ++lane) {
      int64_t window = shared.window(lane, s, end);
      at.at[lane] = shared.candidate(lane) * b.own + window;
      row.at[lane] = b.starts[window];
    }
    gather(b.q, m.nq, m.nq, at, w.q, clean);
    gather(b.v, m.nv, m.nv, at, w.v, clean);
    for (int k = 0; k < b.horizon; ++k) {
      if (o.stopped && o.stopped()) return;
      gather(b.u, m.nu, m.nu, row, w.u, clean);
      loss = select(clean == 0.0, loss, splat(kLost));
      Mask alive = loss < kLost;
      if (!any(alive)) break;
      if (any(~alive)) copy_state(m, ~alive, first_of(alive), w);
      StepStats st = loss_step(m, o, w);
      T *qn = w.start, *vn = w.start + m.nq, told = T{};
      gather(b.q_next, m.nq, m.nq, row, qn, told);
      gather(b.v_next, m.nv, m.nv, row, vn, told);
      for (int j = 0; j < m.njoint; ++j) {
        int a = m.jnt_qadr[j], d = m.jnt_vadr[j];
        if (m.jnt_type[j] != kBall) { loss += huber((w.q[a] - qn[a]) / b.scale_q[d]); continue; }
        T inverse[4] = {qn[a], -qn[a + 1], -qn[a + 2], -qn[a + 3]}, e[4];
        quat_mul(inverse, w.q + a, e);  // rotation error as twice the vector part (small angles)
        CMBRL_FOR(r, 3) loss += huber(2.0 * select(e[0] < 0.0, -e[1 + r], e[1 + r]) / b.scale_q[d + r]);
      }
      T fastest = T{};
      for (int i = 0; i < m.nv; ++i) {
        loss += huber((w.v[i] - vn[i]) / b.scale_v[i]);
        fastest = select(vabs(w.v[i]) < fastest, fastest, vabs(w.v[i]));
      }
      loss = select(fastest < kFastest, loss, splat(kLost));
      loss += clean + told;
      loss = select(st.done & (loss < kLost), loss, loss + b.fail_penalty);
      loss = select(loss < kLost, loss, splat(kLost));
      for (int lane = 0; lane < W; ++lane) ++row.at[lane];
    }
    for (int lane = 0; lane < W; ++lane) b.loss[shared.candidate(lane) * b.nstart + shared.window(lane, s, end)] = loss[lane];
  }
}

}  // namespace cmbrl::CMBRL_ISA
