// A value with its derivatives with respect to N inputs, carried through the arithmetic (forward mode). Of jets as values,
// second derivatives too. For laws that are written once and whose derivatives are long.
#pragma once
#include "base/pack.hpp"

namespace cmbrl::CMBRL_ISA {

template <class S, int N>
struct Jet { S v; S d[N]; };

template <class S, int N, class F>
static inline Jet<S, N> jet_of(S v, F derivative) {
  Jet<S, N> y;
  y.v = v;
  for (int i = 0; i < N; ++i) y.d[i] = derivative(i);
  return y;
}
template <class S, int N> static inline Jet<S, N> operator+(const Jet<S, N>& a, const Jet<S, N>& b) {
  return jet_of<S, N>(a.v + b.v, [&](int i) { return a.d[i] + b.d[i]; });
}
template <class S, int N> static inline Jet<S, N> operator-(const Jet<S, N>& a, const Jet<S, N>& b) {
  return jet_of<S, N>(a.v - b.v, [&](int i) { return a.d[i] - b.d[i]; });
}
template <class S, int N> static inline Jet<S, N> operator*(const Jet<S, N>& a, const Jet<S, N>& b) {
  return jet_of<S, N>(a.v * b.v, [&](int i) { return a.v * b.d[i] + b.v * a.d[i]; });
}
template <class S, int N> static inline Jet<S, N> operator*(double k, const Jet<S, N>& a) {
  return jet_of<S, N>(k * a.v, [&](int i) { return k * a.d[i]; });
}
template <class S, int N> static inline Jet<S, N> operator*(T k, const Jet<S, N>& a) {
  return jet_of<S, N>(k * a.v, [&](int i) { return k * a.d[i]; });
}
template <class S, int N> static inline Jet<S, N> operator+(double k, const Jet<S, N>& a) {
  Jet<S, N> y = a;
  y.v = k + a.v;
  return y;
}

static inline T base(T a) { return a; }
template <class S, int N> static inline T base(const Jet<S, N>& a) { return base(a.v); }
static inline T kept(Mask lanes, T a) { return keep(lanes, a); }
template <class S, int N> static inline Jet<S, N> kept(Mask lanes, const Jet<S, N>& a) {
  return jet_of<S, N>(kept(lanes, a.v), [&](int i) { return kept(lanes, a.d[i]); });
}

static inline T inverse(T a) { return 1.0 / a; }
template <class S, int N> static inline Jet<S, N> inverse(const Jet<S, N>& a) {
  S v = inverse(a.v), slope = -1.0 * (v * v);
  return jet_of<S, N>(v, [&](int i) { return slope * a.d[i]; });
}
static inline T root(T a) { return vsqrt(vmax(a, splat(1e-60))); }  // at 0 with a finite slope: what it stands in vanishes there
template <class S, int N> static inline Jet<S, N> root(const Jet<S, N>& a) {
  S v = root(a.v), slope = 0.5 * inverse(v);
  return jet_of<S, N>(v, [&](int i) { return slope * a.d[i]; });
}
static inline T at_least(T a, double low) { return vmax(a, splat(low)); }
template <class S, int N> static inline Jet<S, N> at_least(const Jet<S, N>& a, double low) {
  Mask above = base(a) > low;
  return jet_of<S, N>(at_least(a.v, low), [&](int i) { return kept(above, a.d[i]); });
}

}  // namespace cmbrl::CMBRL_ISA
