// Interior point for one step: predictor-corrector to a fixed central-path parameter kappa, split form
//   gamma s = kappa,   (mu gamma, beta) o (eta0, eta) = kappa (1, 0)          [Mehrotra 1992; Dojo, arXiv 2203.00806]
// in joint space, M + J^T Theta J with the sparsity of the tree. Lanes stop by themselves; masks keep them still.
#pragma once
#include "contact.hpp"
#include "factor.hpp"

namespace cmbrl::CMBRL_ISA {

// follow: along the path from a large kappa down, centred at each of them, instead of straight to the end, with a share
// `friction` of the coefficients of friction, which then grows back: paths of large friction fold, those of small do not.
struct Strategy { double tau, sigma, start; bool corrector, follow; int iterations; double friction = 1, growth = 1e3; };

template <class G>
struct InteriorPoint {
  static constexpr int NT = G::NT;
  const Model& m;
  const Options& o;
  Work<G>& w;
  Pattern pat;
  T rho, zeta, count;
  T linear;  // size of the linear residuals at the start, relative to the speeds of the rows; at least 1

  InteriorPoint(const Model& m_, const Options& o_, Work<G>& w_) : m(m_), o(o_), w(w_), pat(pattern_of(m_, w_)) {}

  Vec<G::N> twist(int group, const T* x) const {
    Vec<G::N> t = zero<G::N>();
    for (int k = m.grp_dptr[group]; k < m.grp_dptr[group + 1]; ++k)
      if (m.grp_sign[k] > 0) t += x[m.grp_dof[k]] * w.S[m.grp_dof[k]];
      else t -= x[m.grp_dof[k]] * w.S[m.grp_dof[k]];
    return t;
  }
  void add_wrench(int group, const Vec<G::N>& F, T* x) const {
    for (int k = m.grp_dptr[group]; k < m.grp_dptr[group + 1]; ++k) {
      T f = dot(w.S[m.grp_dof[k]], F);
      x[m.grp_dof[k]] += m.grp_sign[k] > 0 ? f : -f;
    }
  }

  // Centred start: every product equals zeta^2 (in rows scaled by the inverse weight).
  void start(double factor) {
    zeta = T{};
    count = T{};
    auto widen = [&](Mask on, T c, T kappa, double weight) {
      zeta = vmax(zeta, keep(on, vmax(factor * vabs(c) * (1 / __builtin_sqrt(weight)), vsqrt(kappa))));
    };
    for (int k = 0; k < m.nv; ++k) w.rv[k] = w.delta[k] = T{};
    for (int g = 0; g < w.ngroups; ++g) {
      Vec<G::N> t = twist(w.groups[g].group, w.vf);
      for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
        Contact<G>& c = w.con[i];
        double weight = m.con_invweight[c.index];
        c.r1 = dot(c.Wr[0], t) + c.cn0;
        widen(c.on, c.r1, c.kappa, weight);
        for (int r = 1; r < c.rows; ++r) {
          c.r2[r - 1] = dot(c.Wr[r], t) + c.ct0[r - 1];
          widen(c.on, c.r2[r - 1], c.kappa, weight);
        }
        count += select(c.on, splat(1), T{}) + select(c.on & c.rub, splat(1), T{});
      }
    }
    for (int i = 0; i < w.nlim; ++i) {
      Limit& l = w.lim[i];
      l.r1 = l.sign * w.vf[l.dof] + l.c0;
      widen(l.on, l.r1, l.kappa, m.lim_invweight[l.index]);
      count += select(l.on, splat(1), T{});
    }
    for (int i = 0; i < w.ndry; ++i) {
      DryFriction& d = w.dry[i];
      d.r2 = w.vf[d.dof] + d.c0;
      widen(d.on, d.r2, d.kappa, m.dof_invweight[d.dof]);
      count += select(d.on, splat(1), T{});
    }
    zeta = vmax(zeta, splat(1e-12));
    if (factor > 1) zeta = vmax(zeta, splat(1));
    linear = splat(1);
    auto compare = [&](Mask on, T r, double root) { linear = vmax(linear, keep(on, factor * vabs(r) / (root * zeta))); };
    for (int g = 0; g < w.ngroups; ++g) {
      Vec<G::N> F = zero<G::N>();
      for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
        Contact<G>& c = w.con[i];
        double root = __builtin_sqrt(m.con_invweight[c.index]);
        c.gam = zeta / root;
        c.s = zeta * root;
        c.r1 = c.s - (c.r1 + c.Rn * c.gam);
        compare(c.on, c.r1, root);
        F += keep(c.on, c.gam) * c.Wr[0];
        for (int r = 1; r < c.rows; ++r) {
          c.b[r - 1] = c.eta[r - 1] = T{};
          c.r2[r - 1] = -c.r2[r - 1];
        }
        c.eta0 = c.s / c.mu;
      }
      add_wrench(w.groups[g].group, F, w.rv);
    }
    for (int i = 0; i < w.nlim; ++i) {
      Limit& l = w.lim[i];
      double root = __builtin_sqrt(m.lim_invweight[l.index]);
      l.gam = zeta / root;
      l.s = zeta * root;
      l.r1 = l.s - (l.r1 + l.R * l.gam);
      compare(l.on, l.r1, root);
      w.rv[l.dof] += keep(l.on, l.sign * l.gam);
    }
    for (int i = 0; i < w.ndry; ++i) {
      DryFriction& d = w.dry[i];
      d.b = d.eta = T{};
      d.r2 = -d.r2;
      d.eta0 = zeta * zeta / d.b0;
    }
    rho = splat(1);  // rv now holds J^T x0, the momentum residual -(M delta - J^T x) at the start
  }

  // Theta and the target part w of dx = w - Theta J dv, for targets (t4, t50, t5) minus the second-order terms.
  void linearise(Contact<G>& c, T t4, T t50, const T* t5) {
    c.t50 = t50;
    T pn = c.s + c.gam * c.Rn;
    T inv = c.ipn = 1.0 / pn;
    c.Th[0][0] = keep(c.on, c.gam * inv);
    c.w[0] = keep(c.on, (t4 - c.gam * c.s + c.gam * rho * c.r1) * inv);
    if (c.rows == 1) return;
    Mask on = c.on & c.rub;
    T mu = c.mu, b0 = mu * c.gam, ib0 = 1.0 / b0;
    T y[NT], A[NT][NT], B[NT][NT], *a = c.ta;
    T q0 = t50 - b0 * c.eta0;
    CMBRL_FOR(i, NT) q0 += c.b[i] * (rho * c.r2[i] - c.eta[i]);
    CMBRL_FOR(i, NT) {
      y[i] = t5[i] - b0 * c.eta[i] - c.eta0 * c.b[i] + b0 * rho * c.r2[i] - c.b[i] * ib0 * q0;
      a[i] = mu * (c.eta[i] - c.b[i] * c.eta0 * ib0);
      CMBRL_FOR(j, NT) {
        B[i][j] = (i == j ? b0 : T{}) - c.b[i] * c.b[j] * ib0;
        A[i][j] = (i == j ? c.eta0 : T{}) - c.b[i] * c.eta[j] * ib0 + c.Rt * B[i][j];
      }
    }
    auto& Ai = c.Ai;
    if constexpr (NT == 1) {
      Ai[0][0] = 1.0 / A[0][0];
    } else {
      T idet = 1.0 / (A[0][0] * A[1][1] - A[0][1] * A[1][0]);
      Ai[0][0] = A[1][1] * idet; Ai[1][1] = A[0][0] * idet;
      Ai[0][1] = -A[0][1] * idet; Ai[1][0] = -A[1][0] * idet;
    }
    CMBRL_FOR(i, NT) {
      T wn = T{}, tn = T{};
      c.Th[0][1 + i] = T{};
      CMBRL_FOR(j, NT) {
        wn += Ai[i][j] * (y[j] - a[j] * c.w[0]);
        tn -= Ai[i][j] * a[j];
        T x = T{};
        CMBRL_FOR(k, NT) x += Ai[i][k] * B[k][j];
        c.Th[1 + i][1 + j] = keep(on, x);
      }
      c.w[1 + i] = keep(on, wn);
      c.Th[1 + i][0] = keep(on, tn * c.Th[0][0]);
    }
  }
  void linearise(Limit& l, T t4) {
    T inv = 1.0 / (l.s + l.gam * l.R);
    l.Th = keep(l.on, l.gam * inv);
    l.w = keep(l.on, (t4 - l.gam * l.s + l.gam * rho * l.r1) * inv);
  }
  void linearise(DryFriction& d, T t50, T t5) {
    d.t50 = t50;
    T ib0 = 1.0 / d.b0, B = d.b0 - d.b * d.b * ib0;
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
      T t4 = c.kappa + centre - keep(correct, c.dgam * c.ds), t50 = c.kappa + centre, t5[NT] = {};
      if (c.rows > 1) {
        T db0 = c.mu * c.dgam;
        t50 -= keep(correct, db0 * c.deta0);
        CMBRL_FOR(r, NT) {
          t50 -= keep(correct, c.db[r] * c.deta[r]);
          t5[r] = -keep(correct, db0 * c.deta[r] + c.deta0 * c.db[r]);
        }
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
    int nv = m.nv;
    for (int i = 0; i < w.ndyn; ++i) copy_row(w.H, w.H0, nv, pat, w.dyn_list[i]);
    for (int g = 0; g < w.ngroups; ++g) {
      T K[G::N][G::N] = {};
      for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
        const Contact<G>& c = w.con[i];
        CMBRL_FOR(r, c.rows) {
          Vec<G::N> F = c.Th[r][0] * c.Wr[0];
          for (int k = 1; k < c.rows && r > 0; ++k) F += c.Th[r][k] * c.Wr[k];
          CMBRL_FOR(a, G::N) CMBRL_FOR(b, G::N) K[a][b] += c.Wr[r][a] * F[b];
        }
      }
      add_group_matrix(w.groups[g].group, K, w.H);
    }
    for (int i = 0; i < w.nlim; ++i) w.H[w.lim[i].dof * (nv + 1)] += w.lim[i].Th;
    for (int i = 0; i < w.ndry; ++i) w.H[w.dry[i].dof * (nv + 1)] += w.dry[i].Th;
    for (int i = 0; i < w.ndyn; ++i) eliminate(w.H, nv, pat, w.dyn_list[i]);
  }
  void add_group_matrix(int group, const T (*K)[G::N], T* H) const {
    for (int a = m.grp_dptr[group]; a < m.grp_dptr[group + 1]; ++a) {
      int j = m.grp_dof[a];
      Vec<G::N> F = zero<G::N>();
      CMBRL_FOR(r, G::N) CMBRL_FOR(c, G::N) F[r] += K[r][c] * w.S[j][c];
      if (m.grp_sign[a] < 0) F = zero<G::N>() - F;
      for (int b = m.grp_dptr[group]; b < m.grp_dptr[group + 1]; ++b) {
        T x = dot(w.S[m.grp_dof[b]], F);
        H[m.grp_dof[b] * m.nv + j] += m.grp_sign[b] > 0 ? x : -x;
      }
    }
  }

  // Newton direction for the current linearisation; returns the longest feasible step.
  T direction() {
    for (int i = 0; i < w.ndyn; ++i) w.rhs[w.dyn_list[i]] = rho * w.rv[w.dyn_list[i]];
    for (int g = 0; g < w.ngroups; ++g) {
      Vec<G::N> F = zero<G::N>();
      for (int i = w.groups[g].begin; i < w.groups[g].end; ++i)
        CMBRL_FOR(r, w.con[i].rows) F += w.con[i].w[r] * w.con[i].Wr[r];
      add_wrench(w.groups[g].group, F, w.rhs);
    }
    for (int i = 0; i < w.nlim; ++i) w.rhs[w.lim[i].dof] += w.lim[i].sign * w.lim[i].w;
    for (int i = 0; i < w.ndry; ++i) w.rhs[w.dry[i].dof] += w.dry[i].w;
    for (int i = 0; i < w.ndyn; ++i) solve_down(w.H, m.nv, pat, w.dyn_list[i], w.rhs);
    for (int i = w.ndyn - 1; i >= 0; --i) solve_up(w.H, m.nv, pat, w.dyn_list[i], w.rhs);

    T alpha = splat(1e3);
    for (int g = 0; g < w.ngroups; ++g) {
      Vec<G::N> t = twist(w.groups[g].group, w.rhs);
      for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) step_of(w.con[i], t, alpha);
    }
    for (int i = 0; i < w.nlim; ++i) {
      Limit& l = w.lim[i];
      T jv = l.sign * w.rhs[l.dof];
      l.dgam = l.w - l.Th * jv;
      l.ds = keep(l.on, jv + l.R * l.dgam - rho * l.r1);
      alpha = vmin(alpha, vmin(orthant(l.gam, l.dgam), orthant(l.s, l.ds)));
    }
    for (int i = 0; i < w.ndry; ++i) {
      DryFriction& d = w.dry[i];
      T jv = w.rhs[d.dof];
      d.db = d.w - d.Th * jv;
      d.deta = keep(d.on, jv + d.R * d.db - rho * d.r2);
      T q0 = d.t50 - d.b0 * d.eta0 - d.b * d.eta;
      d.deta0 = keep(d.on, (q0 - d.b * d.deta - d.eta * d.db) / d.b0);
      T zero1[1] = {T{}};
      alpha = vmin(alpha, vmin(cone<1>(d.b0, &d.b, zero1[0], &d.db), cone<1>(d.eta0, &d.eta, d.deta0, &d.deta)));
    }
    return alpha;
  }

  void step_of(Contact<G>& c, const Vec<G::N>& t, T& alpha) {
    T jv[1 + NT];
    CMBRL_FOR(r, c.rows) jv[r] = dot(c.Wr[r], t);
    c.dgam = c.w[0] - c.Th[0][0] * jv[0];
    c.ds = keep(c.on, jv[0] + c.Rn * c.dgam - rho * c.r1);
    alpha = vmin(alpha, vmin(orthant(c.gam, c.dgam), orthant(c.s, c.ds)));
    if (c.rows == 1) return;
    Mask on = c.on & c.rub;
    CMBRL_FOR(r, NT) {
      c.db[r] = c.w[1 + r] - c.Th[1 + r][0] * jv[0];
      CMBRL_FOR(k, NT) c.db[r] -= c.Th[1 + r][1 + k] * jv[1 + k];
      c.deta[r] = keep(on, jv[1 + r] + c.Rt * c.db[r] - rho * c.r2[r]);
    }
    T b0 = c.mu * c.gam, db0 = keep(on, c.mu * c.dgam);
    T q0 = c.t50 - b0 * c.eta0 - c.eta0 * db0;
    CMBRL_FOR(r, NT) q0 -= c.b[r] * c.eta[r] + c.b[r] * c.deta[r] + c.eta[r] * c.db[r];
    c.deta0 = keep(on, q0 / b0);
    alpha = vmin(alpha, vmin(cone<NT>(b0, c.b, db0, c.db), cone<NT>(c.eta0, c.eta, c.deta0, c.deta)));
  }

  static T orthant(T x, T dx) { return select(dx < 0.0, -x / dx, splat(1e3)); }
  // Longest step that keeps (x0, x) + a (dx0, dx) in the second-order cone.
  template <int N> static T cone(T x0, const T* x, T dx0, const T* dx) {
    T big = splat(1e3);
    if constexpr (N == 1) {
      return vmin(orthant(x0 + x[0], dx0 + dx[0]), orthant(x0 - x[0], dx0 - dx[0]));
    } else {
      T a = dx0 * dx0, b = x0 * dx0, c = x0 * x0;
      CMBRL_FOR(i, N) { a -= dx[i] * dx[i]; b -= x[i] * dx[i]; c -= x[i] * x[i]; }
      T disc = b * b - a * c;
      T root = vsqrt(vmax(disc, T{}));
      Mask hits = (a < 0.0) | ((b < 0.0) & (disc >= 0.0));
      T den = root - b;
      T alpha = select(hits & (den > 0.0), c / select(den > 0.0, den, splat(1)), big);
      return vmin(alpha, orthant(x0, dx0));
    }
  }

  T complementarity(T alpha) const {  // mean product after a step
    T nu = T{};
    for (int i = 0; i < w.ncon; ++i) {
      const Contact<G>& c = w.con[i];
      nu += keep(c.on, (c.gam + alpha * c.dgam) * (c.s + alpha * c.ds));
      if (c.rows == 1) continue;
      T x = c.mu * (c.gam + alpha * c.dgam) * (c.eta0 + alpha * c.deta0);
      CMBRL_FOR(r, NT) x += (c.b[r] + alpha * c.db[r]) * (c.eta[r] + alpha * c.deta[r]);
      nu += keep(c.on & c.rub, x);
    }
    for (int i = 0; i < w.nlim; ++i)
      nu += keep(w.lim[i].on, (w.lim[i].gam + alpha * w.lim[i].dgam) * (w.lim[i].s + alpha * w.lim[i].ds));
    for (int i = 0; i < w.ndry; ++i) {
      const DryFriction& d = w.dry[i];
      nu += keep(d.on, d.b0 * (d.eta0 + alpha * d.deta0) + (d.b + alpha * d.db) * (d.eta + alpha * d.deta));
    }
    return nu / vmax(count, splat(1));
  }

  void advance(T alpha) {  // alpha is zero in lanes that have stopped
    for (int i = 0; i < w.ndyn; ++i) w.delta[w.dyn_list[i]] += alpha * w.rhs[w.dyn_list[i]];
    for (int i = 0; i < w.ncon; ++i) {
      Contact<G>& c = w.con[i];
      c.gam += alpha * c.dgam;
      c.s += alpha * c.ds;
      if (c.rows == 1) continue;
      c.eta0 += alpha * c.deta0;
      CMBRL_FOR(r, NT) { c.b[r] += alpha * c.db[r]; c.eta[r] += alpha * c.deta[r]; }
    }
    for (int i = 0; i < w.nlim; ++i) { w.lim[i].gam += alpha * w.lim[i].dgam; w.lim[i].s += alpha * w.lim[i].ds; }
    for (int i = 0; i < w.ndry; ++i) {
      DryFriction& d = w.dry[i];
      d.b += alpha * d.db; d.eta0 += alpha * d.deta0; d.eta += alpha * d.deta;
    }
    rho *= 1.0 - alpha;
  }

  // Largest distance of a product from kappa + centre, relative to that (and to round-off of the start's products).
  T off_path(T centre) const {
    T worst = T{}, floor = 4e-16 * zeta * zeta / o.theta;
    auto widen = [&](Mask on, T error, T kappa) { worst = vmax(worst, keep(on, vabs(error) / vmax(kappa + centre, floor))); };
    for (int i = 0; i < w.ncon; ++i) {
      const Contact<G>& c = w.con[i];
      widen(c.on, c.gam * c.s - c.kappa - centre, c.kappa);
      if (c.rows == 1) continue;
      T b0 = c.mu * c.gam, head = b0 * c.eta0 - c.kappa - centre;
      CMBRL_FOR(r, NT) {
        head += c.b[r] * c.eta[r];
        widen(c.on & c.rub, b0 * c.eta[r] + c.eta0 * c.b[r], c.kappa);
      }
      widen(c.on & c.rub, head, c.kappa);
    }
    for (int i = 0; i < w.nlim; ++i) widen(w.lim[i].on, w.lim[i].gam * w.lim[i].s - w.lim[i].kappa - centre, w.lim[i].kappa);
    for (int i = 0; i < w.ndry; ++i) {
      const DryFriction& d = w.dry[i];
      widen(d.on, d.b0 * d.eta0 + d.b * d.eta - d.kappa - centre, d.kappa);
      widen(d.on, d.b0 * d.eta + d.eta0 * d.b, d.kappa);
    }
    return worst;
  }

  T mean_kappa() const {
    T sum = T{};
    for (int i = 0; i < w.ncon; ++i)
      sum += keep(w.con[i].on, w.con[i].kappa) + keep(w.con[i].on & w.con[i].rub, w.con[i].kappa);
    for (int i = 0; i < w.nlim; ++i) sum += keep(w.lim[i].on, w.lim[i].kappa);
    for (int i = 0; i < w.ndry; ++i) sum += keep(w.dry[i].on, w.dry[i].kappa);
    return sum / vmax(count, splat(1));
  }

  // One full Newton step to kappa in the lanes of `todo`, from residuals that were just computed.
  void refine(Mask todo) {
    rho = splat(1);
    linearise_all(T{}, none());
    factorise();
    advance(keep(todo, vmin(direction() * 0.99, splat(1))));
  }

  void set_friction(T share) {
    for (int i = 0; i < w.ncon; ++i) {
      Contact<G>& c = w.con[i];
      if (c.rows > 1) c.mu = select(c.rub, share * w.P[m.oContact + c.index * kContactFields + kMu], splat(1));
    }
  }

  // Runs the lanes of `todo`; returns those that converged. Lanes outside keep alpha = 0 and so keep their start.
  Mask run(Mask todo, const Strategy& st, T& iterations) {
    start(st.start);
    T kappa = mean_kappa(), centre = st.follow ? zeta * zeta : T{}, floor = 1e-6 * zeta * zeta;
    Mask busy = todo & (count > 0.0), done = todo & ~busy;
    T slow = T{};  // short steps in a row: the path has folded, more of them would lead nowhere
    T share = splat(st.friction);
    if (st.friction < 1) set_friction(share);
    for (int it = 0; any(busy) && it <= st.iterations; ++it) {
      T nu = complementarity(T{});
      T off = off_path(centre);
      Mask ready = busy & (centre <= 0.0) & (share >= 1.0) & (off <= o.theta) & (rho * linear <= o.tolerance);
      done |= ready;
      busy &= ~ready;
      if (!any(busy) || it == st.iterations) break;
      iterations += select(busy, splat(1), T{});
      T excess = vmax(nu - kappa, T{});
      bool corrector = st.corrector && it < 14;
      // Far from both ends of the path a step may go nearer to the boundary: a fifth fewer iterations to a small kappa.
      Mask midway = (nu < 0.01 * zeta * zeta) & (excess > 10.0 * kappa);
      T alpha, tau = st.corrector ? select(midway, splat(0.99), splat(st.tau)) : splat(st.tau);
      if (corrector) {
        linearise_all(T{}, none());
        factorise();
        T affine = vmin(direction() * tau, splat(1));
        T ratio = vmax(complementarity(affine) - kappa, T{}) / vmax(excess, splat(1e-300));
        T sigma = vmin(ratio * ratio * ratio, splat(1));
        Mask shortened = affine < 0.2;
        sigma = select(shortened, vmax(sigma, splat(0.5)), sigma);
        linearise_all(select(excess > 0.0, sigma * excess, T{}), ~shortened);
      } else {
        if (st.follow) {
          Mask next = off < 0.5, grows = next & (share < 1.0) & (centre <= vmax(kappa, floor));
          if (any(grows)) {
            share = select(grows, vmin(st.growth * share, splat(1)), share);
            set_friction(share);
          }
          centre = select(next & ~grows, st.sigma * centre, centre);
          centre = select(centre > 0.1 * kappa, centre, T{});
        }
        linearise_all(st.follow ? centre : st.sigma * excess, none());
        factorise();
      }
      alpha = vmin(direction() * tau, splat(1));
      advance(keep(busy, alpha));
      slow = select(alpha < 1e-3, slow + 1.0, T{});
      busy &= slow < 4.0;
    }
    if (st.friction < 1) set_friction(splat(1));
    return done;
  }
};

}  // namespace cmbrl::CMBRL_ISA
