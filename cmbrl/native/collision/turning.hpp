// Torsional and rolling friction (condim 4 and 6): a contact pushes against turning, too, about its normal and its tangents, with
// moments up to a coefficient [m] times the normal force. A round cone has them as further rows, scaled by coefficient / mu, so
// that one circle bounds all of friction, and MuJoCo's softness of them is that of sliding. In the plane a contact turns about
// one axis alone, which is a tangent.
#pragma once
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

// What row 1 + NT + k turns about, given the normal and the tangents; and how that axis turns, given how those do. Which of the two
// coefficients [m] it has: about the normal (0), about a tangent (1).
static inline Vec<1> turning_axis(const Planar&, const Vec<2>*, int) { return {{splat(1)}}; }
static inline Vec<1> turning_axis_shift(const Planar&, const Vec<2>*, int) { return {{T{}}}; }
static inline int turning_kind(const Planar&, int) { return 1; }
static inline Vec<3> turning_axis(const Spatial&, const Vec<3>* d, int k) { return d[k]; }
static inline Vec<3> turning_axis_shift(const Spatial&, const Vec<3>* dd, int k) { return dd[k]; }
static inline int turning_kind(const Spatial&, int k) { return k > 0; }

static inline int field_of_turning(int kind) { return kind == 0 ? kSpin : kRoll; }

// The wrenches of the rows that turn, of a contact that has its directions. The second tangent has the length of its ratio.
template <class G>
static void turning_rows(const Model& m, Contact<G>& c, const T* p) {
  const double* ratio = m.con_ratio + 2 * c.index;
  for (int r = 1 + G::NT; r < c.rows; ++r) {
    int k = r - 1 - G::NT;
    c.arm[k] = keep(c.rub, p[field_of_turning(turning_kind(G{}, k))] / c.mu);
    if (c.skewed && k == 2) c.arm[k] *= ratio[1] / ratio[0];
    c.Wr[r] = c.arm[k] * join<G>(turning_axis(G{}, c.d, k), zero<G::D>());
  }
}

// How the row's wrench changes with the directions of its contact.
template <class G>
static Vec<G::N> turning_shift(const Contact<G>& c, const typename G::V* dd, int row) {
  int k = row - 1 - G::NT;
  return c.arm[k] * join<G>(turning_axis_shift(G{}, dd, k), zero<G::D>());
}

// How it grows with a field of P: with its coefficient, and less with mu. Relative.
template <class G>
static T turning_growth(const Contact<G>& c, int row, int field) {
  if (row <= G::NT) return T{};
  int own = field_of_turning(turning_kind(G{}, row - 1 - G::NT));
  return keep(c.rub, (field == own ? 1.0 / c.P[own] : T{}) - (field == kMu ? 1.0 / c.full_mu : T{}));
}

}  // namespace cmbrl::CMBRL_ISA
