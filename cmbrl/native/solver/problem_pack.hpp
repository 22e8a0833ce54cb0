// One pack of contact problems that come as arrays: in, in units of its own, and out again.
#pragma once
#include "solver/ladder.hpp"
#include "solver/problem_batch.hpp"

namespace cmbrl::CMBRL_ISA {

// Every contact sees each dof through its own column of J, so its "twist" is the velocity of its rows.
template <int TANGENTS>
struct Rows {
  static constexpr int N = 1 + TANGENTS, NT = TANGENTS, MT = TANGENTS;
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
      Row<T> row(w.M, m.mass, i);
      *row.diagonal = at(b.M, nv * nv, i * (nv + 1));
      for (int a = 0; a < row.n; ++a) row.before[a] = row.mirror[a] = at(b.M, nv * nv, i * nv + m.mass.columns(i)[a]);
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
    c.convex = b.convex ? c.rub & (at(b.convex, b.contacts, i) > 0.5) : none();
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
    Pattern pat = m.mass;
    T energy = T{}, momentum = T{};
    speed = T{};
    for (int k = 0; k < nv; ++k) copy_row(w.H, w.M, pat, k);
    cmbrl::CMBRL_ISA::factorise<false>(w.H, pat, nv);
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
          solve_down(w.H, pat, k, w.rhs);
          G_rr += w.rhs[k] * w.rhs[k] * w.H[pat.row(k)];
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
    for (int k = 0; k < nv; ++k) w.rhs[k] = w.M[pat.row(k)] * w.vf[k];
    for (int k = 0; k < nv; ++k) {
      Row<T> row(w.M, pat, k);
      for (int a = 0; a < row.n; ++a) {
        int j = pat.columns(k)[a];
        w.rhs[k] += row.before[a] * w.vf[j];
        w.rhs[j] += row.before[a] * w.vf[k];
      }
    }
    for (int k = 0; k < nv; ++k) momentum += w.rhs[k] * w.rhs[k];
    scale = vsqrt(momentum) / (double(b.contacts) * mass * speed);
  }

  void normalise() {
    int nv = m.nv;
    T inv_speed = 1.0 / speed, inv_mass = 1.0 / mass, root = vsqrt(mass);
    for (int i = 0; i < nv; ++i) w.vf[i] *= inv_speed;
    for (int i = 0; i < m.mass.row(nv); ++i) w.M[i] *= inv_mass;
    for (int i = 0; i < b.contacts; ++i) {
      Contact<G>& c = w.con[i];
      c.root *= root;
      c.cn0 *= inv_speed;
      load_compliance(c, mass);
      CMBRL_FOR(r, G::NT) c.ct0[r] *= inv_speed;
    }
    eliminate_untouched(m, w);
    w.below.fill(pattern_of(m, w), nv, w.dynamic);
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
      Row<T> row(w.M, m.mass, i);
      X[i * (nv + 1)] = *row.diagonal;
      for (int a = 0; a < row.n; ++a) {
        int j = m.mass.columns(i)[a];
        X[i * nv + j] = X[j * nv + i] = row.before[a];
      }
    }
    solve_many(w.H, nv, pattern_of(m, w), X, nv);
    for (int lane = 0; lane < l.n; ++lane)
      for (int i = 0; lanes[lane] && i < nv * nv; ++i) b.derivative[l.at[lane] * nv * nv + i] = X[i][lane];
  }
};

}  // namespace cmbrl::CMBRL_ISA
