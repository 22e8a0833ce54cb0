// One Newton direction of the softened contact problem, in joint space: M + J^T Theta J with the sparsity of the tree.
// Rows are split form: gamma s, (mu gamma, beta) o (eta0, eta); contacts of one body pair are summed before they meet dofs.
// The law of sliding is in the slack of the normal row:  s = c_n  is Coulomb's,  s = c_n - mu eta0  the convex one (Anitescu, Math.
// Program. 2006), where what slides is lifted until c is in the dual cone. On the path its Theta is symmetric, and one solution exists.
#pragma once
#include "solver/block.hpp"
#include "collision/contact.hpp"
#include "solver/factor.hpp"

namespace cmbrl::CMBRL_ISA {

// The longest step that all rows so far allow, as a quotient: rows are compared without a division each.
struct Quotient {
  T num, den;
  void lower(Mask some, T x, T y) {
    Mask less = some & (x * den < num * y);
    num = select(less, x, num);
    den = select(less, y, den);
  }
};

template <class G>
struct Newton {
  static constexpr int NT = G::NT;
  const Structure& m;
  const Options& o;
  SolverWork<G>& w;
  Pattern pat;
  T rho;  // what is left of the linear residuals of the start
  bool heads = true;  // eta0 is an unknown: Newton on the law itself has none
  double yield = 0;  // rows are linearised as if they yielded by this share of their weight: a better conditioned matrix

  Newton(const Structure& m_, const Options& o_, SolverWork<G>& w_) : m(m_), o(o_), w(w_), pat(pattern_of(m_, w_)) {}

  // The unit twist of the k-th entry of the groups' dofs: one per dof, or one per entry where groups see a dof differently.
  const Vec<G::N>& column(int k) const { return w.S[G::kColumnPerDof ? m.grp_dof[k] : k]; }
  // Dofs that carry body B of a pair count against those of A; where every entry has its own column, that has the sign.
  bool against(int k) const { return G::kColumnPerDof && m.grp_sign[k] < 0; }
  Vec<G::N> twist(int group, const T* x) const {
    Vec<G::N> t = zero<G::N>();
    for (int k = m.grp_dptr[group]; k < m.grp_dptr[group + 1]; ++k)
      if (against(k)) t -= x[m.grp_dof[k]] * column(k);
      else t += x[m.grp_dof[k]] * column(k);
    return t;
  }
  void add_wrench(int group, const Vec<G::N>& F, T* x) const {
    for (int k = m.grp_dptr[group]; k < m.grp_dptr[group + 1]; ++k) {
      T f = dot(column(k), F);
      x[m.grp_dof[k]] += against(k) ? -f : f;
    }
  }

  // Theta and the target part w of dx = w - Theta J dv, for targets (t4, t50, t5) minus the second-order terms.
  void linearise(Contact<G>& c, T t4, T t50, const T* t5) {
    c.t50 = t50;
    T soft = yield * c.root * c.root, pn = c.s + c.gam * (c.Rn + soft), yn = t4 - c.gam * c.s + c.gam * rho * c.r1;
    if (c.rows == 1) return linearise_normal(c, pn, yn);
    with_tangents(c, [&](auto count) { linearise_friction<count.value>(c, pn, yn, t5, rho, soft, o.convex); });
  }
  // What the convex law takes from the slack of the normal row.
  T lift(const Contact<G>& c, T eta0) const { return o.convex && heads && c.rows > 1 ? keep(c.convex, c.mu * eta0) : T{}; }
  // Whether row r of a contact is coupled to its tangents.
  bool coupled(int r) const { return r > 0 || o.convex; }
  void linearise(Limit& l, T t4) {
    T inv = 1.0 / (l.s + l.gam * l.R);
    l.Th = keep(l.on, l.gam * inv);
    l.w = keep(l.on, (t4 - l.gam * l.s + l.gam * rho * l.r1) * inv);
  }
  void linearise(DryFriction& d, T t50, T t5) {
    d.t50 = t50;
    T ib0 = d.ib0, B = d.b0 - d.b * d.b * ib0;
    T q0 = t50 - d.b0 * d.eta0 - d.b * d.eta + d.b * rho * d.r2;
    T y = t5 - d.b0 * d.eta - d.eta0 * d.b + d.b0 * rho * d.r2 - d.b * ib0 * q0;
    T inv = 1.0 / (d.eta0 - d.b * d.eta * ib0 + d.R * B);
    d.Th = keep(d.on, B * inv);
    d.w = keep(d.on, y * inv);
  }

  // Targets kappa_i + centre per product, in the lanes of `correct` minus the products of the last steps (Mehrotra's correction).
  void linearise_all(T centre, Mask correct) {
    for (int i = 0; i < w.ncon; ++i) {
      Contact<G>& c = w.con[i];
      T t4 = c.kappa + centre - keep(correct, c.dgam * c.ds), t50 = c.kappa + centre, t5[G::MT];
      if (c.rows > 1) {
        T db0 = c.mu * c.dgam;
        t50 -= keep(correct, db0 * c.deta0);
        with_tangents(c, [&](auto count) {
          CMBRL_FOR(r, count.value) {
            t50 -= keep(correct, c.db[r] * c.deta[r]);
            t5[r] = -keep(correct, db0 * c.deta[r] + c.deta0 * c.db[r]);
          }
        });
      }
      linearise(c, t4, t50, t5);
    }
    for (int i = 0; i < w.nlim; ++i) linearise(w.lim[i], w.lim[i].kappa + centre - keep(correct, w.lim[i].dgam * w.lim[i].ds));
    for (int i = 0; i < w.ndry; ++i) {
      DryFriction& d = w.dry[i];
      linearise(d, d.kappa + centre - keep(correct, d.db * d.deta), -keep(correct, d.deta0 * d.db));
    }
  }

  // H = H0 + J^T Theta J on the dynamic dofs, factorised. Contacts of one body pair are summed as one N x N matrix first.
  void factorise() {
    for (int i = 0; i < w.ndyn; ++i) copy_row(w.H, w.H0, pat, w.dyn_list[i], w.skew[w.dyn_list[i]]);
    for (int g = 0; g < w.ngroups; ++g) {
      T K[G::N][G::N] = {};
      for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
        const Contact<G>& c = w.con[i];
        CMBRL_FOR(r, c.rows) {
          Vec<G::N> F = c.Th[r][0] * c.Wr[0];
          for (int k = 1; k < c.rows && coupled(r); ++k) F += c.Th[r][k] * c.Wr[k];
          CMBRL_FOR(a, G::N) CMBRL_FOR(b, G::N) K[a][b] += c.Wr[r][a] * F[b];
        }
      }
      add_to_factor(w.groups[g].group, K);
    }
    for (int i = 0; i < w.nlim; ++i) add_square(m, w, w.lim[i], w.lim[i].Th, w.H, pat);
    for (int i = 0; i < w.ndry; ++i) add_square(m, w, w.dry[i].line, w.dry[i].Th, w.H, pat);
    for (int i = 0, alike; i < w.ndyn;) {
      int k = w.dyn_list[i], skew = w.skew[k];
      for (alike = 1; alike < kRun && i + alike < w.ndyn && w.dyn_list[i + alike] == k - alike && w.skew[k - alike] == skew;) ++alike;
      i += skew ? eliminate_chain<false>(w.H, pat, k, alike) : eliminate_chain<true>(w.H, pat, k, alike, w.skew);
    }
  }
  // J^T K J of one group, row by row: `pull` is that of one dof.
  Vec<G::N> pull(int k, const T (*K)[G::N]) const {
    const Vec<G::N>& S = column(k);
    Vec<G::N> F = S[0] * row_of(K, 0);
    for (int r = 1; r < G::N; ++r) F += S[r] * row_of(K, r);
    return against(k) ? zero<G::N>() - F : F;
  }
  T entry(const Vec<G::N>& F, int k) const { return against(k) ? -dot(F, column(k)) : dot(F, column(k)); }
  void add_to_factor(int group, const T (*K)[G::N]) const {
    int begin = m.grp_dptr[group], n = m.grp_dptr[group + 1] - begin;
    const int* dof = m.grp_dof + begin;
    for (int a = 0; a < n; ++a) {
      w.pulls[a] = pull(begin + a, K);
      Row<T> row(w.H, pat, dof[a]);
      const int* columns = pat.columns(dof[a]);
      *row.diagonal += entry(w.pulls[a], begin + a);
      for (int b = 0, x = 0; b < a; ++b, ++x) {
        while (columns[x] != dof[b]) ++x;  // both rise
        row.before[x] += entry(w.pulls[a], begin + b);
        row.mirror[x] += entry(w.pulls[b], begin + a);
      }
    }
  }
  void add_group_matrix(int group, const T (*K)[G::N], T* dense) const {
    for (int a = m.grp_dptr[group]; a < m.grp_dptr[group + 1]; ++a) {
      Vec<G::N> F = pull(a, K);
      for (int b = m.grp_dptr[group]; b < m.grp_dptr[group + 1]; ++b) dense[m.grp_dof[a] * m.nv + m.grp_dof[b]] += entry(F, b);
    }
  }
  static const Vec<G::N>& row_of(const T (*K)[G::N], int r) { return reinterpret_cast<const Vec<G::N>&>(*K[r]); }

  // Newton direction for the current linearisation; returns the longest feasible step.
  T direction() {
    for (int i = 0; i < w.ndyn; ++i) w.rhs[w.dyn_list[i]] = rho * w.rv[w.dyn_list[i]];
    for (int g = 0; g < w.ngroups; ++g) {
      Vec<G::N> F = zero<G::N>();
      for (int i = w.groups[g].begin; i < w.groups[g].end; ++i)
        CMBRL_FOR(r, w.con[i].rows) F += w.con[i].w[r] * w.con[i].Wr[r];
      add_wrench(w.groups[g].group, F, w.rhs);
    }
    for (int i = 0; i < w.nlim; ++i) add_pull(m, w, w.lim[i], w.lim[i].w, w.rhs);
    for (int i = 0; i < w.ndry; ++i) add_pull(m, w, w.dry[i].line, w.dry[i].w, w.rhs);
    for (int i = 0; i < w.ndyn; ++i) solve_down(w.H, w.below, w.dyn_list[i], w.rhs);
    for (int i = w.ndyn - 1; i >= 0; --i) solve_up(w.H, pat, w.dyn_list[i], w.rhs);

    Quotient alpha{splat(1e3), splat(1)};
    for (int g = 0; g < w.ngroups; ++g) {
      Vec<G::N> t = twist(w.groups[g].group, w.rhs);
      for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) step_of(w.con[i], t, alpha);
    }
    for (int i = 0; i < w.nlim; ++i) {
      Limit& l = w.lim[i];
      T jv = along(m, w, l, w.rhs);
      l.dgam = l.w - l.Th * jv;
      l.ds = keep(l.on, jv + l.R * l.dgam - rho * l.r1);
      shorten(alpha, l.gam, l.dgam);
      shorten(alpha, l.s, l.ds);
    }
    for (int i = 0; i < w.ndry; ++i) {
      DryFriction& d = w.dry[i];
      T jv = along(m, w, d.line, w.rhs);
      d.db = d.w - d.Th * jv;
      d.deta = keep(d.on, jv + d.R * d.db - rho * d.r2);
      T q0 = d.t50 - d.b0 * d.eta0 - d.b * d.eta;
      d.deta0 = keep(d.on, (q0 - d.b * d.deta - d.eta * d.db) * d.ib0);
      shorten_in_cone<1>(alpha, d.b0, &d.b, T{}, &d.db);
      shorten_in_cone<1>(alpha, d.eta0, &d.eta, d.deta0, &d.deta);
    }
    return alpha.num / alpha.den;
  }

  void step_of(Contact<G>& c, const Vec<G::N>& t, Quotient& alpha) {
    T jv[1 + G::MT];
    jv[0] = dot(c.Wr[0], t);
    for (int r = 1; r < c.rows; ++r) jv[r] = dot(c.Wr[r], t);
    c.dgam = c.w[0] - c.Th[0][0] * jv[0];
    for (int k = 1; k < c.rows && o.convex; ++k) c.dgam -= c.Th[0][k] * jv[k];
    c.ds = keep(c.on, jv[0] + c.Rn * c.dgam - rho * c.r1);
    with_tangents(c, [&](auto count) { friction_step<count.value>(c, jv, alpha); });
    shorten(alpha, c.gam, c.dgam);
    shorten(alpha, c.s, c.ds);
  }
  template <int K> void friction_step(Contact<G>& c, const T* jv, Quotient& alpha) {
    Mask on = c.on & c.rub;
    CMBRL_FOR(r, K) {
      c.db[r] = c.w[1 + r] - c.Th[1 + r][0] * jv[0];
      CMBRL_FOR(k, K) c.db[r] -= c.Th[1 + r][1 + k] * jv[1 + k];
      c.deta[r] = keep(on, jv[1 + r] + c.Rt * c.db[r] - rho * c.r2[r]);
    }
    T b0 = c.mu * c.gam, db0 = keep(on, c.mu * c.dgam);
    T q0 = c.t50 - b0 * c.eta0 - c.eta0 * db0;
    CMBRL_FOR(r, K) q0 -= c.b[r] * c.eta[r] + c.b[r] * c.deta[r] + c.eta[r] * c.db[r];
    c.deta0 = keep(on, q0 / b0);
    c.ds -= lift(c, c.deta0);
    shorten_in_cone<K>(alpha, b0, c.b, db0, c.db);
    shorten_in_cone<K>(alpha, c.eta0, c.eta, c.deta0, c.deta);
  }

  static void shorten(Quotient& alpha, T x, T dx) { alpha.lower(dx < 0.0, x, -dx); }
  template <int N> static void shorten_in_cone(Quotient& alpha, T x0, const T* x, T dx0, const T* dx) {
    if constexpr (N == 1) {
      shorten(alpha, x0 + x[0], dx0 + dx[0]);
      shorten(alpha, x0 - x[0], dx0 - dx[0]);
    } else {
      ConeStep step = step_in_cone<N>(x0, x, dx0, dx);
      alpha.lower(step.ends, step.num, step.den);
      shorten(alpha, x0, dx0);
    }
  }

  // Longest step that keeps x + a dx from 0.
  static T orthant(T x, T dx) { return select(dx < 0.0, -x / dx, splat(1e3)); }
  // Longest step that keeps (x0, x) + a (dx0, dx) in the second-order cone and its mirror image, as a quotient.
  struct ConeStep { Mask ends; T num, den; };
  template <int N> static ConeStep step_in_cone(T x0, const T* x, T dx0, const T* dx) {
    T a = dx0 * dx0, b = x0 * dx0, c = x0 * x0;
    CMBRL_FOR(i, N) { a -= dx[i] * dx[i]; b -= x[i] * dx[i]; c -= x[i] * x[i]; }
    T disc = b * b - a * c, den = vsqrt(vmax(disc, T{})) - b;
    return {((a < 0.0) | ((b < 0.0) & (disc >= 0.0))) & (den > 0.0), c, den};
  }
  template <int N> static T cone(T x0, const T* x, T dx0, const T* dx) {
    Quotient alpha{splat(1e3), splat(1)};
    shorten_in_cone<N>(alpha, x0, x, dx0, dx);
    return alpha.num / alpha.den;
  }
};

}  // namespace cmbrl::CMBRL_ISA
