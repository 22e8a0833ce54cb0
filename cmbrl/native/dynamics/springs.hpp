// Springs and limits of ball joints, and springs and dampers with higher powers.
#pragma once
#include "dynamics/lines.hpp"
#include "dynamics/manifold.hpp"
#include "base/rotations.hpp"

namespace cmbrl::CMBRL_ISA {

// The rotation vector (3), in body axes, that turns the unit quaternion `from` into q.
static inline void rotation_since(const double* from, const T* q, T* out) {
  T back[4] = {splat(from[0]), splat(-from[1]), splat(-from[2]), splat(-from[3])}, r[4];
  quat_mul(back, q, r);
  rotation_vector(r, out);
}

// The limit on the angle of a ball joint: how far it is, and how that changes with its dofs.
template <class G>
static T ball_limit(const Model& m, const Work<G>& w, int i, Direction& d) {
  const double none[4] = {1, 0, 0, 0};
  T t[3];
  rotation_since(none, w.q + m.lim_ball[i], t);
  T angle = vsqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2]);
  T inv = keep(angle > 1e-9, 1.0 / vmax(angle, splat(1e-9)));
  d = {m.lim_line[i], true, splat(1), {-inv * t[0], -inv * t[1], -inv * t[2]}};
  return m.lim_hi[i] - angle;
}

// d axis / dq of a limit on an angle, -(J - n n^T) / angle with n = -axis.
template <class G>
static void axis_slopes(const Model& m, const Work<G>&, const Limit& l, T out[9]) {
  T angle = m.lim_hi[l.index] - l.phi, t[3], rest[9];
  CMBRL_FOR(k, 3) t[k] = -angle * l.axis[k];
  rotation_slopes(t, rest);
  T inv = keep(angle > 1e-9, 1.0 / vmax(angle, splat(1e-9)));
  CMBRL_FOR(r, 3) CMBRL_FOR(c, 3) {
    T unit = splat(r == c);
    out[3 * r + c] = inv * (l.axis[r] * l.axis[c] - unit - rest[3 * r + c]);
  }
}
// Adds how the closing speed at velocity x, less the carried one at v, changes as the axis turns.
template <class G>
static void add_turn(const Model& m, const Work<G>& w, const Limit& l, const T* x, T* z) {
  T slopes[9];
  axis_slopes(m, w, l, slopes);
  int d = l.line - 2;
  CMBRL_FOR(c, 3) CMBRL_FOR(k, 3) z[d + c] += slopes[3 * k + c] * (x[d + k] - l.carry * w.v[d + k]);
}
// What the turn of its axis adds to the rows' part of Gq: of the impulse, and of the row.
template <class G>
static void turn_terms(const Model& m, const Work<G>& w, const Limit& l, T* Gq) {
  T slopes[9];
  axis_slopes(m, w, l, slopes);
  int d = l.line - 2;
  CMBRL_FOR(c, 3) {
    T E = T{};
    CMBRL_FOR(k, 3) E += slopes[3 * k + c] * (w.vn[d + k] - l.carry * w.v[d + k]);
    CMBRL_FOR(r, 3) Gq[(d + r) * m.nv + d + c] += keep(l.on, l.gam) * slopes[3 * r + c] - l.Th * l.axis[r] * E;
  }
}

template <class G>
static void ball_springs(const Model& m, Work<G>& w) {  // into tau; kp has them
  for (int s = 0; s < m.nballspring; ++s) {
    int d = m.spring_dof[s];
    rotation_since(m.spring_ref + 4 * s, w.q + m.spring_qadr[s], w.stretch + d);
    for (int i = d; i < d + 3; ++i) w.tau[i] -= w.P[m.oDof + i * kDofFields + kStiffness] * w.stretch[i];
  }
}

// Adds h dtau/dq without the diagonal -h kp that all springs have: the rest of the inverse right Jacobian of SO(3).
template <class G>
static void ball_spring_terms(const Model& m, const Work<G>& w, double h, T* Gq) {
  for (int s = 0; s < m.nballspring; ++s) {
    int d = m.spring_dof[s];
    T rest[9];
    rotation_slopes(w.stretch + d, rest);
    CMBRL_FOR(r, 3) CMBRL_FOR(c, 3)
      Gq[(d + r) * m.nv + d + c] -= h * w.P[m.oDof + (d + r) * kDofFields + kStiffness] * rest[3 * r + c];
  }
}

// Force -(k1 x + k2 x^2) x - (b1 |v| + b2 v^2) v of a dof, x from the spring's reference, and its slopes.
struct Powers { T force, k, b, dk, db; };
template <class G>
static Powers powers(const Model& m, const Work<G>& w, int s) {
  int d = m.power_dof[s];
  const double* c = m.power_coef + 4 * s;
  T v = w.v[d], size = vabs(v);
  T x = m.dof_qadr[d] >= 0 ? w.q[m.dof_qadr[d]] - w.P[m.oDof + d * kDofFields + kSpringref] : T{};
  T sign = select(v < 0.0, splat(-1), splat(1));
  return {-(c[0] + c[1] * x) * x * x - (c[2] + c[3] * size) * size * v, (2 * c[0] + 3 * c[1] * x) * x,
          (2 * c[2] + 3 * c[3] * size) * size, 2 * c[0] + 6 * c[1] * x, (2 * c[2] + 6 * c[3] * size) * sign};
}

// Into tau, kp and M~: damping is implicit, if that of joints is, with its slope.
template <class G>
static void power_forces(const Model& m, const Options& o, Work<G>& w) {
  for (int s = 0; s < m.npower; ++s) {
    int d = m.power_dof[s];
    Powers p = powers(m, w, s);
    w.tau[d] += p.force;
    w.kp[d] += p.k;
    if (m.implicit_damping && !o.rk4) (o.split ? w.D : w.M)[m.mass.row(d)] += o.h * p.b;
  }
}

// Adds what of the derivative is not the diagonal -h kp: slopes that stand in M~ times the changes vn - v and vn.
template <class G>
static void power_terms(const Model& m, const Options& o, const Work<G>& w, const T* vn, T* Gq, T* Gv) {
  for (int s = 0; s < m.npower; ++s) {
    int d = m.power_dof[s];
    Powers p = powers(m, w, s);
    Gv[d * (m.nv + 1)] -= o.h * (o.apart() || !m.implicit_damping ? p.b : p.b + p.db * (vn[d] - w.v[d]));
    if (o.implicit_springs) Gq[d * (m.nv + 1)] -= o.h * o.h * p.dk * vn[d];
  }
}

// The same of -dM~ shift.
template <class G>
static void late_power_terms(const Model& m, const Options& o, const Work<G>& w, T* Sq, T* Sv) {
  for (int s = 0; s < m.npower; ++s) {
    int d = m.power_dof[s];
    Powers p = powers(m, w, s);
    if (m.implicit_damping) Sv[d * (m.nv + 1)] -= o.h * p.db * w.eased[d];
    if (o.implicit_springs) Sq[d * (m.nv + 1)] -= o.h * o.h * p.dk * w.shift[d];
  }
}

}  // namespace cmbrl::CMBRL_ISA
