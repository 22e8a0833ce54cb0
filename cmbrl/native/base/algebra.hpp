// Rigid-body algebra in the plane and in space behind one set of names, all quantities in world axes about one point O.
// Motion = (angular, linear), Force = (moment about O, force). Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 2.
#pragma once
#include "base/pack.hpp"

namespace cmbrl::CMBRL_ISA {

template <int D>
struct Vec {
  static constexpr int size = D;
  T x[D];
  T& operator[](int i) { return x[i]; }
  const T& operator[](int i) const { return x[i]; }
};
#define CMBRL_FOR(i, n) for (int i = 0; i < (n); ++i)

template <int D> static inline Vec<D> operator+(Vec<D> a, const Vec<D>& b) { CMBRL_FOR(i, D) a.x[i] += b.x[i]; return a; }
template <int D> static inline Vec<D> operator-(Vec<D> a, const Vec<D>& b) { CMBRL_FOR(i, D) a.x[i] -= b.x[i]; return a; }
template <int D> static inline Vec<D> operator*(T s, Vec<D> a) { CMBRL_FOR(i, D) a.x[i] *= s; return a; }
template <int D> static inline Vec<D> operator*(double s, Vec<D> a) { CMBRL_FOR(i, D) a.x[i] *= s; return a; }
template <int D> static inline Vec<D>& operator+=(Vec<D>& a, const Vec<D>& b) { CMBRL_FOR(i, D) a.x[i] += b.x[i]; return a; }
template <int D> static inline Vec<D>& operator-=(Vec<D>& a, const Vec<D>& b) { CMBRL_FOR(i, D) a.x[i] -= b.x[i]; return a; }
template <int D> static inline T dot(const Vec<D>& a, const Vec<D>& b) {
  T r = a.x[0] * b.x[0];
  for (int i = 1; i < D; ++i) r += a.x[i] * b.x[i];
  return r;
}
template <int D> static inline Vec<D> zero() { Vec<D> r; CMBRL_FOR(i, D) r.x[i] = T{}; return r; }
template <int D> static inline Vec<D> load(const double* p) { Vec<D> r; CMBRL_FOR(i, D) r.x[i] = splat(p[i]); return r; }
static inline Vec<3> cross(const Vec<3>& a, const Vec<3>& b) {
  return {{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]}};
}

struct Planar {
  static constexpr int D = 2, A = 1, N = 3, NT = 1, MT = 2, SYM = 1;
  static constexpr bool kColumnPerDof = true;
  using V = Vec<2>;
  using Motion = Vec<3>;  // (omega, vx, vy)
  using Ang = Vec<1>;
  struct Rot { T c, s; };
  static V turn(const Ang& w, const V& r) { return {{-w[0] * r[1], w[0] * r[0]}}; }                 // w x r
  static Ang moment(const V& r, const V& f) { return {{r[0] * f[1] - r[1] * f[0]}}; }               // r x f
  static Ang cross_ang(const Ang&, const Ang&) { return {{T{}}}; }
  static V rotate(const Rot& R, const V& a) { return {{R.c * a[0] - R.s * a[1], R.s * a[0] + R.c * a[1]}}; }
  static V unrotate(const Rot& R, const V& a) { return {{R.c * a[0] + R.s * a[1], R.c * a[1] - R.s * a[0]}}; }
  static Rot compose(const Rot& a, const Rot& b) { return {a.c * b.c - a.s * b.s, a.s * b.c + a.c * b.s}; }
  static Rot load_rot(const double* p) { return {splat(p[0]), splat(p[1])}; }
  static Rot inverse(const Rot& R) { return {R.c, -R.s}; }
  static Rot identity() { return {splat(1), T{}}; }
  static Ang sym_mul(const T* I, const Ang& w) { return {{I[0] * w[0]}}; }
  // inertia about the centre of mass in body axes -> world axes
  static void sym_rotate(const Rot&, const T* body, T* world) { world[0] = body[0]; }
  static void add_steiner(T* I, T m, const V& c) { I[0] += m * dot(c, c); }
  static void add_steiner_derivative(T* I, T m, const V& c, const V& dc) { I[0] += 2.0 * m * dot(c, dc); }
  // X of the composite velocity matrix 2B = [[X, 0], [-2 p x, 0]] (see dynamics.hpp)
  static constexpr int NX = 1;
  static void coriolis(T* X, const T*, const V& h, const Ang&, const V& v) { X[0] = 2.0 * dot(h, v); }
  static Ang X_mul(const T* X, const Ang& a) { return {{X[0] * a[0]}}; }
  static Ang Xt_mul(const T* X, const Ang& a) { return {{X[0] * a[0]}}; }
};

struct Spatial {
  static constexpr int D = 3, A = 3, N = 6, NT = 2, MT = 5, SYM = 6;
  static constexpr bool kColumnPerDof = true;
  using V = Vec<3>;
  using Motion = Vec<6>;
  using Ang = Vec<3>;
  struct Rot { T m[9]; };
  static V turn(const Ang& w, const V& r) { return cross(w, r); }
  static Ang moment(const V& r, const V& f) { return cross(r, f); }
  static Ang cross_ang(const Ang& a, const Ang& b) { return cross(a, b); }
  static V rotate(const Rot& R, const V& a) {
    V r;
    CMBRL_FOR(i, 3) r[i] = R.m[3 * i] * a[0] + R.m[3 * i + 1] * a[1] + R.m[3 * i + 2] * a[2];
    return r;
  }
  static V unrotate(const Rot& R, const V& a) {
    V r;
    CMBRL_FOR(i, 3) r[i] = R.m[i] * a[0] + R.m[3 + i] * a[1] + R.m[6 + i] * a[2];
    return r;
  }
  static Rot compose(const Rot& a, const Rot& b) {
    Rot r;
    CMBRL_FOR(i, 3) CMBRL_FOR(j, 3)
      r.m[3 * i + j] = a.m[3 * i] * b.m[j] + a.m[3 * i + 1] * b.m[3 + j] + a.m[3 * i + 2] * b.m[6 + j];
    return r;
  }
  static Rot load_rot(const double* p) { Rot r; CMBRL_FOR(i, 9) r.m[i] = splat(p[i]); return r; }
  static Rot inverse(const Rot& R) {
    Rot r;
    CMBRL_FOR(i, 3) CMBRL_FOR(j, 3) r.m[3 * i + j] = R.m[3 * j + i];
    return r;
  }
  static Rot identity() { Rot r; CMBRL_FOR(i, 9) r.m[i] = splat(i % 4 == 0); return r; }
  // symmetric 3x3 stored xx, yy, zz, xy, xz, yz
  static Ang sym_mul(const T* I, const Ang& w) {
    return {{I[0] * w[0] + I[3] * w[1] + I[4] * w[2], I[3] * w[0] + I[1] * w[1] + I[5] * w[2],
             I[4] * w[0] + I[5] * w[1] + I[2] * w[2]}};
  }
  static void sym_rotate(const Rot& R, const T* b, T* world) {
    Rot t;  // R * I
    CMBRL_FOR(i, 3) {
      Ang row = sym_mul(b, {{R.m[3 * i], R.m[3 * i + 1], R.m[3 * i + 2]}});
      CMBRL_FOR(j, 3) t.m[3 * i + j] = row[j];
    }
    auto at = [&](int i, int j) { return t.m[3 * i] * R.m[3 * j] + t.m[3 * i + 1] * R.m[3 * j + 1] + t.m[3 * i + 2] * R.m[3 * j + 2]; };
    world[0] = at(0, 0); world[1] = at(1, 1); world[2] = at(2, 2);
    world[3] = at(0, 1); world[4] = at(0, 2); world[5] = at(1, 2);
  }
  static void add_steiner(T* I, T m, const V& c) { add_steiner_derivative(I, 0.5 * m, c, c); }
  static void add_steiner_derivative(T* I, T m, const V& c, const V& dc) {
    T xx = c[0] * dc[0], yy = c[1] * dc[1], zz = c[2] * dc[2];
    I[0] += 2.0 * m * (yy + zz); I[1] += 2.0 * m * (xx + zz); I[2] += 2.0 * m * (xx + yy);
    I[3] -= m * (c[0] * dc[1] + c[1] * dc[0]);
    I[4] -= m * (c[0] * dc[2] + c[2] * dc[0]);
    I[5] -= m * (c[1] * dc[2] + c[2] * dc[1]);
  }
  static constexpr int NX = 9;
  static void coriolis(T* X, const T* I, const V& h, const Ang& w, const V& v) {
    // Y = sum m u r^T = v h^T + [w]x C,  C = tr(I)/2 - I (second moment);  X = 2 (tr(Y) 1 - Y)
    T t = 0.5 * (I[0] + I[1] + I[2]);
    T C[9] = {t - I[0], -I[3], -I[4], -I[3], t - I[1], -I[5], -I[4], -I[5], t - I[2]};
    T Y[9];
    CMBRL_FOR(j, 3) {
      Y[j] = v[0] * h[j] + w[1] * C[6 + j] - w[2] * C[3 + j];
      Y[3 + j] = v[1] * h[j] + w[2] * C[j] - w[0] * C[6 + j];
      Y[6 + j] = v[2] * h[j] + w[0] * C[3 + j] - w[1] * C[j];
    }
    T tr = Y[0] + Y[4] + Y[8];
    CMBRL_FOR(i, 9) X[i] = -2.0 * Y[i];
    X[0] += 2.0 * tr; X[4] += 2.0 * tr; X[8] += 2.0 * tr;
  }
  static Ang X_mul(const T* X, const Ang& a) {
    Ang r;
    CMBRL_FOR(i, 3) r[i] = X[3 * i] * a[0] + X[3 * i + 1] * a[1] + X[3 * i + 2] * a[2];
    return r;
  }
  static Ang Xt_mul(const T* X, const Ang& a) {
    Ang r;
    CMBRL_FOR(i, 3) r[i] = X[i] * a[0] + X[3 + i] * a[1] + X[6 + i] * a[2];
    return r;
  }
};

// A moment, or an angular velocity, in body axes -> world axes.
static inline Vec<1> rotate_moment(const Planar&, const Planar::Rot&, const Vec<1>& a) { return a; }
static inline Vec<3> rotate_moment(const Spatial&, const Spatial::Rot& R, const Vec<3>& a) { return Spatial::rotate(R, a); }

// Everything below is common to both algebras.
template <class G> static inline typename G::Ang ang(const Vec<G::N>& m) {
  typename G::Ang r; CMBRL_FOR(i, G::A) r[i] = m[i]; return r;
}
template <class G> static inline typename G::V lin(const Vec<G::N>& m) {
  typename G::V r; CMBRL_FOR(i, G::D) r[i] = m[G::A + i]; return r;
}
template <class G> static inline Vec<G::N> join(const typename G::Ang& a, const typename G::V& l) {
  Vec<G::N> r; CMBRL_FOR(i, G::A) r[i] = a[i]; CMBRL_FOR(i, G::D) r[G::A + i] = l[i]; return r;
}
template <class G> static inline Vec<G::N> cross_motion(const Vec<G::N>& v, const Vec<G::N>& m) {
  return join<G>(G::cross_ang(ang<G>(v), ang<G>(m)), G::turn(ang<G>(v), lin<G>(m)) - G::turn(ang<G>(m), lin<G>(v)));
}
template <class G> static inline Vec<G::N> cross_force(const Vec<G::N>& v, const Vec<G::N>& f) {
  return join<G>(G::cross_ang(ang<G>(v), ang<G>(f)) + G::moment(lin<G>(v), lin<G>(f)), G::turn(ang<G>(v), lin<G>(f)));
}
template <class G> static inline typename G::V point_velocity(const Vec<G::N>& m, const typename G::V& p) {
  return lin<G>(m) + G::turn(ang<G>(m), p);
}

template <class G> struct Inertia {
  T m;
  typename G::V h;  // m * centre of mass (about O)
  T I[G::SYM];      // about O
  Inertia& operator+=(const Inertia& o) { m += o.m; h += o.h; CMBRL_FOR(i, G::SYM) I[i] += o.I[i]; return *this; }
};
template <class G> static inline Vec<G::N> operator*(const Inertia<G>& J, const Vec<G::N>& v) {
  typename G::Ang w = ang<G>(v);
  typename G::V u = lin<G>(v);
  return join<G>(G::sym_mul(J.I, w) + G::moment(J.h, u), J.m * u + G::turn(w, J.h));
}

}  // namespace cmbrl::CMBRL_ISA
