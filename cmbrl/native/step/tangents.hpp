// Tangents of the state, carried through a step by its implicit derivative: gathered a few columns at a time, solved, and written back.
#pragma once
#include "step/impact.hpp"

namespace cmbrl::CMBRL_ISA {

// dx = q dq + v dv + u du + p dtheta; q, v: with a pattern, or full.
struct Slopes { const T *q, *v, *u, *p; const Pattern* pattern; };

// What columns c to c + n move besides the state: parameters, and controls.
template <int n, class G>
static void add_own(const Model& m, const Work<G>& w, const Slopes& s, int c, T* out) {
  int input = c - (w.nbefore - m.nu), parameter = c - w.nbefore;
  for (int i = 0; parameter + n > 0 && i < m.nv; ++i)
    for (int j = parameter < 0 ? -parameter : 0; j < n; ++j) out[i * n + j] += s.p[i * w.np + parameter + j];
  if (!w.driven) {
    for (int i = 0; input + n > 0 && i < m.nv; ++i)
      for (int j = input < 0 ? -input : 0; j < n && parameter + j < 0; ++j) out[i * n + j] += s.u[i * m.nu + input + j];
    return;
  }
  input = c - (w.nbefore - w.ndriven);
  for (int i = 0; input + n > 0 && parameter < 0 && i < m.nv; ++i)
    for (int k = 0; k < m.nu; ++k)
      for (int j = input < 0 ? -input : 0; j < n && parameter + j < 0; ++j)
        out[i * n + j] += s.u[i * m.nu + k] * w.driven[k * w.ndriven + input + j];
}

// Columns c to c + n of dx by the tangents before the step, into out (nv x n). They are gathered first: rows of all columns lie
// far apart, and would drive each other out of the nearest cache.
template <int n, class G>
static void carried(const Model& m, const Work<G>& w, const Slopes& s, int c, int ncol, T* __restrict out) {
  int nv = m.nv;
  T *__restrict x = w.gathered, *__restrict y = x + nv * n;
  for (int i = 0; i < nv; ++i)
    CMBRL_FOR(j, n) { x[i * n + j] = w.tq[i * ncol + c + j]; y[i * n + j] = w.tv[i * ncol + c + j]; out[i * n + j] = T{}; }
  for (int i = 0; i < nv; ++i) {
    T sum[n];
    CMBRL_FOR(j, n) sum[j] = out[i * n + j];
    auto take = [&](int k) {
      T a = s.q[i * nv + k], b = s.v[i * nv + k];
      CMBRL_FOR(j, n) { sum[j] += a * x[k * n + j]; sum[j] += b * y[k * n + j]; }
    };
    auto give = [&](int k) {
      T a = s.q[k * nv + i], b = s.v[k * nv + i];
      CMBRL_FOR(j, n) { T to = out[k * n + j] + a * x[i * n + j]; out[k * n + j] = to + b * y[i * n + j]; }
    };
    if (s.pattern) {
      take(i);
      const int* columns = s.pattern->columns(i);
      for (int a = 0; a < s.pattern->count(i); ++a) { take(columns[a]); give(columns[a]); }
    } else {
      for (int k = 0; k < nv; ++k) take(k);
    }
    CMBRL_FOR(j, n) out[i * n + j] = sum[j];
  }
  add_own<n>(m, w, s, c, out);
}
template <class G>
static void carry_tangents(const Model& m, const Work<G>& w, const Slopes& s, T* out, int ncol) {
  for_blocks(ncol, [&](int c, auto n) {
    carried<n>(m, w, s, c, ncol, w.tangent_block);
    for (int i = 0; i < m.nv; ++i) CMBRL_FOR(j, n) out[i * ncol + c + j] = w.tangent_block[i * n + j];
  });
}

// tv <- dv' - (Sq dq + Sv dv + Su du + Sp dtheta + Sn dv') / h, from the tangents before the step and dv' in rhs_all; tq becomes
// the tangent of the place of impact.
template <class G>
static void late_tangents(const Model& m, const Options& o, Work<G>& w, int ncol) {
  int nv = m.nv;
  T *out = w.Z, *leap = w.Z + nv * ncol;  // scratch of the same width, free by now
  carry_tangents(m, w, {w.Sq, w.Sv, w.Su, w.Sp, nullptr}, out, ncol);
  for (int i = 0; i < nv; ++i)
    for (int k = 0; k < nv; ++k)
      for (int c = 0; c < ncol; ++c) out[i * ncol + c] += w.Sn[i * nv + k] * w.rhs_all[k * ncol + c];
  if (w.leapt) {
    carry_tangents(m, w, {w.Lq, w.Lv, w.Lu, w.Lp, nullptr}, leap, ncol);
    push_tangent(m, w.leap, w.tq, leap, splat(1), ncol);
  }
  for (int i = 0; i < nv * ncol; ++i) w.tv[i] = w.rhs_all[i] - out[i] * (1 / o.h);
}

// out = (Aq Av Au Ap).
template <class G>
static void columns_of(const Model& m, const Work<G>& w, const T* Aq, const T* Av, const T* Au, const T* Ap, T* out, int ncol) {
  int nv = m.nv, nu = m.nu;
  for (int i = 0; i < nv; ++i) {
    T* row = out + i * ncol;
    for (int k = 0; k < nv; ++k) { row[k] = Aq[i * nv + k]; row[nv + k] = Av[i * nv + k]; }
    for (int k = 0; k < nu; ++k) row[2 * nv + k] = Au[i * nu + k];
    for (int k = 0; k < w.np; ++k) row[2 * nv + nu + k] = Ap[i * w.np + k];
  }
}

// Columns of rhs_all from `first` on: H^-1 rhs, and what split damping makes of it,  dv' = du - dy,  where K dy = D du + late.
// rhs and late write columns c to c + n into an (nv x n) matrix.
template <class G, class Right, class Late>
static void solve_tangents(const Model& m, const Options& o, Work<G>& w, Right rhs, Late late, int first, int count, int ncol) {
  Pattern pat = pattern_of(m, w);
  int nv = m.nv;
  T *u = w.tangent_block, *y = u + nv * kBlock;
  for_blocks(count, [&](int c, auto size) {
    constexpr int n = size;
    rhs(c, size, u);
    solve_columns<n>(w.H, nv, pat, w.below_H, u, n);
    if (o.split) {
      late(c, size, y);
      for_drags(m, w, [&](int i, int k, T damping) { CMBRL_FOR(x, n) y[i * n + x] += damping * u[k * n + x]; });
      solve_columns<n>(w.K, nv, m.mass, w.below_K, y, n);
    }
    for (int i = 0; i < nv; ++i)
      CMBRL_FOR(x, n) w.rhs_all[i * ncol + first + c + x] = o.split ? u[i * n + x] - y[i * n + x] : u[i * n + x];
  });
}

// Columns of a matrix whose rows are `stride` apart; no data: zeros.
static inline auto columns_from(int nv, const T* data, int64_t stride) {
  return [=](int c, auto n, T* to) {
    for (int i = 0; i < nv; ++i)
      CMBRL_FOR(k, n) to[i * n + k] = data ? data[i * stride + c + k] : T{};
  };
}

// rhs_all = dv' of the first substep from the identity.
template <class G>
static void solve_first_tangents(const Model& m, const Options& o, Work<G>& w, int ncol) {
  int nv = m.nv, nu = m.nu;
  auto some = [&](const T* G_, const T* S, int first, int count) {
    solve_tangents(m, o, w, columns_from(nv, G_, count), columns_from(nv, S, count), first, count, ncol);
  };
  some(w.Gq, w.Sq, 0, nv);
  some(w.Gv, w.Sv, nv, nv);
  some(w.Gu, o.split ? w.Su : nullptr, 2 * nv, nu);
  some(w.Gp, w.Sp, 2 * nv + nu, w.np);
}

// Right-hand sides of a leapfrog's first substep, whose tangents are the identity shifted by h/2 v.
template <class G>
static void first_right_sides(const Model& m, const Options& o, Work<G>& w, int ncol) {
  int nv = m.nv;
  columns_of(m, w, w.Gq, w.Gv, w.Gu, w.Gp, w.rhs_all, ncol);
  for (int j = 0; j < m.njoint; ++j) {
    int d = m.jnt_vadr[j];
    if (m.jnt_type[j] != kBall) {
      for (int i = 0; i < nv; ++i) w.rhs_all[i * ncol + nv + d] += 0.5 * o.h * w.rhs_all[i * ncol + d];
      continue;
    }
    for (int i = 0; i < nv; ++i) {  // columns times d(q shifted)/d(q, v), kept in tq
      T* row = w.rhs_all + i * ncol;
      T old[3] = {row[d], row[d + 1], row[d + 2]};
      CMBRL_FOR(c, 3) {
        T a = T{}, b = T{};
        CMBRL_FOR(k, 3) { a += old[k] * w.tq[(d + k) * ncol + d + c]; b += old[k] * w.tq[(d + k) * ncol + nv + d + c]; }
        row[d + c] = a;
        row[nv + d + c] += b;
      }
    }
  }
}

// Columns: dq (nv), dv (nv), u (nu), then theta. tq, tv hold d(q, v)/d(columns) and are advanced by one step.
template <class G>
static void advance_tangents(const Model& m, const Options& o, Work<G>& w, int ncol, bool first) {
  Pattern pat = pattern_of(m, w);
  bool sparse = !w.early && !w.ahead;  // G has the pattern of the factor but for what looks at the free velocity
  auto carry = [&](const Slopes& s) { return [&m, &w, s, ncol](int c, auto n, T* to) { carried<n>(m, w, s, c, ncol, to); }; };
  auto late = carry({w.Sq, w.Sv, w.Su, w.Sp, &m.mass});
  w.below_H.fill(pat, m.nv);
  if (o.split) w.below_K.fill(m.mass, m.nv);
  if (first && !o.leapfrog) {
    solve_first_tangents(m, o, w, ncol);
  } else if (first) {
    first_right_sides(m, o, w, ncol);
    solve_tangents(m, o, w, columns_from(m.nv, w.rhs_all, ncol), late, 0, ncol, ncol);
  } else {
    solve_tangents(m, o, w, carry({w.Gq, w.Gv, w.Gu, w.Gp, sparse ? &pat : nullptr}), late, 0, ncol, ncol);
  }
  if (w.late) late_tangents(m, o, w, ncol);  // tv becomes the tangent of the displacement / h
  push_tangent(m, w.qtan, w.tq, w.late ? w.tv : w.rhs_all, splat(o.h), ncol);
  T* moved = w.tv;
  w.tv = w.rhs_all;
  w.rhs_all = moved;
}

}  // namespace cmbrl::CMBRL_ISA
