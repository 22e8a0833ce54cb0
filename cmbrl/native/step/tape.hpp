// What the backward pass needs of a control step: per substep the state, the time of flight and where it goes (displacement, velocity), and the
// velocity and rows at the backward smoothing, from which everything else is computed again without a solve. One block of
// doubles per element, and a run of its own for the contacts that are on.
#pragma once
#include "step/flight.hpp"
#include "step/tape_rows.hpp"

namespace cmbrl::CMBRL_ISA {

// Number of the candidate and edge, gam, s, eta0, b and eta of as many rows as any has, which touch.
static inline int taped_contact_size(const Model& m) { return 5 + 2 * (m.most_rows - 1); }
template <class G>
constexpr int kTapedTouch = sizeof(Feature<G>) / sizeof(T);  // of hulls: to find it takes longer than all the rest; it follows the contacts

static inline int64_t tape_stride(const Model& m) {  // per substep; it ends with how many contacts there are, and where
  return m.nq + 4 * int64_t(m.nv) + 2 * m.nlimit + 3 * m.nline + 3;
}

static inline double taped_contacts(const Model& m, const double* tape) { return tape[tape_stride(m) - 2]; }

// Calls f(value, slot) for every number of the block that has a place in the workspace now.
template <class G, class F>
static void for_tape(const Model& m, Work<G>& w, F f) {
  int64_t k = 0;
  T* q = w.leapt ? w.began : w.q;  // where the step starts
  for (int i = 0; i < m.nq; ++i) f(q[i], k++, all());
  for (int i = 0; i < m.nv; ++i) f(w.v[i], k++, all());
  for (int i = 0; i < m.nv; ++i) f(w.vn[i], k++, all());
  for (int i = 0; i < m.nv; ++i) f(w.qtan[i], k++, all());
  for (int i = 0; i < m.nv; ++i) f(w.vstep[i], k++, all());
  for (int i = 0; i < w.nlim; ++i) { f(w.lim[i].gam, k + 2 * w.lim[i].index, w.lim[i].on); f(w.lim[i].s, k + 2 * w.lim[i].index + 1, w.lim[i].on); }
  k += 2 * m.nlimit;
  for (int i = 0; i < w.ndry; ++i) {
    DryFriction& d = w.dry[i];
    f(d.b, k + 3 * d.line, d.on); f(d.eta0, k + 3 * d.line + 1, d.on); f(d.eta, k + 3 * d.line + 2, d.on);
  }
  f(w.flown, k + 3 * m.nline, all());
}

// Calls f(value, slot) for the numbers of a contact in its run, but for that of candidate and edge.
template <class G, class F>
static void for_taped_contact(Contact<G>& c, F f) {
  f(c.gam, 1);
  f(c.s, 2);
  f(c.eta0, 3);
  CMBRL_FOR(r, c.rows - 1) { f(c.b[r], 4 + 2 * r); f(c.eta[r], 5 + 2 * r); }
}

// Calls f(value) for the numbers of a touch.
template <class G, class F>
static void for_touch(Feature<G>& touch, F f) {
  static_assert(sizeof(Feature<G>) % sizeof(T) == 0);
  for (int k = 0; k < kTapedTouch<G>; ++k) f(reinterpret_cast<T*>(&touch)[k]);
}
static inline bool of_hulls(const Model& m, int candidate) { return m.con_type[candidate] == kHulls; }

// Candidate and edge as one number.
template <class G>
static inline int taped_number(const Contact<G>& c, int lane) { return c.of[lane] * (1 + kEdges) + c.edge; }

// The order of a run: by group, then by number.
static inline bool comes_before(const Model& m, int a, int b) {
  int of_a = m.con_group[a / (1 + kEdges)], of_b = m.con_group[b / (1 + kEdges)];
  return of_a != of_b ? of_a < of_b : a < b;
}

// Writes the lanes that have a block.
template <class G>
static void tape_write(const Model& m, Work<G>& w, double* const* tape, TapeRows& rows) {
  int64_t n = tape_stride(m);
  for (int lane = 0; lane < W; ++lane)
    if (tape[lane]) std::memset(tape[lane], 0, n * sizeof(double));
  for_tape(m, w, [tape](T& x, int64_t slot, Mask on) {
    for (int lane = 0; lane < W; ++lane)
      if (tape[lane]) tape[lane][slot] = on[lane] ? x[lane] : 0;
  });
  for (int lane = 0; lane < W; ++lane) {
    if (!tape[lane]) continue;
    auto pushes = [&](const Contact<G>& c) { return c.on[lane] && c.gam[lane] > 0; };  // what failed may hold NaN
    int64_t count = 0, touches = 0;
    for (int i = 0; i < w.ncon; ++i) {
      if (!pushes(w.con[i])) continue;
      ++count;
      touches += of_hulls(m, w.con[i].of[lane]);
    }
    tape[lane][n - 2] = double(count);
    if (count == 0) continue;
    int size = taped_contact_size(m);
    double *run = rows.take(count * size + touches * kTapedTouch<G>, &tape[lane][n - 1]), *end = run, *touch = run + count * size;
    for (int i = 0; i < w.ncon; ++i) {
      if (!pushes(w.con[i])) continue;
      double *at = end, number = taped_number(w.con[i], lane);
      for (; at > run && comes_before(m, int(number), int(at[-size])); at -= size) std::memcpy(at, at - size, size * sizeof(double));
      at[0] = number;
      at[size - 1] = double((touch - run - count * size) / kTapedTouch<G>);
      if (of_hulls(m, w.con[i].of[lane])) for_touch(w.con[i].at, [&](T& x) { *touch++ = x[lane]; });
      for_taped_contact(w.con[i], [&](T& x, int slot) { at[slot] = x[lane]; });
      end += size;
    }
  }
}

// Where the contacts of each lane begin, and end: touches follow.
struct TapedRuns { const double *at[W], *end[W]; };

template <class G>
static TapedRuns taped_runs(const Model& m, const double* const* tape, const TapeRows& rows) {
  TapedRuns runs;
  int64_t n = tape_stride(m);
  for (int lane = 0; lane < W; ++lane) {
    int64_t count = int64_t(taped_contacts(m, tape[lane]));
    runs.at[lane] = count ? rows.at(tape[lane][n - 1]) : nullptr;
    runs.end[lane] = runs.at[lane] + count * taped_contact_size(m);
  }
  return runs;
}

// Lists the candidates that are on in some lane, as find_contacts goes through them: by group, then by number, then by edge.
// moved: touches are those of another place than where the step starts.
template <class G>
static void list_given(const Model& m, TapedRuns runs, bool moved, Work<G>& w) {
  w.ngiven = 0;
  for (;;) {
    int first = -1;
    for (int lane = 0; lane < W; ++lane) {
      if (runs.at[lane] == runs.end[lane]) continue;
      int i = int(*runs.at[lane]);
      if (first < 0 || comes_before(m, i, first)) first = i;
    }
    if (first < 0) return;
    Given row{first / (1 + kEdges), first % (1 + kEdges), none(), {}};
    for (int lane = 0; lane < W; ++lane) {
      if (runs.at[lane] == runs.end[lane] || int(*runs.at[lane]) != first) continue;
      row.on[lane] = -1;
      if (!moved) row.touch[lane] = runs.end[lane] + int64_t(runs.at[lane][taped_contact_size(m) - 1]) * kTapedTouch<G>;
      runs.at[lane] += taped_contact_size(m);
    }
    w.give(row);
  }
}

// What a lane's run, which is sorted, has of a number that is in it.
template <class G>
static const double* taped_contact(const Model& m, const double* run, const double* end, int number) {
  int size = taped_contact_size(m);
  int64_t low = 0, high = (end - run) / size - 1;
  while (low < high) {
    int64_t middle = (low + high) / 2;
    if (comes_before(m, int(run[middle * size]), number)) low = middle + 1;
    else high = middle;
  }
  return run + low * size;
}

// Restores (q, v, u given) the state, its rows and their solution.
template <class G>
static void tape_read(const Model& m, const Options& o, Work<G>& w, const double* const* tape, const TapeRows& rows) {
  w.nlim = w.ndry = 0;
  w.leapt = false;
  auto load_slot = [tape](T& x, int64_t slot, Mask on) {
    for (int lane = 0; lane < W; ++lane) if (on[lane]) x[lane] = tape[lane][slot];
  };
  for_tape(m, w, load_slot);
  int64_t limits = m.nq + 4 * int64_t(m.nv);
  for (int i = 0; i < m.nlimit; ++i)
    for (int lane = 0; lane < W; ++lane) w.lim_on[i][lane] = tape[lane][limits + 2 * i] > 0 ? -1 : 0;
  TapedRuns runs = taped_runs<G>(m, tape, rows);
  T flown = w.flown;
  list_given(m, runs, any(flown > 0.0), w);
  set_up_step(m, o, w, w.lim_on, &flown);
  for (int i = 0; i < w.ncon; ++i) {  // harmless values in the lanes that stay off
    Contact<G>& c = w.con[i];
    c.gam = c.s = splat(1);
    c.eta0 = splat(1);
    CMBRL_FOR(r, c.rows - 1) c.b[r] = c.eta[r] = T{};
    for (int lane = 0; lane < W; ++lane) {
      if (!c.on[lane]) continue;
      const double* run = taped_contact<G>(m, runs.at[lane], runs.end[lane], taped_number(c, lane));
      for_taped_contact(c, [&](T& x, int slot) { x[lane] = run[slot]; });
    }
  }
  for (int i = 0; i < w.nlim; ++i) w.lim[i].gam = w.lim[i].s = splat(1);
  for (int i = 0; i < w.ndry; ++i) { w.dry[i].b = w.dry[i].eta = T{}; w.dry[i].eta0 = splat(1); }
  for_tape(m, w, load_slot);
}

}  // namespace cmbrl::CMBRL_ISA
