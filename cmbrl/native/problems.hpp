// Batches of contact problems that come as arrays: the step's own contact solve on rows without bodies behind them.
#pragma once
#include "ladder.hpp"
#include "problem_batch.hpp"
#include "proximal.hpp"

namespace cmbrl::CMBRL_ISA {

// Every contact sees each dof through its own column of J, so its "twist" is the velocity of its rows.
template <int TANGENTS>
struct Rows {
  static constexpr int N = 1 + TANGENTS, NT = TANGENTS;
  static constexpr bool kColumnPerDof = false;
  using V = Vec<1>;
};

// One pack of problems in units of its own: the fastest row closes at 1, the largest energy scale c^2 / G of a row is 1.
template <class G>
struct ProblemPack {
  const Structure& m;
  const ProblemBatch& b;
  SolverWork<G>& w;
  Lanes l;
  T speed, mass, scale;  // units [m/s], [kg]; |M v_free| / contacts, which the natural map is relative to

  T at(const double* x, int64_t stride, int64_t i) const {
    if (l.n == 1) return splat(x[l.at[0] * stride + i]);
    T r;
    for (int lane = 0; lane < W; ++lane) r[lane] = x[l.at[lane] * stride + i];
    return r;
  }

  void load() {
    int nv = m.nv, rows = 1 + G::NT;
    w.ncon = w.ngroups = b.contacts;
    w.nlim = w.ndry = 0;
    w.coupled = true;
    w.fill = m.fill;
    for (int i = 0; i < nv; ++i) {
      w.vf[i] = at(b.v_free, nv, i);
      for (int a = m.fill.ptr[i]; a < m.fill.ptr[i + 1]; ++a) w.M[i * nv + m.fill.idx[a]] = w.M[m.fill.idx[a] * nv + i] = T{};
      w.M[i * (nv + 1)] = at(b.M, nv * nv, i * (nv + 1));
      for (int a = m.anc_ptr[i]; a < m.anc_ptr[i + 1]; ++a) {
        int j = m.anc_idx[a];
        w.M[i * nv + j] = w.M[j * nv + i] = at(b.M, nv * nv, i * nv + j);
      }
    }
    for (int c = 0; c < b.contacts; ++c) load_contact(c, w.con[c]);
    for (int c = 0; c < b.contacts; ++c)
      for (int k = m.grp_dptr[c]; k < m.grp_dptr[c + 1]; ++k)
        CMBRL_FOR(r, rows) {
          T x = at(b.J, b.contacts * rows * nv, (c * rows + r) * nv + m.grp_dof[k]);
          w.S[k][r] = r == 0 ? x : keep(w.con[c].rub, x);
        }
  }
  void load_contact(int i, Contact<G>& c) {
    int rows = 1 + G::NT;
    w.groups[i] = {i, i, i + 1};
    c.on = all();
    c.index = i;
    T mu = at(b.mu, b.contacts, i);
    c.rub = mu > 1e-9;
    c.rows = any(c.rub) ? rows : 1;
    c.mu = c.full_mu = select(c.rub, mu, splat(1));
    CMBRL_FOR(r, rows) {
      c.Wr[r] = zero<G::N>();
      c.Wr[r][r] = splat(1);
    }
    c.cn0 = at(b.b, b.contacts * rows, i * rows);
    load_compliance(c, splat(1));
    CMBRL_FOR(r, G::NT) c.ct0[r] = keep(c.rub, at(b.b, b.contacts * rows, i * rows + 1 + r));
  }

  void load_compliance(Contact<G>& c, T unit) const {
    int rows = 1 + G::NT;
    c.Rn = unit * at(b.R, b.contacts * rows, c.index * rows);
    c.Rt = unit * at(b.R, b.contacts * rows, c.index * rows + 1);
  }

  // H becomes a factor of M; every contact gets the largest diagonal entry of its rows in J M^-1 J^T + R.
  void weigh() {
    int nv = m.nv;
    Pattern pat{m.anc_ptr, m.anc_idx};
    T energy = T{}, momentum = T{};
    speed = T{};
    for (int k = 0; k < nv; ++k) copy_row(w.H, w.M, nv, pat, k);
    for (int k = nv - 1; k >= 0; --k) eliminate(w.H, nv, pat, k);
    for (int i = 0; i < b.contacts; ++i) {
      Contact<G>& c = w.con[i];
      T weight = T{}, fastest = T{};
      CMBRL_FOR(r, c.rows) {
        int first = m.grp_dptr[i], last = m.grp_dptr[i + 1];
        T G_rr = r == 0 ? c.Rn : keep(c.rub, c.Rt), u = r == 0 ? c.cn0 : c.ct0[r - 1];
        for (int k = 0; k < nv; ++k) w.rhs[k] = T{};
        for (int k = first; k < last; ++k) {
          w.rhs[m.grp_dof[k]] = w.S[k][r];
          u += w.S[k][r] * w.vf[m.grp_dof[k]];
        }
        for (int k = last > first ? m.grp_dof[last - 1] : -1; k >= 0; --k) {
          if (!any(w.rhs[k] != 0.0)) continue;  // of another branch of the tree
          solve_down(w.H, nv, pat, k, w.rhs);
          G_rr += w.rhs[k] * w.rhs[k] * w.H[k * (nv + 1)];
        }
        weight = vmax(weight, G_rr);
        fastest = vmax(fastest, vabs(u));
      }
      weight = select(weight > 0.0, weight, splat(1));
      c.root = vsqrt(weight);
      speed = vmax(speed, fastest);
      energy = vmax(energy, fastest * fastest / weight);
    }
    speed = select(speed > 0.0, speed, splat(1));
    mass = select(energy > 0.0, energy / (speed * speed), splat(1));
    for (int k = 0; k < nv; ++k) w.rhs[k] = w.M[k * (nv + 1)] * w.vf[k];
    for (int k = 0; k < nv; ++k)
      for (int a = pat.ptr[k]; a < pat.ptr[k + 1]; ++a) {
        w.rhs[k] += w.M[k * nv + pat.idx[a]] * w.vf[pat.idx[a]];
        w.rhs[pat.idx[a]] += w.M[k * nv + pat.idx[a]] * w.vf[k];
      }
    for (int k = 0; k < nv; ++k) momentum += w.rhs[k] * w.rhs[k];
    scale = vsqrt(momentum) / (double(b.contacts) * mass * speed);
  }

  void normalise() {
    int nv = m.nv;
    T inv_speed = 1.0 / speed, inv_mass = 1.0 / mass, root = vsqrt(mass);
    for (int i = 0; i < nv; ++i) {
      w.vf[i] *= inv_speed;
      w.M[i * (nv + 1)] *= inv_mass;
      for (int a = m.anc_ptr[i]; a < m.anc_ptr[i + 1]; ++a) {
        int j = m.anc_idx[a];
        w.M[j * nv + i] = w.M[i * nv + j] *= inv_mass;
      }
    }
    for (int i = 0; i < b.contacts; ++i) {
      Contact<G>& c = w.con[i];
      c.root *= root;
      c.cn0 *= inv_speed;
      load_compliance(c, mass);
      CMBRL_FOR(r, G::NT) c.ct0[r] *= inv_speed;
    }
    eliminate_untouched(m, w);
  }

  void store(Mask lanes, T residual, const int* status, T iterations) const {
    int nv = m.nv, rows = 1 + G::NT;
    for (int lane = 0; lane < l.n; ++lane) {
      if (!lanes[lane]) continue;
      int64_t e = l.at[lane];
      for (int k = 0; k < nv; ++k) b.v[e * nv + k] = w.vn[k][lane] * speed[lane];
      for (int i = 0; i < b.contacts; ++i) {
        const Contact<G>& c = w.con[i];
        double *x = b.impulse + (e * b.contacts + i) * rows, unit = mass[lane] * speed[lane];
        x[0] = c.gam[lane] * unit;
        CMBRL_FOR(r, G::NT) x[1 + r] = c.rows > 1 && c.rub[lane] ? c.b[r][lane] * unit : 0;
      }
      b.residual[e] = residual[lane];
      b.status[e] = status[lane];
      b.iterations[e] = int32_t(iterations[lane]);
    }
  }

  // dv'/dv_free = A^-1 M with A = M + J^T Theta J, of which H holds the factor.
  void store_derivative(Mask lanes, T* X) const {
    int nv = m.nv;
    for (int i = 0; i < nv * nv; ++i) X[i] = T{};
    for (int i = 0; i < nv; ++i) {
      X[i * (nv + 1)] = w.M[i * (nv + 1)];
      for (int a = m.anc_ptr[i]; a < m.anc_ptr[i + 1]; ++a)
        X[i * nv + m.anc_idx[a]] = X[m.anc_idx[a] * nv + i] = w.M[i * nv + m.anc_idx[a]];
    }
    solve_many(w.H, nv, pattern_of(m, w), X, nv);
    for (int lane = 0; lane < l.n; ++lane)
      for (int i = 0; lanes[lane] && i < nv * nv; ++i) b.derivative[l.at[lane] * nv * nv + i] = X[i][lane];
  }
};

// The softened law: every product equals kappa.
template <class G>
static void solve_on_path(ProblemPack<G>& pack, Options& o, T* X) {
  SolverWork<G>& w = pack.w;
  o.tolerance = 1e-9;
  o.theta = 1e-6;
  T kappa = pack.at(pack.b.kappa, 1, 0) / (pack.mass * pack.speed * pack.speed);
  for (int i = 0; i < w.ncon; ++i) w.con[i].kappa = kappa;
  Outcome out = contact_solve(pack.m, o, w);
  int status[W];
  for (int lane = 0; lane < W; ++lane) status[lane] = !out.done[lane] ? 2 : out.fallback[lane] ? 1 : 0;
  pack.store(all(), out.residual, status, out.iterations);
  if (!pack.b.derivative) return;
  InteriorPoint<G> ip(pack.m, o, w);
  ip.rho = splat(1);
  ip.linearise_all(T{}, none());
  ip.factorise();
  pack.store_derivative(all(), X);
}

// The exact law: Newton on the law itself, from rest, which finds most answers in a few steps; else from the path, at a
// kappa where contacts know what they do, or further down; where redundant contacts make that unclear, proximal points. The
// natural map decides; what it does not pass is flagged.
template <class G>
static void solve_exactly(ProblemPack<G>& pack, Options& o, T* X) {
  SolverWork<G>& w = pack.w;
  o.tolerance = 1e-8;
  o.theta = 0.1;
  Mask open = all();
  T iterations = T{}, natural = splat(__builtin_inf());
  int solved[W] = {}, failed[W];
  for (int& f : failed) f = 2;
  ProximalPoints<G> polish(pack.m, o, w);
  auto finish = [&](Mask now) {  // lanes that are solved
    pack.store(now, natural / pack.scale, solved, iterations);
    if (pack.b.derivative) {
      polish.linearise_exact(1e-8);
      pack.store_derivative(now, X);
    }
    open &= ~now;
  };
  auto newton = [&](int steps) { finish(polish.run(open, pack.scale, pack.b.tolerance, steps, natural, iterations)); };
  auto set_kappa = [&](double kappa) {
    for (int i = 0; i < w.ncon; ++i) w.con[i].kappa = splat(kappa);
  };
  auto newton_from_here = [&](int steps) {  // and back
    for_solver_state(pack.m, w, [](T& x, T& kept) { kept = x; });
    newton(steps);
    for_solver_state(pack.m, w, [](T& x, T& kept) { x = kept; });
  };
  polish.rest();
  newton(5);
  if (!any(open)) return;
  set_kappa(1e-8);
  T used = contact_solve(pack.m, o, w).iterations;
  iterations += keep(open, used);
  for (int i = 0; i < w.ncon; ++i) pack.load_compliance(w.con[i], pack.mass);
  newton_from_here(8);
  if (!any(open)) return;
  set_kappa(1e-11);
  Mask there = polish.resume(open, iterations);
  for_solver_state(pack.m, w, [there](T& x, T& kept) { x = select(there, x, kept); });
  newton_from_here(8);
  if (!any(open)) return;
  finish(polish.approach(open, pack.scale, pack.b.tolerance, 120, natural, iterations));
  if (!any(open)) return;
  pack.store(open, natural / pack.scale, failed, iterations);
  if (!pack.b.derivative) return;
  polish.linearise_exact(1e-8);
  pack.store_derivative(open, X);
}

template <class G>
static T* open_problems(const ProblemBatch& b, Arena& arena, SolverWork<G>& w) {  // returns room for the derivative
  w.take(arena, b.nv, b.contacts * b.nv, b.contacts, 0, 0, b.contacts);
  return arena.template take<T>(b.nv * b.nv);
}
template <class G>
static int64_t problem_bytes(const ProblemBatch& b) {
  Arena arena{nullptr};
  SolverWork<G> probe;
  open_problems(b, arena, probe);
  return arena.used;
}

template <class G>
static void solve_problems(const Structure& m, const ProblemBatch& b, int64_t begin, int64_t end, void* memory) {
  Arena arena{static_cast<char*>(memory)};
  SolverWork<G> w;
  T* X = open_problems(b, arena, w);
  Options o{};
  o.max_iterations = 40;
  ProblemPack<G> pack{m, b, w, lanes_from(begin, end), {}, {}, {}};
  pack.load();
  pack.weigh();
  pack.normalise();
  if (b.kappa) solve_on_path(pack, o, X);
  else solve_exactly(pack, o, X);
}

}  // namespace cmbrl::CMBRL_ISA
