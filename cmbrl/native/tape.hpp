// What the backward pass needs of a control step: per substep the state, the time of flight and where it goes (displacement, velocity), and the
// velocity and rows at the backward smoothing, from which everything else is computed again without a solve. One block of
// doubles per element.
#pragma once
#include "flight.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G>
static int64_t tape_stride(const Model& m) {  // per substep
  return m.nq + 4 * int64_t(m.nv) + m.ncontact * (3 + 2 * G::NT) + 2 * m.nlimit + 3 * m.nline + 1;
}

// Calls f(value, slot) for every number of the tape that has a place in the workspace now.
template <class G, class F>
static void for_tape(const Model& m, Work<G>& w, F f) {
  int64_t k = 0;
  T* q = w.leapt ? w.began : w.q;  // where the step starts
  for (int i = 0; i < m.nq; ++i) f(q[i], k++, all());
  for (int i = 0; i < m.nv; ++i) f(w.v[i], k++, all());
  for (int i = 0; i < m.nv; ++i) f(w.vn[i], k++, all());
  for (int i = 0; i < m.nv; ++i) f(w.qtan[i], k++, all());
  for (int i = 0; i < m.nv; ++i) f(w.vstep[i], k++, all());
  int per = 3 + 2 * G::NT;
  for (int i = 0; i < w.ncon; ++i) {
    Contact<G>& c = w.con[i];
    int64_t s = k + int64_t(c.index) * per;
    f(c.gam, s, c.on);
    f(c.s, s + 1, c.on);
    f(c.eta0, s + 2, c.on);
    CMBRL_FOR(r, G::NT) { f(c.b[r], s + 3 + r, c.on); f(c.eta[r], s + 3 + G::NT + r, c.on); }
  }
  k += int64_t(m.ncontact) * per;
  for (int i = 0; i < w.nlim; ++i) { f(w.lim[i].gam, k + 2 * w.lim[i].index, w.lim[i].on); f(w.lim[i].s, k + 2 * w.lim[i].index + 1, w.lim[i].on); }
  k += 2 * m.nlimit;
  for (int i = 0; i < w.ndry; ++i) {
    DryFriction& d = w.dry[i];
    f(d.b, k + 3 * d.line, d.on); f(d.eta0, k + 3 * d.line + 1, d.on); f(d.eta, k + 3 * d.line + 2, d.on);
  }
  f(w.flown, k + 3 * m.nline, all());
}

template <class G>
static void tape_write(const Model& m, Work<G>& w, double* const* tape) {
  int64_t n = tape_stride<G>(m);
  for (int lane = 0; lane < W; ++lane) std::memset(tape[lane], 0, n * sizeof(double));
  for_tape(m, w, [tape](T& x, int64_t slot, Mask on) {
    for (int lane = 0; lane < W; ++lane) tape[lane][slot] = on[lane] ? x[lane] : 0;
  });
}

// Restores (q, v, u given) the state, its rows and their solution; impulses of rows that were off read as zero there.
template <class G>
static void tape_read(const Model& m, const Options& o, Work<G>& w, const double* const* tape) {
  w.ncon = w.nlim = w.ndry = 0;
  w.leapt = false;
  auto load_slot = [tape](T& x, int64_t slot, Mask on) {
    for (int lane = 0; lane < W; ++lane) if (on[lane]) x[lane] = tape[lane][slot];
  };
  for_tape(m, w, load_slot);
  int64_t contacts = m.nq + 4 * int64_t(m.nv), limits = contacts + m.ncontact * (3 + 2 * G::NT);
  for (int i = 0; i < m.ncontact; ++i)
    for (int lane = 0; lane < W; ++lane) w.con_on[i][lane] = tape[lane][contacts + i * (3 + 2 * G::NT)] > 0 ? -1 : 0;
  for (int i = 0; i < m.nlimit; ++i)
    for (int lane = 0; lane < W; ++lane) w.lim_on[i][lane] = tape[lane][limits + 2 * i] > 0 ? -1 : 0;
  T flown = w.flown;
  set_up_step(m, o, w, w.con_on, w.lim_on, &flown);
  for (int i = 0; i < w.ncon; ++i) {  // harmless values in the lanes that stay off
    Contact<G>& c = w.con[i];
    c.gam = c.s = splat(1);
    c.eta0 = splat(1);
    CMBRL_FOR(r, G::NT) c.b[r] = c.eta[r] = T{};
  }
  for (int i = 0; i < w.nlim; ++i) w.lim[i].gam = w.lim[i].s = splat(1);
  for (int i = 0; i < w.ndry; ++i) { w.dry[i].b = w.dry[i].eta = T{}; w.dry[i].eta0 = splat(1); }
  for_tape(m, w, load_slot);
}

}  // namespace cmbrl::CMBRL_ISA
