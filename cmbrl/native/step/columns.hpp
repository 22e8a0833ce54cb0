// Which parameters a derivative has columns for: of those that are wanted, the ones that act without contacts from the start, and
// those of contacts once such a contact is there. The columns of the others are zero and stand nowhere.
#pragma once
#include "step/derivative.hpp"

namespace cmbrl::CMBRL_ISA {

constexpr int kUnwanted = -2, kWaiting = -1;  // in place of a column's number

template <class G>
static void want_parameters(const Model& m, Work<G>& w, const int64_t* wanted, int64_t count) {
  for (int k = 0; k < m.ntheta; ++k) w.column[k] = kUnwanted;
  for (int64_t i = 0; i < count; ++i) w.column[wanted[i]] = kWaiting;
}

template <class G>
static void add_column(Work<G>& w, int k) {
  w.column[k] = w.np;
  w.parameter[w.np++] = k;
}

// For a control step.
template <class G>
static void first_columns(const Model& m, Work<G>& w) {
  w.np = 0;
  for (int k = 0; k < m.ntheta; ++k) {
    if (w.column[k] == kUnwanted) continue;
    if (m.par_of_contacts[k]) w.column[k] = kWaiting;
    else add_column(w, k);
  }
}

// f(candidate, lanes) for each that some lane of a contact has.
template <class G, class F>
static void for_candidates(const Contact<G>& c, F f) {
  Mask rest = c.on | c.wide;
  for (int lane = 0; lane < W; ++lane) {
    if (!rest[lane]) continue;
    Mask same = none();
    for (int k = 0; k < W; ++k) same[k] = c.of[k] == c.of[lane] ? -1 : 0;
    rest &= ~same;
    f(c.of[lane], same);
  }
}

// Those of the contacts that are there.
template <class G>
static void more_columns(const Model& m, Work<G>& w) {
  for (int i = 0; i < w.ncon; ++i)
    for_candidates(w.con[i], [&](int j, Mask) {
      for (int e = m.con_par_ptr[j]; e < m.con_par_ptr[j + 1]; ++e)
        if (w.column[m.con_par[e]] == kWaiting) add_column(w, m.con_par[e]);
    });
}

template <class G>
static int columns_of_step(const Model& m, const Work<G>& w) { return 2 * m.nv + m.nu + w.np; }

template <class G>
static int tangent_columns(const Work<G>& w) { return w.nbefore + w.np; }

// Rows of `from` numbers become rows of `to`, with zeros behind.
static inline void widen(T* A, int rows, int from, int to) {
  if (from == to) return;
  for (int i = rows - 1; i >= 0; --i)
    for (int k = to - 1; k >= 0; --k) A[i * to + k] = k < from ? A[i * from + k] : T{};
}

}  // namespace cmbrl::CMBRL_ISA
