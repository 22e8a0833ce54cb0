// Ties: equality constraints between two bodies (connect, weld) or two lines (a polynomial). Their rows pull both ways with
// MuJoCo's soft law, c = J v' + R x - carry J v + h K d r [+ h dJ/dt v] = 0, whatever the sign of x: so x = -(J v' + ...) / R
// needs no interior point, and J^T J / R joins the mass matrix, whose pattern holds the dofs that a tie couples
// (scene_data.cpp). As in MuJoCo only rows of bodies look at how J changes.
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

// Accelerations of all bodies under w.v if no joint accelerates, without gravity.
template <class G>
static void drifts(const Model& m, Work<G>& w) {
  for (int b = 0; b < m.nbody; ++b) {
    Vec<G::N> a = m.body_parent[b] >= 0 ? w.drift[m.body_parent[b]] : zero<G::N>();
    for (int j = m.body_jadr[b]; j < m.body_jadr[b] + m.body_jnum[b]; ++j) {
      int d = m.jnt_vadr[j], n = m.jnt_type[j] == kBall ? 3 : 1;
      Vec<G::N> own = zero<G::N>();
      for (int k = d; k < d + n; ++k) {
        w.drift_before[k] = a;
        own += w.v[k] * w.S[k];
      }
      a += cross_motion<G>(w.vlam[d], own);
    }
    w.drift[b] = a;
  }
}

// How the end of a tie moves: twist and acceleration of its body.
template <class G> struct Sway { Vec<G::N> vel, acc; };
template <class G>
static Sway<G> sway_of(const Work<G>& w, int body) {
  if (body < 0) return {zero<G::N>(), zero<G::N>()};
  return {w.vel[body], w.drift[body]};
}
// Its change with the velocity of a dof that carries it, or with its coordinate: what stands behind a joint turns with it.
template <class G>
static Sway<G> change_of_sway(const Model& m, const Work<G>& w, const Sway<G>& s, int d, bool by_velocity) {
  const Vec<G::N>&S = w.S[d], &before = w.vlam[d];
  Vec<G::N> turned = cross_motion<G>(before, S);
  if (by_velocity) {
    int joint = m.dof_jnt[d], first = m.jnt_vadr[joint], n = m.jnt_type[joint] == kBall ? 3 : 1;
    Vec<G::N> beyond = s.vel - before;
    for (int k = first; k < first + n; ++k) beyond -= w.v[k] * w.S[k];
    return {S, turned + cross_motion<G>(S, beyond)};
  }
  Vec<G::N> beyond = s.vel - before;
  return {cross_motion<G>(S, beyond), cross_motion<G>(S, s.acc - w.drift_before[d]) + cross_motion<G>(turned, beyond)};
}

template <class G>
static typename G::V point_acceleration(const Sway<G>& s, const typename G::V& p) {
  return point_velocity<G>(s.acc, p) + G::turn(ang<G>(s.vel), point_velocity<G>(s.vel, p));
}
// The same of a change of the sway, and of the point by dp.
template <class G>
static typename G::V change_of_acceleration(const Sway<G>& s, const Sway<G>& ds, const typename G::V& p, const typename G::V& dp) {
  typename G::Ang turn = ang<G>(s.vel);
  return point_velocity<G>(ds.acc, p) + G::turn(ang<G>(s.acc), dp) + G::turn(ang<G>(ds.vel), point_velocity<G>(s.vel, p)) +
         G::turn(turn, point_velocity<G>(ds.vel, p) + G::turn(turn, dp));
}

// dJ/dt v of a tie.
template <class G>
static void tie_sway(const Model& m, const Work<G>& w, int i, const Tie<G>& t, T* out) {
  CMBRL_FOR(r, t.rows) out[r] = T{};
  if (m.tie_type[i] == kPolynomial) return;
  Sway<G> a = sway_of(w, m.tie_A[i]), b = sway_of(w, m.tie_B[i]);
  typename G::V apart = point_acceleration(a, t.a) - point_acceleration(b, t.b);
  CMBRL_FOR(r, G::D) out[r] = apart[r];
  if (t.rows == G::D) return;
  double scale = m.tie_scale[i];
  typename G::Ang turn_a = ang<G>(a.vel), turn_b = ang<G>(b.vel), turn = turn_a - turn_b;
  typename G::Ang rate = half_rate(t, scale, ang<G>(a.acc) - ang<G>(b.acc) + G::cross_ang(turn_a, turn_b));
  CMBRL_FOR(r, G::A) out[G::D + r] = rate[r] - (0.25 * scale) * dot(turn, turn) * t.v[r];
}
// Its change with the velocity of the l-th of the tie's dofs, or with its coordinate.
template <class G>
static void tie_sway_change(const Model& m, const Work<G>& w, int i, const Tie<G>& t, int l, bool by_velocity, T* out) {
  CMBRL_FOR(r, t.rows) out[r] = T{};
  if (m.tie_type[i] == kPolynomial) return;
  int d = m.tie_dof[l];
  bool moves_a = m.tie_side[l] & kCarriesA, moves_b = m.tie_side[l] & kCarriesB;
  Sway<G> a = sway_of(w, m.tie_A[i]), b = sway_of(w, m.tie_B[i]), still = {zero<G::N>(), zero<G::N>()};
  Sway<G> da = moves_a ? change_of_sway(m, w, a, d, by_velocity) : still, db = moves_b ? change_of_sway(m, w, b, d, by_velocity) : still;
  typename G::V none = zero<G::D>();
  typename G::V at_a = moves_a && !by_velocity ? point_velocity<G>(w.S[d], t.a) : none;
  typename G::V at_b = moves_b && !by_velocity ? point_velocity<G>(w.S[d], t.b) : none;
  typename G::V apart = change_of_acceleration(a, da, t.a, at_a) - change_of_acceleration(b, db, t.b, at_b);
  CMBRL_FOR(r, G::D) out[r] = apart[r];
  if (t.rows == G::D) return;
  double scale = m.tie_scale[i];
  typename G::Ang turn_a = ang<G>(a.vel), turn_b = ang<G>(b.vel), turn = turn_a - turn_b, dturn = ang<G>(da.vel) - ang<G>(db.vel);
  typename G::Ang change = ang<G>(da.acc) - ang<G>(db.acc) + G::cross_ang(ang<G>(da.vel), turn_b) + G::cross_ang(turn_a, ang<G>(db.vel));
  typename G::Ang rate = half_rate(t, scale, change);
  CMBRL_FOR(r, G::A) out[G::D + r] = rate[r] - (0.5 * scale) * dot(turn, dturn) * t.v[r];
  if (by_velocity) return;
  typename G::Ang S = ang<G>(w.S[d]), z = ang<G>(a.acc) - ang<G>(b.acc) + G::cross_ang(turn_a, turn_b), spin = zero<G::A>();
  double towards = double(moves_a) - double(moves_b);
  if (moves_a) spin += G::cross_ang(z, S);  // the half angle's own axes turn
  if (moves_b) spin += G::cross_ang(z, S);
  rate = half_rate(t, scale, spin);
  typename G::Ang half = half_rate(t, scale, S);
  CMBRL_FOR(r, G::A)
    out[G::D + r] += 0.5 * rate[r] - (0.25 * towards) * (scale * dot(z, S) * t.v[r] + dot(turn, turn) * half[r]);
}

// The ties of a step, their pull at vn = v into rhs, and J^T J / R into M.
template <class G>
static void tie_forces(const Model& m, const Options& o, Work<G>& w) {
  constexpr int kRows = Tie<G>::kRows;
  if (m.ntie) drifts(m, w);
  for (int i = 0; i < m.ntie; ++i) {
    Tie<G>& t = w.ties[i];
    int begin = m.tie_ptr[i], end = m.tie_ptr[i + 1];
    if (m.tie_type[i] == kPolynomial) tie_lines(m, w, i, t);
    else tie_bodies(m, w, i, t);
    tie_law(m, o.h, i, t);
    tie_sway(m, w, i, t, t.sway);
    T pull[kRows];
    CMBRL_FOR(r, t.rows) {
      t.sway[r] *= o.h;
      pull[r] = t.stiff * t.r[r] + t.sway[r];
    }
    for (int k = begin; k < end; ++k) {
      T *column = w.tie_J + k * kRows, slow = (1.0 - t.carry) * w.v[m.tie_dof[k]];
      tie_column(m, w, i, t, k, column);
      CMBRL_FOR(r, t.rows) pull[r] += slow * column[r];
    }
    CMBRL_FOR(r, t.rows) pull[r] *= t.inv[r];
    for (int k = begin; k < end; ++k) {
      const T* column = w.tie_J + k * kRows;
      T share[kRows];
      CMBRL_FOR(r, t.rows) share[r] = column[r] * t.inv[r];
      CMBRL_FOR(r, t.rows) w.rhs[m.tie_dof[k]] -= column[r] * pull[r];
      Row<T> row(w.M, m.mass, m.tie_dof[k]);
      const int* columns = m.mass.columns(m.tie_dof[k]);
      CMBRL_FOR(r, t.rows) *row.diagonal += share[r] * column[r];
      for (int l = begin, x = 0; l < k; ++l, ++x) {
        while (columns[x] != m.tie_dof[l]) ++x;  // both rise
        T y = T{};
        CMBRL_FOR(r, t.rows) y += share[r] * w.tie_J[l * kRows + r];
        row.before[x] += y;
        row.mirror[x] += y;
      }
    }
  }
}

// Ties' part of Gq, Gv for a step from v to vn, whose M holds J^T J / R. v null: of the momentum -J^T J vn / R of an
// acceleration `vn` instead (late impulses), without Gv.
template <class G>
static void tie_terms(const Model& m, const Options& o, const Work<G>& w, const T* vn, const T* v, T* Gq, T* Gv) {
  constexpr int kRows = Tie<G>::kRows;
  int nv = m.nv;
  for (int i = 0; i < m.ntie; ++i) {
    const Tie<G>& t = w.ties[i];
    int begin = m.tie_ptr[i], end = m.tie_ptr[i + 1];
    T stiff = v ? t.stiff : T{}, dstiff = v ? t.dstiff : T{}, x[kRows];
    auto closing = [&](int k) {
      int d = m.tie_dof[k];
      return v ? vn[d] - t.carry * v[d] : vn[d];
    };
    CMBRL_FOR(r, t.rows) x[r] = v ? stiff * t.r[r] + t.sway[r] : T{};
    for (int k = begin; k < end; ++k) CMBRL_FOR(r, t.rows) x[r] += w.tie_J[k * kRows + r] * closing(k);
    CMBRL_FOR(r, t.rows) x[r] *= -t.inv[r];
    for (int l = begin; l < end; ++l) {  // by the coordinate of dof l
      int dl = m.tie_dof[l];
      const T* column = w.tie_J + l * kRows;
      T change[kRows], bend[kRows], gains[kRows] = {}, grows = T{};  // of the rows, by the velocity too; of the residual's size
      CMBRL_FOR(r, t.rows) grows += t.dsize[r] * column[r];
      CMBRL_FOR(r, t.rows) change[r] = stiff * column[r] + (dstiff * t.r[r] + t.dR / t.inv[r] * x[r]) * grows;
      if (v) {
        tie_sway_change(m, w, i, t, l, true, gains);
        tie_sway_change(m, w, i, t, l, false, bend);
        CMBRL_FOR(r, t.rows) {
          change[r] += o.h * bend[r];
          gains[r] = o.h * gains[r] + (1.0 - t.carry) * column[r];
        }
      }
      for (int k = begin; k < end; ++k) {
        tie_bend(m, w, i, t, k, l, bend);
        T turned = T{}, y = closing(k);
        CMBRL_FOR(r, t.rows) { turned += x[r] * bend[r]; change[r] += bend[r] * y; }
        Gq[m.tie_dof[k] * nv + dl] += turned;
      }
      for (int k = begin; k < end; ++k) {
        T q = T{}, back = T{};
        CMBRL_FOR(r, t.rows) {
          T held = w.tie_J[k * kRows + r] * t.inv[r];
          q += held * change[r];
          back += held * gains[r];
        }
        Gq[m.tie_dof[k] * nv + dl] -= q;
        if (v) Gv[m.tie_dof[k] * nv + dl] -= back;
      }
    }
  }
}

}  // namespace cmbrl::CMBRL_ISA
