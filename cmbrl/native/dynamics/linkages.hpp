// What an actuator acts along that is neither a dof nor a tendon: the pose of a site relative to another one, a slider-crank, or a
// ball joint. Such a line has a length and a covector as all lines have (lines.hpp), but for two of these kinds the covector is, as
// in MuJoCo, not the gradient of the length, which is kept beside it.
#pragma once
#include "dynamics/dynamics.hpp"
#include "base/rotations.hpp"

namespace cmbrl::CMBRL_ISA {

static inline int linkage_of(const Model& m, int line) { return m.nlink > 0 && line >= m.nv ? m.line_link[line - m.nv] : -1; }

// How the length of a line changes with the coordinate of one of its entries.
template <class G>
static inline T slope_of_length(const Model& m, const Work<G>& w, int entry) { return m.nlink > 0 ? w.line_slope[entry] : w.line_c[entry]; }

// The velocity of a point under dof k: its own, or its turn about an axis.
static inline Vec<3> moved_by(const Work<Spatial>& w, int d, const Vec<3>& p) { return point_velocity<Spatial>(w.S[d], p); }
static inline Vec<3> turn_by(const Work<Spatial>& w, int d) { return ang<Spatial>(w.S[d]); }

// Both ends, and the axes of the wrench or of the slider, from where bodies are.
static inline void place_linkage(const Model& m, const Work<Spatial>& w, int i, Linkage<Spatial>& x) {
  auto turn = [&](int body) { return body < 0 ? Spatial::identity() : w.R[body]; };
  auto place = [&](int body, const double* pos) {
    Vec<3> local = load<3>(pos);
    return body < 0 ? local - w.O : w.pos[body] + Spatial::rotate(w.R[body], local);
  };
  int A = m.link_A[i], B = m.link_B[i];
  x.a = place(A, m.link_posA + 3 * i);
  x.b = place(B, m.link_posB + 3 * i);
  Spatial::Rot of_a = Spatial::compose(turn(A), Spatial::load_rot(m.link_rotA + 9 * i)), of_b = Spatial::compose(turn(B), Spatial::load_rot(m.link_rotB + 9 * i));
  const Spatial::Rot& frame = m.link_kind[i] == kOnSite ? of_a : of_b;
  x.force = Spatial::rotate(frame, load<3>(m.link_force + 3 * i));  // of a slider-crank: the slider's axis
  x.torque = Spatial::rotate(frame, load<3>(m.link_torque + 3 * i));
  x.slope = zero<3>();
  x.angle = T{};
  if (m.link_kind[i] != kBetweenSites || !m.link_turns[i]) return;
  T relative[9], quat[4], t[3], rest[9];  // of A in B's axes
  CMBRL_FOR(r, 3) CMBRL_FOR(c, 3) relative[3 * r + c] = of_b.m[r] * of_a.m[c] + of_b.m[3 + r] * of_a.m[3 + c] + of_b.m[6 + r] * of_a.m[6 + c];
  matrix_quaternion(relative, quat);
  rotation_vector(quat, t);
  rotation_slopes(t, rest);
  const double* f = m.link_torque + 3 * i;
  Vec<3> own;
  CMBRL_FOR(c, 3) {
    own[c] = f[c] + (f[0] * rest[c] + f[1] * rest[3 + c] + f[2] * rest[6 + c]);
    x.angle += f[c] * t[c];
  }
  x.slope = Spatial::rotate(of_a, own);
}

// Of a slider-crank with the slider's axis e and the way r from the slider to the crank: e.r, and (e.r)^2 + rod^2 - r.r.
static inline Vec<3> way_of(const Linkage<Spatial>& x) { return x.a - x.b; }

// The changes of e.r, and of half the other, with a dof.
struct CrankRate { Vec<3> way, axis; T along, half; };
static inline CrankRate crank_rate(const Work<Spatial>& w, const Linkage<Spatial>& x, int d, int side) {
  Vec<3> way = side > 0 ? moved_by(w, d, x.a) : zero<3>() - moved_by(w, d, x.b), axis = side > 0 ? zero<3>() : cross(turn_by(w, d), x.force);
  T along = dot(x.force, way) + dot(axis, way_of(x));
  return {way, axis, along, x.reach * along - dot(way_of(x), way)};
}

static inline void crank_terms(const Model& m, Work<Spatial>& w, int i, Linkage<Spatial>& x) {
  int line = m.link_line[i];
  Vec<3> way = way_of(x);
  x.reach = dot(x.force, way);
  T square = x.reach * x.reach + m.link_rod[i] * m.link_rod[i] - dot(way, way);
  Mask closes = square > 0.0;  // otherwise MuJoCo takes the slider alone
  T root = vsqrt(select(closes, square, splat(1)));
  x.inverse = keep(closes, 1.0 / root);
  w.line_length[line] = x.reach - keep(closes, root);
  for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k) {
    CrankRate rate = crank_rate(w, x, m.line_dof[k], m.link_side[k]);
    w.line_c[k] = w.line_slope[k] = rate.along - x.inverse * rate.half;
  }
}

static inline void wrench_terms(const Model& m, Work<Spatial>& w, int i, const Linkage<Spatial>& x) {
  int line = m.link_line[i];
  w.line_length[line] = m.link_kind[i] == kOnSite ? T{} : dot(x.force, x.a - x.b) + x.angle;
  for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k) {
    int d = m.line_dof[k];
    double sign = m.link_side[k];
    w.line_c[k] = sign * (dot(x.force, moved_by(w, d, sign > 0 ? x.a : x.b)) + dot(x.torque, turn_by(w, d)));
    w.line_slope[k] = sign * (dot(x.force, moved_by(w, d, x.a)) + dot(x.slope, turn_by(w, d)));
  }
}

// Of a ball joint, along an axis of its own or of its parent's.
static inline void ball_terms(const Model& m, Work<Spatial>& w, int i) {
  int line = m.link_line[i], first = m.line_ptr[line + 1] - 3;
  const T* q = w.q + m.link_A[i];
  T size = 1.0 / vsqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), unit[4], t[3], rest[9];
  CMBRL_FOR(k, 4) unit[k] = size * q[k];
  rotation_vector(unit, t);
  rotation_slopes(t, rest);
  Vec<3> axis = load<3>(m.link_torque + 3 * i);
  Spatial::Rot R = quaternion_rotation(unit);
  T length = T{};
  CMBRL_FOR(k, 3) {
    w.line_c[first + k] = m.link_turns[i] ? R.m[k] * axis[0] + R.m[3 + k] * axis[1] + R.m[6 + k] * axis[2] : axis[k];
    w.line_slope[first + k] = axis[k] + axis[0] * rest[k] + axis[1] * rest[3 + k] + axis[2] * rest[6 + k];
    length += axis[k] * t[k];
  }
  w.line_length[line] = length;
}

static inline void find_linkages(const Model&, Work<Planar>&) {}
static inline void find_linkages(const Model& m, Work<Spatial>& w) {
  for (int k = 0; k < m.line_ptr[m.nline]; ++k) w.line_slope[k] = w.line_c[k];
  for (int i = 0; i < m.nlink; ++i) {
    Linkage<Spatial>& x = w.linkages[i];
    if (m.link_kind[i] == kOfBall) { ball_terms(m, w, i); continue; }
    if (m.link_kind[i] == kConstantRate) { w.line_length[m.link_line[i]] = T{}; continue; }
    place_linkage(m, w, i, x);
    if (m.link_kind[i] == kSliderCrank) crank_terms(m, w, i, x);
    else wrench_terms(m, w, i, x);
  }
}

// Whether dof l moves the column of dof k: it stands before it, or is of the same joint.
static inline bool moves_column(const Model& m, int l, int k) { return l < k || m.dof_jnt[l] == m.dof_jnt[k]; }
// The change with dof l of how dof k moves the point p, both of one side.
static inline Vec<3> bent_velocity(const Model& m, const Work<Spatial>& w, int k, int l, const Vec<3>& p) {
  return moves_column(m, l, k) ? cross(turn_by(w, l), moved_by(w, k, p)) : cross(turn_by(w, k), moved_by(w, l, p));
}

static inline T crank_bend(const Model& m, const Work<Spatial>& w, const Linkage<Spatial>& x, int k, int l, int side_k, int side_l) {
  CrankRate a = crank_rate(w, x, k, side_k), b = crank_rate(w, x, l, side_l);
  Vec<3> way = zero<3>(), axis = zero<3>();
  if (side_k == side_l) way = side_k > 0 ? bent_velocity(m, w, k, l, x.a) : zero<3>() - bent_velocity(m, w, k, l, x.b);
  if (side_k < 0 && side_l < 0) {
    bool first = moves_column(m, l, k);
    axis = cross(turn_by(w, first ? l : k), cross(turn_by(w, first ? k : l), x.force));
  }
  T along = dot(x.force, way) + dot(a.axis, b.way) + dot(b.axis, a.way) + dot(axis, way_of(x));
  T half = a.along * b.along + x.reach * along - dot(a.way, b.way) - dot(way_of(x), way);
  return along - x.inverse * (half - x.inverse * x.inverse * (a.half * b.half));
}

static inline T wrench_bend(const Model& m, const Work<Spatial>& w, const Linkage<Spatial>& x, int kind, int k, int l, int side_k, int side_l) {
  const Vec<3>& p = side_k > 0 ? x.a : x.b;
  T sum = T{};
  if (side_l == (kind == kOnSite ? 1 : -1)) {  // the wrench turns
    Vec<3> turn = turn_by(w, l);
    sum += dot(cross(turn, x.force), moved_by(w, k, p)) + dot(cross(turn, x.torque), turn_by(w, k));
  }
  if (side_k == side_l) {
    sum += dot(x.force, bent_velocity(m, w, k, l, p));
    if (moves_column(m, l, k)) sum += dot(x.torque, cross(turn_by(w, l), turn_by(w, k)));
  }
  return side_k > 0 ? sum : -sum;
}

// The change of entry k of the covector of linkage i with the coordinate of its entry l.
static inline T linkage_bend(const Model&, const Work<Planar>&, int, int, int) { return T{}; }
static inline T linkage_bend(const Model& m, const Work<Spatial>& w, int i, int k, int l) {
  if (m.link_kind[i] == kConstantRate) return T{};
  if (m.link_kind[i] == kOfBall) {
    int first = m.line_ptr[m.link_line[i] + 1] - 3, a = k - first, b = l - first;
    if (!m.link_turns[i] || a < 0 || b < 0 || a == b) return T{};
    T other = w.line_c[first + 3 - a - b];  // (c x e_b)_a
    return (b + 1) % 3 == a ? other : -other;
  }
  int dk = m.line_dof[k], dl = m.line_dof[l], side_k = m.link_side[k], side_l = m.link_side[l];
  if (m.link_kind[i] == kSliderCrank) return crank_bend(m, w, w.linkages[i], dk, dl, side_k, side_l);
  return wrench_bend(m, w, w.linkages[i], m.link_kind[i], dk, dl, side_k, side_l);
}

// Adds what a pull that falls by `stiff` per length is by coordinate, where it was taken to fall along the covector.
template <class G>
static void add_length_slopes(const Model& m, const Work<G>& w, int line, T stiff, T* A) {
  for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k)
    for (int l = m.line_ptr[line]; l < m.line_ptr[line + 1]; ++l)
      A[m.line_dof[k] * m.nv + m.line_dof[l]] -= stiff * w.line_c[k] * (w.line_slope[l] - w.line_c[l]);
}

}  // namespace cmbrl::CMBRL_ISA
