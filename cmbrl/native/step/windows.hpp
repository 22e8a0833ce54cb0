// Open-loop predictions of windows of a log, side by side in the lanes, with their derivatives: one chain of tangents along a window,
// so that no step's own Jacobian is ever formed. What is asked for are some rows of them, a column at a time.
#pragma once
#include "step/lanes.hpp"

namespace cmbrl::CMBRL_ISA {

// Tangents along a window; where a control step starts, to go back to.
template <class G>
struct Along {
  T *tq, *tv, *driven, *q, *v;
  int* place;   // of each parameter among those that are wanted
  Mask* told;   // lanes in which its column is not zero throughout

  Along(const Model& m, const WindowBatch& b, Work<G>& w) {
    int64_t nv = m.nv, ncol = b.nbefore + m.ntheta;
    if (ncol > w.most_tangents) w.most_tangents = ncol;
    Work<G>::carve(w.memory->window, [&](Arena& A) {
      for (T** x : {&w.tq, &w.tv, &w.rhs_all, &tq, &tv}) *x = A.take<T>(nv * ncol);
      driven = A.take<T>((m.nu + 1) * (b.ndriven + 1));
      q = A.take<T>(m.nq); v = A.take<T>(nv);
      place = A.take<int>(m.ntheta + 1); told = A.take<Mask>(m.ntheta + 1);
    });
    for (int64_t i = 0; i < b.nwanted; ++i) place[b.wanted[i]] = int(i);
    w.nbefore = int(b.nbefore);
    w.driven = driven;
    w.ndriven = int(b.ndriven);
  }

  void keep(const Model& m, const Work<G>& w) {
    int64_t size = int64_t(m.nv) * tangent_columns(w) * sizeof(T);
    std::memcpy(tq, w.tq, size);
    std::memcpy(tv, w.tv, size);
    std::memcpy(q, w.q, m.nq * sizeof(T));
    std::memcpy(v, w.v, m.nv * sizeof(T));
  }
  void go_back(const Model& m, Work<G>& w, int ncol) const {  // to `ncol` columns; later ones are zero there
    int64_t size = int64_t(m.nv) * ncol * sizeof(T);
    std::memcpy(w.tq, tq, size);
    std::memcpy(w.tv, tv, size);
    widen(w.tq, m.nv, ncol, tangent_columns(w));
    widen(w.tv, m.nv, ncol, tangent_columns(w));
    std::memcpy(w.q, q, m.nq * sizeof(T));
    std::memcpy(w.v, v, m.nv * sizeof(T));
  }
};

template <class G>
static void begin_window(const Model& m, const WindowBatch& b, Work<G>& w) {
  first_columns(m, w);
  int nv = m.nv, ncol = tangent_columns(w);
  for (int i = 0; i < nv; ++i)
    for (int c = 0; c < ncol; ++c) {
      bool begun = c < b.nbefore;
      w.tq[i * ncol + c] = splat(begun ? b.begun[i * b.nbefore + c] : 0);
      w.tv[i * ncol + c] = splat(begun ? b.begun[(nv + i) * b.nbefore + c] : 0);
    }
}

// A control step of all lanes, again with more rows where one that was left out closes.
template <class G>
static void step_along(const Model& m, const Options& o, Work<G>& w, Along<G>& along) {
  int ncol = tangent_columns(w);
  along.keep(m, w);
  Options now = o;
  for (;;) {
    auto record = [&](int, Mask) { return solve_backward(m, now, w); };
    StepStats st = now.rk4 ? rk4_control_step_tangents(m, now, w, record) : control_step_tangents(m, now, w, false, record);
    if (!any(st.missed)) return;
    now.prune = wider(now.prune);
    along.go_back(m, w, ncol);
  }
}

// What step k of the windows ends with; NaN in lanes that are lost. known: parameters that had columns before.
template <class G>
static void write_window(const Model& m, const WindowBatch& b, const Lanes& l, int k, Mask sound, int known, Along<G>& along, Work<G>& w) {
  int ncol = tangent_columns(w);
  T nan = splat(__builtin_nan(""));
  Lanes at = l;
  for (int lane = 0; lane < W; ++lane) at.at[lane] = l.at[lane] * b.horizon + k;
  auto values = [&](const T* x, int n, double* out) { scatter_each([&](int64_t i) { return select(sound, x[i], nan); }, n, n, at, out); };
  values(w.q, m.nq, b.q_next);
  values(w.v, m.nv, b.v_next);
  int64_t column = b.horizon * b.nrow, window = (b.nbefore + b.nwanted) * column;
  for (int c = 0; c < ncol; ++c) {
    int64_t place = c < b.nbefore ? c : b.nbefore + along.place[w.parameter[c - b.nbefore]];
    double* out = b.tangents + place * column;
    if (c >= b.nbefore + known)
      for (int lane = 0; lane < l.n; ++lane) std::memset(out + l.at[lane] * window, 0, k * b.nrow * sizeof(double));
    auto read = [&](int64_t i) {
      int64_t row = b.rows[i];
      return select(sound, row < m.nv ? w.tq[row * ncol + c] : w.tv[(row - m.nv) * ncol + c], nan);
    };
    scatter_each(read, window, b.nrow, l, out + k * b.nrow);
    for (int64_t i = 0; c >= b.nbefore && i < b.nrow; ++i) along.told[c - b.nbefore] |= read(i) != 0.0;
  }
}

template <class G>
static void window_pack(const Model& m, const Options& o, const WindowBatch& b, const Lanes& l, Along<G>& along, Work<G>& w) {
  Lanes row{{}, W};
  T clean = T{};
  for (int lane = 0; lane < W; ++lane) row.at[lane] = b.starts[l.at[lane]];
  gather(b.q, m.nq, m.nq, l, w.q, clean);
  gather(b.v, m.nv, m.nv, l, w.v, clean);
  begin_window(m, b, w);
  for (int p = 0; p < m.ntheta; ++p) along.told[p] = none();
  int known = w.np;
  for (int k = 0; k < b.horizon; ++k) {
    if (o.stopped && o.stopped()) return;
    gather(b.u, m.nu, m.nu, row, w.u, clean);
    gather(b.driven, m.nu * b.ndriven, int(m.nu * b.ndriven), row, along.driven, clean);
    Mask sound = clean == 0.0;
    int good = first_of(sound);
    if (good >= 0) {
      if (any(~sound)) copy_state(m, ~sound, good, w);
      step_along(m, o, w, along);
      for (int i = 0; i < m.nq; ++i) clean += 0.0 * w.q[i];
      for (int i = 0; i < m.nv; ++i) clean += 0.0 * w.v[i];
      sound &= clean == 0.0;
    }
    write_window(m, b, l, k, sound, known, along, w);
    known = w.np;
    for (int lane = 0; lane < W; ++lane) ++row.at[lane];
  }
  for (int lane = 0; lane < l.n; ++lane) {
    uint8_t* told = b.told + l.at[lane] * b.nwanted;
    std::memset(told, 0, b.nwanted);
    for (int p = 0; p < w.np; ++p) told[along.place[w.parameter[p]]] = along.told[p][lane] != 0;
  }
}

template <class G>
static void window_packs(const Model& m, const Options& o, const WindowBatch& b, int64_t begin, int64_t end, StepMemory& memory) {
  Work<G> w = open<G>(m, Purpose::product, memory);
  const double* theta[W];
  for (int lane = 0; lane < W; ++lane) theta[lane] = b.theta;
  want_parameters(m, w, b.wanted, b.nwanted);
  load_parameters(m, w, theta);
  Along<G> along(m, b, w);
  for (int64_t e = begin; e < end; e += W) window_pack(m, o, b, lanes_from(e, end, nullptr), along, w);
}

}  // namespace cmbrl::CMBRL_ISA
