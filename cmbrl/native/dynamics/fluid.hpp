// Drag by the boxes that stand for the bodies' inertia: along and about each axis of a box a force against its velocity
// through the fluid, with a linear and a quadratic part (MuJoCo's inertia-box model). And forces on ellipsoids, which
// replace the box of their body (ellipsoid_drag.hpp). Both are implicit where velocity gains are.
#pragma once
#include "dynamics/ellipsoid_drag.hpp"
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

// Unit wrenches about and along the axes of a frame on a body; dot products with a twist are its velocities.
template <class G>
static void frame_axes(const Work<G>& w, int body, const double* place, const double* rot, Vec<G::N>* axes) {
  typename G::Rot R = G::compose(w.R[body], G::load_rot(rot));
  typename G::V at = w.pos[body] + G::rotate(w.R[body], load<G::D>(place));
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

template <class G> static inline Fluid fluid_of(const Model& m, const Work<G>& w) { return {w.P[m.oFluid], w.P[m.oFluid + 1]}; }
template <class G> static inline Vec<G::N> wind(const Model& m) { return join<G>(zero<G::A>(), load<G::D>(m.wind)); }

template <int N> static inline void add_square(T* A, T k, const Vec<N>& x) {
  CMBRL_FOR(r, N) {
    T row = k * x[r];
    CMBRL_FOR(c, N) A[r * N + c] += row * x[c];
  }
}
template <int N> static inline Vec<N> product(const T* A, const Vec<N>& x, int down = N, int right = 1) {
  Vec<N> y;
  CMBRL_FOR(r, N) {
    y[r] = A[r * down] * x[0];
    for (int c = 1; c < N; ++c) y[r] += A[r * down + c * right] * x[c];
  }
  return y;
}
template <int N> static inline Vec<N> transposed_product(const T* A, const Vec<N>& x) { return product(A, x, 1, N); }
// A += sum k(i, j) axes_i axes_j^T
template <int N, class K> static inline void add_form(T* A, const Vec<N>* axes, K k) {
  CMBRL_FOR(i, N) {
    Vec<N> row = zero<N>();
    CMBRL_FOR(j, N) row += k(i, j) * axes[j];
    CMBRL_FOR(r, N) CMBRL_FOR(c, N) A[r * N + c] += axes[i][r] * row[c];
  }
}

// f(body, unit wrench, linear and quadratic coefficient) for every axis of every box.
template <class G, class F>
static void for_box_axes(const Model& m, const Work<G>& w, const Fluid& fluid, F f) {
  Vec<G::N> axes[G::N];
  for (int k = 0; k < m.nbox; ++k) {
    frame_axes(w, m.box_body[k], m.box_pos + k * G::D, m.box_rot + k * (G::D == 2 ? 2 : 9), axes);
    CMBRL_FOR(c, G::N) f(m.box_body[k], axes[c], fluid.viscosity * m.box_linear[k * G::N + c], fluid.density * m.box_quadratic[k * G::N + c]);
  }
}

// f(body, constants, axes) of every ellipsoid; there are none in the plane.
template <class G, class F>
static void for_ellipsoids(const Model& m, const Work<G>& w, F f) {
  if constexpr (G::D == 3) {
    Vec<G::N> axes[G::N];
    for (int k = 0; k < m.nellipsoid; ++k) {
      EllipsoidInFluid e;
      std::memcpy(&e, m.ellipsoid_coef + k * kEllipsoidNumbers, sizeof(e));
      frame_axes(w, m.ellipsoid_body[k], m.ellipsoid_pos + k * 3, m.ellipsoid_rot + k * 9, axes);
      f(m.ellipsoid_body[k], e, axes);
    }
  }
}

// Velocities about and along axes as inputs of a wrench: packs, jets, or jets of jets.
static inline void seed(T& x, T v, int) { x = v; }
template <class S, int N> static inline void seed(Jet<S, N>& x, T v, int input) {
  seed(x.v, v, input);
  for (int i = 0; i < N; ++i) seed(x.d[i], splat(i == input), N);
}
template <class S>
static void wrench_of(const EllipsoidInFluid& e, const Fluid& fluid, const Vec<6>* axes, const Vec<6>& twist, S* f) {
  S x[6];
  CMBRL_FOR(i, 6) seed(x[i], dot(axes[i], twist), i);
  ellipsoid_wrench(e, fluid, x, f);
}

// MuJoCo damps with the symmetric part of the derivative, unless it takes Coriolis forces implicitly too (gyro.hpp).
static inline bool one_sided(const Model& m, const Options& o, int body) { return o.split && m.gyro_dof[m.body_lastdof[body]]; }

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
  Fluid fluid = fluid_of(m, w);
  bool implicit = m.implicit_gains && !o.rk4;
  clear_drag(m, w);
  for_box_axes(m, w, fluid, [&](int b, const Vec<G::N>& axis, T linear, T quadratic) {
    T v = dot(axis, w.vel[b] - still), size_of_v = vabs(v);
    w.drag[b] -= ((linear + quadratic * size_of_v) * v) * axis;
    if (implicit) add_square(w.drag_end + b * size, linear + 2.0 * quadratic * size_of_v, axis);
  });
  for_ellipsoids(m, w, [&](int b, const EllipsoidInFluid& e, auto* axes) {
    Jet<T, 6> f[6];
    wrench_of(e, fluid, axes, w.vel[b] - still, f);
    CMBRL_FOR(i, 6) w.drag[b] += f[i].v * axes[i];
    bool whole = one_sided(m, o, b);
    if (implicit) add_form(w.drag_end + b * size, axes, [&](int i, int j) { return -(whole ? f[i].d[j] : 0.5 * (f[i].d[j] + f[j].d[i])); });
  });
  carry_drag(m, w);
  for (int i = 0; i < m.nv; ++i) {
    int b = m.dof_body[i];
    w.tau[i] += dot(w.S[i], w.drag[b]);
    if (!implicit) continue;
    Vec<G::N> F = o.h * product(w.drag_end + b * size, w.S[i]), back = o.h * transposed_product(w.drag_end + b * size, w.S[i]);
    Row<T> row(o.split ? w.D : w.M, m.mass, i);
    const int *columns = m.mass.columns(i), *above = m.tree().columns(i);
    *row.diagonal += dot(w.S[i], F);
    for (int a = 0, k = 0; a < m.tree().count(i); ++a, ++k) {
      while (columns[k] != above[a]) ++k;  // both rise
      row.before[k] += dot(w.S[above[a]], back);
      row.mirror[k] += dot(w.S[above[a]], F);
    }
  }
}

// Of one ellipsoid: what fluid_terms gathers, of F(V) and of B(V) (V' - V), where B is F' or its symmetric part.
template <class G>
static void ellipsoid_terms(const Model& m, const Options& o, Work<G>& w, const Fluid& fluid, bool implicit, bool late, int b,
                            const EllipsoidInFluid& e, const Vec<6>* axes, const Vec<6>& twist) {
  T *start = w.drag_start + b * 36, *end = w.drag_end + b * 36;
  if (!implicit) {
    Jet<T, 6> f[6];
    wrench_of(e, fluid, axes, twist, f);
    CMBRL_FOR(i, 6) w.drag[b] += f[i].v * axes[i];
    add_form(start, axes, [&](int i, int j) { return f[i].d[j]; });
    return;
  }
  Jet<Jet<T, 6>, 6> f[6];
  wrench_of(e, fluid, axes, twist, f);
  bool whole = one_sided(m, o, b);
  auto damping = [&](int i, int j) { return whole ? f[i].d[j].v : 0.5 * (f[i].d[j].v + f[j].d[i].v); };
  T change[6];
  CMBRL_FOR(j, 6) change[j] = dot(axes[j], w.tn[b] - w.vel[b]);
  CMBRL_FOR(i, 6) {
    T force = late ? T{} : f[i].v.v;
    CMBRL_FOR(j, 6) force += damping(i, j) * change[j];
    w.drag[b] += force * axes[i];
  }
  add_form(end, axes, damping);
  add_form(start, axes, [&](int i, int k) {
    T by_v = late ? T{} : f[i].d[k].v - damping(i, k);
    CMBRL_FOR(j, 6) by_v += (whole ? f[i].d[j].d[k] : 0.5 * (f[i].d[j].d[k] + f[j].d[i].d[k])) * change[j];
    return by_v;
  });
}

// What acts in a step, F(V) + F'(V) (V' - V) if implicit, with twists V, V' under v and vn in w.vel and w.tn, into w.drag; and its
// derivatives, drag_start by V and drag_end by V'. late: of F'(V) (V' - V) alone.
template <class G>
static void fluid_wrenches(const Model& m, const Options& o, Work<G>& w, const Fluid& fluid, bool implicit, bool late) {
  constexpr int size = G::N * G::N;
  Vec<G::N> still = wind<G>(m);
  clear_drag(m, w);
  for_box_axes(m, w, fluid, [&](int b, const Vec<G::N>& axis, T linear, T quadratic) {
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
  for_ellipsoids(m, w, [&](int b, const EllipsoidInFluid& e, auto* axes) {
    ellipsoid_terms(m, o, w, fluid, implicit, late, b, e, axes, w.vel[b] - still);
  });
  carry_drag(m, w);
}

// Adds h times the derivatives of that: dF = drag_start dV + drag_end dV' in the axes of a box, which turn with its body. late:
// at fixed v' - v: what is implicit, as a part of M~.
template <class G>
static void fluid_terms(const Model& m, const Options& o, Work<G>& w, bool implicit, T* Gq, T* Gv, bool late = false) {
  constexpr int size = G::N * G::N;
  int nv = m.nv;
  double h = o.h;
  Vec<G::N> still = wind<G>(m);
  fluid_wrenches(m, o, w, fluid_of(m, w), implicit, late);
  for (int i = 0; i < nv; ++i) {
    int b = m.dof_body[i];
    const T *start = w.drag_start + b * size, *end = w.drag_end + b * size;
    Vec<G::N> by_start = h * product(start, w.S[i]), by_end = h * product(end, w.S[i]);
    Vec<G::N> back_start = h * transposed_product(start, w.S[i]), back_end = h * transposed_product(end, w.S[i]);
    Vec<G::N> by_v = late ? by_start : by_start + by_end, back = late ? back_start : back_start + back_end;
    auto moved_start = [&](int j) { return cross_motion<G>(w.vlam[j] - still, w.S[j]); };
    auto moved_end = [&](int j) { return cross_motion<G>(w.tnlam[j] - (late ? w.vlam[j] : still), w.S[j]); };
    Vec<G::N> own = h * (product(start, moved_start(i)) + product(end, moved_end(i)));
    Vec<G::N> turned = own + h * cross_force<G>(w.S[i], w.drag[b]);
    Gq[i * (nv + 1)] += dot(w.S[i], own);
    Gv[i * (nv + 1)] += dot(w.S[i], by_v);
    for (int a = m.anc_ptr[i]; a < m.anc_ptr[i + 1]; ++a) {
      int j = m.anc_idx[a];
      Gq[i * nv + j] += dot(back_start, moved_start(j)) + dot(back_end, moved_end(j));
      Gq[j * nv + i] += dot(w.S[j], m.dof_jnt[j] == m.dof_jnt[i] ? own : turned);
      Gv[i * nv + j] += dot(w.S[j], back);
      Gv[j * nv + i] += dot(w.S[j], by_v);
    }
  }
}

// The same by parameters that change density or viscosity, into columns of `out` (nv x np).
template <class G>
static void fluid_columns(const Model& m, const Options& o, Work<G>& w, bool implicit, T* out, bool late = false) {
  CMBRL_FOR(property, 2) {
    bool known = false;
    for (int c = 0; c < w.np; ++c) {
      int k = w.parameter[c];
      for (int e = m.par_ptr[k]; e < m.par_ptr[k + 1]; ++e) {
        if (m.par_idx[e] != m.oFluid + property) continue;
        T one = splat(1), none = T{};
        if (!known) fluid_wrenches(m, o, w, property == 0 ? Fluid{one, none} : Fluid{none, one}, implicit, late);
        known = true;
        for (int i = 0; i < m.nv; ++i) out[i * w.np + c] += m.par_coef[e] * o.h * dot(w.S[i], w.drag[m.dof_body[i]]);
      }
    }
  }
}

}  // namespace cmbrl::CMBRL_ISA
