// Implicit derivative of one step at its solution:  H dv' = Gq dq + Gv dv + Gu du + Gp dtheta,  H = M~ + J^T Theta J.
// The right-hand sides differentiate M~ (v' - v) - h (tau - bias) - J^T x and the rows at fixed (v', x); neither M^-1 nor the
// Delassus matrix is ever differentiated, and no solver iteration is.
#pragma once
#include "step/step.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G>
static void accelerations_and_twists(const Model& m, const Options& o, Work<G>& w, const T* vn) {
  for (int i = 0; i < m.nv; ++i) w.a[i] = (vn[i] - w.v[i]) * (1 / o.h);
  inverse_dynamics(m, w, w.v, w.a, w.tmp);
  for (int b = 0; b < m.nbody; ++b) {
    Vec<G::N> t = m.body_parent[b] >= 0 ? w.tn[m.body_parent[b]] : zero<G::N>();
    for (int j = m.body_jadr[b]; j < m.body_jadr[b] + m.body_jnum[b]; ++j) {
      int d = m.jnt_vadr[j], n = m.jnt_type[j] == kBall ? 3 : 1;
      for (int k = d; k < d + n; ++k) w.tnlam[k] = t;
      for (int k = d; k < d + n; ++k) t += vn[k] * w.S[k];
    }
    w.tn[b] = t;
  }
}

// out += A B for A (nv x nv) with the pattern of the mass matrix, B (nv x ncol).
static inline void add_product(const Model& m, const T* A, const T* B, int ncol, T* out) {
  auto add_row = [&](int i, int k) {
    T x = A[i * m.nv + k];
    for (int c = 0; c < ncol; ++c) out[i * ncol + c] += x * B[k * ncol + c];
  };
  for (int i = 0; i < m.nv; ++i) {
    add_row(i, i);
    for (int a = m.anc_ptr[i]; a < m.anc_ptr[i + 1]; ++a) {
      add_row(i, m.anc_idx[a]);
      add_row(m.anc_idx[a], i);
    }
  }
}

// Smooth part of Gq, Gv, Gu for a step that ends at vn. Leaves twists under v and vn, which rows look at; of a bias that is
// taken ahead C, and the twists and accelerations there.
template <class G>
static void smooth_terms(const Model& m, const Options& o, Work<G>& w, const T* vn, T* Gq, T* Gv, T* Gu) {
  int nv = m.nv;
  for (int i = 0; i < nv * nv; ++i) Gq[i] = Gv[i] = T{};
  for (int i = 0; i < nv * m.nu; ++i) Gu[i] = T{};
  accelerations_and_twists(m, o, w, vn);
  if (w.ahead) {
    for (int i = 0; i < nv * nv; ++i) w.C[i] = T{};
    w.swap_velocity();
    inverse_dynamics(m, w, w.v, w.a, w.tmp);
    inverse_dynamics_derivatives(m, w, -o.h, Gq, w.C);
    w.swap_velocity();
    add_product(m, w.C, w.Bq, nv, Gq);
    add_product(m, w.C, w.Bv, nv, Gv);
    add_product(m, w.C, w.Bu, m.nu, Gu);
    inverse_dynamics(m, w, w.v, w.a, w.tmp);  // for vlam
  } else {
    inverse_dynamics_derivatives(m, w, -o.h, Gq, Gv);
  }
  tie_terms(m, o, w, vn, w.v, Gq, Gv);
  for (int i = 0; i < m.nline; ++i) {
    T damping = w.P[m.oDof + i * kDofFields + kDamping] + w.kd[i];
    add_square(m, w, i, -o.h * w.kp[i], Gq);
    if (linkage_of(m, i) >= 0) add_length_slopes(m, w, i, o.h * w.kp[i], Gq);
    T drag = -o.h * (o.implicit_springs ? damping + o.h * w.kp[i] : damping), mass = w.line_mass[i];
    add_square(m, w, i, drag, Gv);
    if (bends(m, i))
      add_bend(m, w, i, w.line_pull[i] - mass * (along(m, w, i, vn) - along(m, w, i, w.v)), drag + mass, w.v, -mass, vn, Gq);
  }
  for (int i = 0; i < nv; ++i) {
    Row<T> mass(w.M, m.mass, i);
    Gv[i * (nv + 1)] += *mass.diagonal;
    for (int a = 0; a < mass.n; ++a) {
      int j = m.mass.columns(i)[a];
      Gv[i * nv + j] += mass.before[a];
      Gv[j * nv + i] += mass.mirror[a];
    }
  }
  if (m.nforcerange > 0) clamped_rows(m, w, o.h, Gq, Gv);
  if (m.nlift > 0) gravity_compensation_terms(m, w, o.h, Gq);
  ball_spring_terms(m, w, o.h, Gq);
  power_terms(m, o, w, vn, Gq, Gv);
  if (m.in_fluid()) fluid_terms(m, o, w, m.implicit_gains && !o.apart(), Gq, Gv);
  wide_terms(m, w, o.h, Gq, Gu);
  if (!o.split) {
    for (int i = 0; i < nv; ++i) w.a[i] = vn[i] - w.v[i];
    gain_terms(m, o, w, w.a, Gu);
  }
  for (int a = 0; a < m.nact; ++a) {
    if (m.act_line[a] < 0) continue;
    for (int k = m.line_ptr[m.act_line[a]]; k < m.line_ptr[m.act_line[a] + 1]; ++k)
      add_inputs(m, w, a, o.h * w.line_c[k], w.yields[m.line_dof[k]], Gu + m.line_dof[k] * m.nu);
  }
}

template <class G> static inline T impulse(const Contact<G>& c, int row) {
  return row == 0 ? keep(c.on, c.gam) : keep(c.on & c.rub, c.b[row - 1]);
}
// The wrench -W Theta E of a change E of the rows.
template <class G>
static inline Vec<G::N> response(const Contact<G>& c, const T* E) {
  Vec<G::N> F = zero<G::N>();
  CMBRL_FOR(r, c.rows) {
    T x = c.Th[r][0] * E[0];
    for (int k = 1; k < c.rows; ++k) x += c.Th[r][k] * E[k];
    F -= x * c.Wr[r];
  }
  return F;
}

// The wrench of a change of the targets of a contact's products: normal, and tangential with that of the cone's head eliminated.
template <class G>
static inline Vec<G::N> target_response(const Contact<G>& c, T normal, const T* tangential) {
  for (int k = 0; k < c.rows - 1; ++k) normal -= keep(c.convex, c.gA[k] * tangential[k]);
  T dn = keep(c.on, c.ipn * normal);
  Vec<G::N> F = dn * c.Wr[0];
  with_tangents(c, [&](auto count) {
    CMBRL_FOR(r, count.value) {
      T x = T{};
      CMBRL_FOR(k, count.value) x += c.Ai[r][k] * (tangential[k] - c.ta[k] * dn);
      F += keep(c.on & c.rub, x) * c.Wr[1 + r];
    }
  });
  return F;
}
// That of a change of the contact's kappa.
template <class G>
static inline Vec<G::N> kappa_response(const Contact<G>& c, T dkappa) {
  T tangential[G::MT] = {};
  for (int k = 0; k < c.rows - 1; ++k) tangential[k] = -c.b[k] / (c.mu * c.gam) * dkappa;
  return target_response(c, dkappa + (c.rows > 1 ? keep(c.convex, dkappa) : T{}), tangential);
}

// Impulses that act late in the step move the configuration by their momentum times this: the time of impact.
template <class G> static inline T late_weight(const Contact<G>& c) { return keep(c.bounce, c.time); }

// Rows' part of Gq, Gv. late: of the momentum of late impulses instead, sum t_i J_i^T x_i at fixed t_i.
template <class G>
static void contact_terms(const Model& m, const Options& o, Work<G>& w, T* Gq, T* Gv, bool late) {
  int nv = m.nv;
  for (int gi = 0; gi < w.ngroups; ++gi) {
    int group = w.groups[gi].group, d0 = m.grp_dptr[group], nd = m.grp_dptr[group + 1] - d0;
    Vec<G::N> F = zero<G::N>();
    T K[G::N][G::N] = {};
    for (int k = 0; k < nd; ++k) w.Y[k] = zero<G::N>();
    for (int ci = w.groups[gi].begin; ci < w.groups[gi].end; ++ci) {
      Contact<G>& c = w.con[ci];
      int A = m.con_bodyA[c.index], B = m.con_bodyB[c.index];
      Vec<G::N> relative = passing_twist(m, w, w.tn, c) - c.carry * passing_twist(m, w, w.vel, c);
      bool adaptive = any(c.slope_R != 0.0);
      T weight = late ? late_weight(c) : splat(1), pull = weight * c.carry;
      CMBRL_FOR(r, c.rows) {
        F += (weight * impulse(c, r)) * c.Wr[r];
        Vec<G::N> FT = (pull * c.Th[r][0]) * c.Wr[0];
        for (int k = 1; k < c.rows && (r > 0 || o.convex); ++k) FT += (pull * c.Th[r][k]) * c.Wr[k];
        CMBRL_FOR(a, G::N) CMBRL_FOR(b, G::N) K[a][b] += c.Wr[r][a] * FT[b];
      }
      for (int k = 0; k < nd; ++k) {
        int d = m.grp_dof[d0 + k], sign = m.grp_sign[d0 + k], side = sign > 0 ? A : B;
        Shift<G> s = shift_by_dof(m, w, c, w.S[d], sign);
        Vec<G::N> swing = cross_motion<G>(w.S[d], w.tn[side] - w.tnlam[d] - c.carry * (w.vel[side] - w.vlam[d]));
        if (sign < 0) swing = zero<G::N>() - swing;
        if (glides(m, c)) swing += (1.0 - c.carry) * glide_by_dof(m, w, c, s, w.S[d], sign);
        T E[1 + G::MT] = {};
        CMBRL_FOR(r, c.rows) {
          Vec<G::N> dW = wrench_shift(c, s, r);
          E[r] = dot(dW, relative) + dot(c.Wr[r], swing);
          E[r] += r == 0 ? (c.dc_dphi + c.dRn_dphi * c.gam) * s.dphi : c.dRt_dphi * c.b[r - 1] * s.dphi;
          w.Y[k] += (weight * impulse(c, r)) * dW;
        }
        w.Y[k] += weight * response(c, E);
        if (adaptive) w.Y[k] += weight * kappa_response(c, c.slope_R * c.dRn_dphi * s.dphi);
      }
    }
    for (int k = 0; k < nd; ++k) {
      int mdof = m.grp_dof[d0 + k];
      Vec<G::N> turned = w.Y[k] - cross_force<G>(w.S[mdof], F), KS = zero<G::N>();  // columns of J that turn with mdof
      CMBRL_FOR(r, G::N) CMBRL_FOR(c, G::N) KS[r] += K[r][c] * w.S[mdof][c];
      if (m.grp_sign[d0 + k] < 0) KS = zero<G::N>() - KS;
      for (int l = 0; l < nd; ++l) {
        int j = m.grp_dof[d0 + l];
        T q = dot(w.S[j], turns_with(m, d0 + l, d0 + k) ? turned : w.Y[k]), v = dot(w.S[j], KS);
        Gq[j * nv + mdof] += m.grp_sign[d0 + l] > 0 ? q : -q;
        Gv[j * nv + mdof] += m.grp_sign[d0 + l] > 0 ? v : -v;
      }
    }
  }
  if (late) return;
  for (int i = 0; i < w.nlim; ++i) {
    const Limit& l = w.lim[i];
    add_square(m, w, l, keep(l.on, l.slope_R * l.dR_dphi / (l.s + l.gam * l.R)) - l.Th * (l.dc_dphi + l.dR_dphi * l.gam), Gq);
    add_square(m, w, l, l.Th * l.carry, Gv);
    if (l.round) turn_terms(m, w, l, Gq);
    else add_bend(m, w, l.line, keep(l.on, l.sign * l.gam), l.Th * l.carry, w.v, -l.Th, w.vn, Gq);
  }
  for (int i = 0; i < w.ndry; ++i) {
    const DryFriction& d = w.dry[i];
    add_square(m, w, d.line, d.Th * d.carry, Gv);
    add_bend(m, w, d.line, keep(d.on, d.b), d.Th * d.carry, w.v, -d.Th, w.vn, Gq);
    FrictionLimit f = friction_limit(m, w, d.line);
    if (!any((f.by_q != 0.0) | (f.by_v != 0.0))) continue;
    T share = o.h * impulse_by_limit(d, o.backward.dry);
    add_square(m, w, d.line, share * f.by_q, Gq);
    add_square(m, w, d.line, share * f.by_v, Gv);
  }
}

}  // namespace cmbrl::CMBRL_ISA
