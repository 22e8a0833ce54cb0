// What a tie is off, and how its rows respond to the dofs that it couples: residual r, columns of J, and how these bend.
#pragma once
#include "collision/law.hpp"
#include "dynamics/lines.hpp"

namespace cmbrl::CMBRL_ISA {

static inline Planar::Ang in_frame(const Planar::Rot&, const Planar::Ang& a) { return a; }
static inline Spatial::Ang in_frame(const Spatial::Rot& R, const Spatial::Ang& a) { return Spatial::unrotate(R, a); }

// A rotation by half its angle: cosine and sine times the axis, of either sign; from the largest of the four, so that none is
// the quotient of two small numbers.
static inline void half_turn(const Planar::Rot& R, T& w, Planar::Ang& v) {
  Mask small = R.c >= 0.0;
  T large = vsqrt(0.5 * (1.0 + vabs(R.c))), other = 0.5 * R.s / large;
  w = select(small, large, other);
  v[0] = select(small, other, large);
}
static inline void half_turn(const Spatial::Rot& R, T& w, Spatial::Ang& v) {
  const T* m = R.m;
  T square[4] = {1.0 + m[0] + m[4] + m[8], 1.0 + m[0] - m[4] - m[8], 1.0 - m[0] + m[4] - m[8], 1.0 - m[0] - m[4] + m[8]};
  T x = m[7] - m[5], y = m[2] - m[6], z = m[3] - m[1], xy = m[1] + m[3], xz = m[2] + m[6], yz = m[5] + m[7];
  T rows[4][4] = {{square[0], x, y, z}, {x, square[1], xy, xz}, {y, xy, square[2], yz}, {z, xz, yz, square[3]}};  // 4 a_i a_j
  T largest = square[0], a[4] = {rows[0][0], rows[0][1], rows[0][2], rows[0][3]};
  for (int i = 1; i < 4; ++i) {
    Mask more = square[i] > largest;
    largest = select(more, square[i], largest);
    CMBRL_FOR(k, 4) a[k] = select(more, rows[i][k], a[k]);
  }
  T scale = 0.5 / vsqrt(largest);
  w = scale * a[0];
  CMBRL_FOR(k, 3) v[k] = scale * a[1 + k];
}

// What the law asks of a tie whose residual is r. All its rows have the softness of the residual's size.
template <class G>
static void tie_law(const Model& m, double h, int i, Tie<G>& t) {
  const double *s = m.tie_soft + 7 * i, *weight = m.tie_invweight + 2 * i;
  T square = T{}, d, dd, K, B;
  CMBRL_FOR(k, t.rows) square += t.r[k] * t.r[k];
  T size = vsqrt(square), inv = 1.0 / vmax(size, splat(1e-300));
  impedance(-size, splat(s[2]), splat(s[3]), splat(s[4]), s[5], s[6], d, dd);
  stiffness_damping(splat(s[0]), splat(s[1]), splat(s[3]), m.least_time(h), K, B);
  t.stiff = h * K * d;
  t.dstiff = -h * K * dd;
  t.dR = dd / (d * (1.0 - d));  // of R, relative, by the residual's size; dd is by its negative
  t.carry = 1.0 - h * B;
  CMBRL_FOR(k, t.rows) {
    t.dsize[k] = inv * t.r[k];
    t.inv[k] = 1.0 / vmax((1.0 - d) / d * weight[k >= G::D], splat(1e-15));
  }
}

// r = x_A - ref_A - p(x_B - ref_B) of the lengths of two lines.
template <class G>
static void tie_lines(const Model& m, const Work<G>& w, int i, Tie<G>& t) {
  const double *p = m.tie_poly + 5 * i, *ref = m.tie_ref + 2 * i;
  T x = T{}, value = T{}, bend = T{};
  t.slope = T{};
  if (m.tie_B[i] >= 0) x = w.line_length[m.tie_B[i]] - ref[1];
  for (int k = 4; k >= 0; --k) {  // Horner's rule, with both derivatives
    bend = bend * x + 2.0 * t.slope;
    t.slope = t.slope * x + value;
    value = value * x + p[k];
  }
  t.bend = bend;
  t.rows = 1;
  t.r[0] = w.line_length[m.tie_A[i]] - ref[0] - value;
}

// Where a body holds its end of a tie.
template <class G> struct Hold { typename G::V at; typename G::Rot turned; };
template <class G>
static Hold<G> hold_of(const Work<G>& w, int body, const double* pos, const double* rot) {
  typename G::Rot R = G::load_rot(rot);
  return {place_of(w, body, pos), body < 0 ? R : G::compose(w.R[body], R)};
}

// r = a - b of the points that two bodies hold; of a weld also the sine of half the angle between the frames, seen in that of B.
template <class G>
static void tie_bodies(const Model& m, const Work<G>& w, int i, Tie<G>& t) {
  constexpr int kRot = G::D == 2 ? 2 : 9;
  Hold<G> a = hold_of(w, m.tie_A[i], m.tie_posA + i * G::D, m.tie_rotA + i * kRot);
  Hold<G> b = hold_of(w, m.tie_B[i], m.tie_posB + i * G::D, m.tie_rotB + i * kRot);
  t.a = a.at;
  t.b = b.at;
  CMBRL_FOR(k, G::D) t.r[k] = a.at[k] - b.at[k];
  t.rows = G::D;
  if (m.tie_type[i] != kWeld) return;
  t.rows = G::D + G::A;
  t.turned = b.turned;
  half_turn(G::compose(G::inverse(b.turned), a.turned), t.w, t.v);
  CMBRL_FOR(k, G::A) t.r[G::D + k] = m.tie_scale[i] * t.v[k];
}

// How the rows of half an angle respond to a turn of A against B.
template <class G>
static typename G::Ang half_rate(const Tie<G>& t, double scale, const typename G::Ang& turn) {
  typename G::Ang u = in_frame(t.turned, turn);
  return (0.5 * scale) * (t.w * u - G::cross_ang(t.v, u));
}

template <class G> static T covector_at(const Work<G>& w, int entry) { return entry < 0 ? T{} : w.line_c[entry]; }

// Column of J of one of the dofs that a tie couples.
template <class G>
static void tie_column(const Model& m, const Work<G>& w, int i, const Tie<G>& t, int k, T* column) {
  int d = m.tie_dof[k], side = m.tie_side[k];
  if (m.tie_type[i] == kPolynomial) {
    column[0] = covector_at(w, m.tie_entryA[k]) - t.slope * covector_at(w, m.tie_entryB[k]);
    return;
  }
  typename G::V u = zero<G::D>();
  if (side & kCarriesA) u += point_velocity<G>(w.S[d], t.a);
  if (side & kCarriesB) u -= point_velocity<G>(w.S[d], t.b);
  CMBRL_FOR(r, G::D) column[r] = u[r];
  if (t.rows == G::D) return;
  typename G::Ang turn = zero<G::A>();  // what carries both turns neither against the other
  if (side != (kCarriesA | kCarriesB)) turn = half_rate(t, m.tie_scale[i], ang<G>(w.S[d]));
  CMBRL_FOR(r, G::A) column[G::D + r] = side == kCarriesB ? -turn[r] : turn[r];
}

// The change of column k of J with the l-th of the tie's dofs. The farther out of two dofs in a chain is moved by the other one.
template <class G>
static void tie_bend(const Model& m, const Work<G>& w, int i, const Tie<G>& t, int k, int l, T* bend) {
  int dk = m.tie_dof[k], dl = m.tie_dof[l], both = m.tie_side[k] & m.tie_side[l];
  if (m.tie_type[i] == kPolynomial) {
    bend[0] = -(covector_at(w, m.tie_entryB[k]) * covector_at(w, m.tie_entryB[l])) * t.bend;
    auto add = [&](int line, int at_k, int at_l, T scale) {
      if (at_k >= 0 && at_l >= 0 && bends(m, line)) bend[0] += scale * bend_of(m, w, line, at_k, at_l);
    };
    add(m.tie_A[i], m.tie_entryA[k], m.tie_entryA[l], splat(1));
    add(m.tie_B[i], m.tie_entryB[k], m.tie_entryB[l], -t.slope);
    return;
  }
  bool moved = dk > dl || m.dof_jnt[dk] == m.dof_jnt[dl];
  int outer = moved ? dl : dk, inner = moved ? dk : dl;
  typename G::Ang turn = ang<G>(w.S[outer]);
  typename G::V u = zero<G::D>();
  if (both & kCarriesA) u += G::turn(turn, point_velocity<G>(w.S[inner], t.a));
  if (both & kCarriesB) u -= G::turn(turn, point_velocity<G>(w.S[inner], t.b));
  CMBRL_FOR(r, G::D) bend[r] = u[r];
  if (t.rows == G::D) return;
  constexpr int kCarriesBoth = kCarriesA | kCarriesB;
  double scale = m.tie_scale[i];
  typename G::Ang x = ang<G>(w.S[outer]), y = ang<G>(w.S[inner]), out = zero<G::A>();
  if (m.tie_side[k] != kCarriesBoth && m.tie_side[l] != kCarriesBoth) {
    bool swap = both == kCarriesB || (!both && m.tie_side[dk == outer ? k : l] == kCarriesA);  // B first
    typename G::Ang rate = half_rate(t, scale, swap ? G::cross_ang(y, x) : G::cross_ang(x, y));
    T shrink = (0.25 * scale) * dot(x, y);
    CMBRL_FOR(r, G::A) out[r] = 0.5 * rate[r] - shrink * t.v[r];
  }
  CMBRL_FOR(r, G::A) bend[G::D + r] = both ? out[r] : -out[r];
}

}  // namespace cmbrl::CMBRL_ISA
