// Drag by the boxes that stand for the bodies' inertia: along and about each axis of a box a force against its velocity
// through the fluid, with a linear and a quadratic part (MuJoCo's inertia-box model). Implicit where velocity gains are.
#pragma once
#include "workspace.hpp"

namespace cmbrl::CMBRL_ISA {

// Unit wrenches of a box, about and along its axes; dot products with a twist are its velocities.
template <class G>
static void box_axes(const Model& m, const Work<G>& w, int box, Vec<G::N>* axes) {
  int b = m.box_body[box];
  typename G::Rot R = G::compose(w.R[b], G::load_rot(m.box_rot + box * (G::D == 2 ? 2 : 9)));
  typename G::V at = w.pos[b] + G::rotate(w.R[b], load<G::D>(m.box_pos + box * G::D));
  CMBRL_FOR(c, G::A) {
    typename G::Ang unit = zero<G::A>();
    unit[c] = splat(1);
    axes[c] = join<G>(rotate_moment(G{}, R, unit), zero<G::D>());
  }
  CMBRL_FOR(c, G::D) {
    typename G::V unit = zero<G::D>();
    unit[c] = splat(1);
    unit = G::rotate(R, unit);
    axes[G::A + c] = join<G>(G::moment(at, unit), unit);
  }
}

template <class G> static inline Vec<G::N> wind(const Model& m) { return join<G>(zero<G::A>(), load<G::D>(m.wind)); }

template <int N> static inline void add_square(T* A, T k, const Vec<N>& x) {
  CMBRL_FOR(r, N) {
    T row = k * x[r];
    CMBRL_FOR(c, N) A[r * N + c] += row * x[c];
  }
}
template <int N> static inline Vec<N> product(const T* A, const Vec<N>& x) {
  Vec<N> y;
  CMBRL_FOR(r, N) {
    y[r] = A[r * N] * x[0];
    for (int c = 1; c < N; ++c) y[r] += A[r * N + c] * x[c];
  }
  return y;
}

// f(body, unit wrench, linear and quadratic coefficient) for every axis of every box.
template <class G, class F>
static void for_box_axes(const Model& m, const Work<G>& w, F f) {
  Vec<G::N> axes[G::N];
  for (int k = 0; k < m.nbox; ++k) {
    box_axes(m, w, k, axes);
    CMBRL_FOR(c, G::N) f(m.box_body[k], axes[c], m.box_linear[k * G::N + c], m.box_quadratic[k * G::N + c]);
  }
}

template <class G>
static void clear_drag(const Model& m, Work<G>& w) {
  for (int b = 0; b < m.nbody; ++b) w.drag[b] = zero<G::N>();
  for (int i = 0; i < m.nbody * G::N * G::N; ++i) w.drag_start[i] = w.drag_end[i] = T{};
}
template <class G>
static void carry_drag(const Model& m, Work<G>& w) {  // each body takes over what it carries
  constexpr int size = G::N * G::N;
  for (int b = m.nbody - 1; b >= 0; --b) {
    int p = m.body_parent[b];
    if (p < 0) continue;
    w.drag[p] += w.drag[b];
    CMBRL_FOR(i, size) { w.drag_start[p * size + i] += w.drag_start[b * size + i]; w.drag_end[p * size + i] += w.drag_end[b * size + i]; }
  }
}

// Into tau, and into M~ or what of it waits for the rows.
template <class G>
static void fluid_forces(const Model& m, const Options& o, Work<G>& w) {
  constexpr int size = G::N * G::N;
  Vec<G::N> still = wind<G>(m);
  bool implicit = m.implicit_gains && !o.rk4;
  clear_drag(m, w);
  for_box_axes(m, w, [&](int b, const Vec<G::N>& axis, double linear, double quadratic) {
    T v = dot(axis, w.vel[b] - still), size_of_v = vabs(v);
    w.drag[b] -= ((linear + quadratic * size_of_v) * v) * axis;
    if (implicit) add_square(w.drag_end + b * size, linear + 2.0 * quadratic * size_of_v, axis);
  });
  carry_drag(m, w);
  for (int i = 0; i < m.nv; ++i) {
    int b = m.dof_body[i];
    w.tau[i] += dot(w.S[i], w.drag[b]);
    if (!implicit) continue;
    Vec<G::N> F = o.h * product(w.drag_end + b * size, w.S[i]);
    Row<T> row(o.split ? w.D : w.M, m.mass, i);
    const int *columns = m.mass.columns(i), *above = m.tree().columns(i);
    *row.diagonal += dot(w.S[i], F);
    for (int a = 0, k = 0; a < m.tree().count(i); ++a, ++k) {
      while (columns[k] != above[a]) ++k;  // both rise
      T x = dot(w.S[above[a]], F);
      row.before[k] += x;
      row.mirror[k] += x;
    }
  }
}

// Adds h times the derivatives of what acts in the step, F(V) + F'(V) (V' - V) if implicit, with twists V, V' under v and vn
// in w.vel and w.tn: dF = drag_start dV + drag_end dV' in the axes of a box, which turn with its body. late: of F'(V) (V' - V)
// alone, at fixed v' - v: what is implicit, as a part of M~.
template <class G>
static void fluid_terms(const Model& m, Work<G>& w, double h, bool implicit, T* Gq, T* Gv, bool late = false) {
  constexpr int size = G::N * G::N;
  int nv = m.nv;
  Vec<G::N> still = wind<G>(m);
  clear_drag(m, w);
  for_box_axes(m, w, [&](int b, const Vec<G::N>& axis, double linear, double quadratic) {
    T v = dot(axis, w.vel[b] - still), by_v = -(linear + 2.0 * quadratic * vabs(v));
    T force = late ? T{} : -(linear + quadratic * vabs(v)) * v;
    if (implicit) {
      T change = dot(axis, w.tn[b] - w.vel[b]);
      force += by_v * change;
      add_square(w.drag_end + b * size, by_v, axis);
      by_v = (2.0 * quadratic) * select(v < 0.0, change, -change);
    }
    w.drag[b] += force * axis;
    add_square(w.drag_start + b * size, by_v, axis);
  });
  carry_drag(m, w);
  for (int i = 0; i < nv; ++i) {
    int b = m.dof_body[i];
    const T *start = w.drag_start + b * size, *end = w.drag_end + b * size;
    Vec<G::N> by_start = h * product(start, w.S[i]), by_end = h * product(end, w.S[i]);
    Vec<G::N> by_v = late ? by_start : by_start + by_end;
    auto moved_start = [&](int j) { return cross_motion<G>(w.vlam[j] - still, w.S[j]); };
    auto moved_end = [&](int j) { return cross_motion<G>(w.tnlam[j] - (late ? w.vlam[j] : still), w.S[j]); };
    Vec<G::N> own = h * (product(start, moved_start(i)) + product(end, moved_end(i)));
    Vec<G::N> turned = own + h * cross_force<G>(w.S[i], w.drag[b]);
    Gq[i * (nv + 1)] += dot(w.S[i], own);
    Gv[i * (nv + 1)] += dot(w.S[i], by_v);
    for (int a = m.anc_ptr[i]; a < m.anc_ptr[i + 1]; ++a) {
      int j = m.anc_idx[a];
      T v = dot(w.S[j], by_v);
      Gq[i * nv + j] += dot(by_start, moved_start(j)) + dot(by_end, moved_end(j));
      Gq[j * nv + i] += dot(w.S[j], m.dof_jnt[j] == m.dof_jnt[i] ? own : turned);
      Gv[i * nv + j] += v;
      Gv[j * nv + i] += v;
    }
  }
}

}  // namespace cmbrl::CMBRL_ISA
