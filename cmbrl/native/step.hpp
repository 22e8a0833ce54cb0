// One physics step of a pack: smooth forces, active rows, free velocity, contact solve, integration.
#pragma once
#include "smoothing.hpp"
#include "solver.hpp"

namespace cmbrl::CMBRL_ISA {

// tau, and what of the joint forces is taken implicitly: M~ = M + armature + h (D + kd) [+ h^2 (K + kp)].
template <class G>
static void joint_forces(const Model& m, const Options& o, Work<G>& w) {
  for (int i = 0; i < m.nv; ++i) {
    const T* p = w.P + m.oDof + i * kDofFields;
    w.kd[i] = w.kp[i] = T{};
    w.tau[i] = -p[kDamping] * w.v[i];
    if (m.dof_qadr[i] >= 0) w.tau[i] -= p[kStiffness] * (w.q[m.dof_qadr[i]] - p[kSpringref]);
  }
  for (int a = 0; a < m.nact; ++a) {
    const T* p = w.P + m.oAct + a * kActuatorFields;
    int d = m.act_dof[a];
    T lo = splat(m.act_ctrl[2 * a]), hi = splat(m.act_ctrl[2 * a + 1]);
    T flo = splat(m.act_force[2 * a]), fhi = splat(m.act_force[2 * a + 1]);
    T ctrl = vmin(vmax(w.u[a], lo), hi);
    T force = p[kGain] * ctrl + p[kBias0] + p[kGear] * (p[kBias1] * w.q[m.act_qadr[a]] + p[kBias2] * w.v[d]);
    Mask free = (force >= flo) & (force <= fhi);
    w.tau[d] += p[kGear] * vmin(vmax(force, flo), fhi);
    w.kd[d] -= keep(free, p[kGear] * p[kGear] * p[kBias2]);
    w.kp[d] -= keep(free, p[kGear] * p[kGear] * p[kBias1]);
    w.open[a] = keep(free & (w.u[a] >= lo) & (w.u[a] <= hi), p[kGear] * p[kGain]);
  }
  for (int i = 0; i < m.nv; ++i) {
    const T* p = w.P + m.oDof + i * kDofFields;
    T spring = w.kp[i] + (m.dof_qadr[i] >= 0 ? p[kStiffness] : T{});
    w.kp[i] = spring;
    T diag = p[kArmature] + o.h * (p[kDamping] + w.kd[i]);
    w.rhs[i] = o.h * (w.tau[i] - w.bias[i]);
    if (o.implicit_springs) {
      diag += o.h * o.h * spring;
      w.rhs[i] -= o.h * o.h * spring * w.v[i];
    }
    w.M[i * m.nv + i] += diag;
  }
}

template <class G>
static void find_limits(const Model& m, const Options& o, Work<G>& w, const Mask* given) {
  bool keep_all = !(o.prune < 1e300);
  w.nlim = w.ndry = 0;
  for (int i = 0; i < m.nlimit; ++i) {
    T q = w.q[m.lim_qadr[i]], below = q - m.lim_lo[i], above = m.lim_hi[i] - q;
    Mask lower = below < above;
    T phi = select(lower, below, above), sign = select(lower, splat(1), splat(-1));
    Mask on = given ? given[i] : all();
    if (given && !any(on)) continue;
    if (!keep_all && !given) {
      on = phi * (1 / o.h) + sign * w.v[m.lim_dof[i]] < o.prune;
      if (!any(on)) continue;
    }
    const double* s = m.lim_soft + 7 * i;
    Law L = soft_law(phi, m.lim_margin[i], o.h, splat(s[0]), splat(s[1]), splat(s[2]), splat(s[3]), splat(s[4]), s[5], s[6],
                     splat(m.lim_invweight[i]));
    Limit& l = w.lim[w.nlim++];
    l.on = on; l.index = i; l.dof = m.lim_dof[i];
    l.sign = sign; l.phi = phi; l.R = L.R; l.dR_dphi = L.dR; l.carry = L.carry; l.dc_dphi = L.dc0;
    l.c0 = L.c0 - L.carry * sign * w.v[l.dof];
  }
  for (int i = 0; i < m.nv; ++i) {
    T loss = w.P[m.oDof + i * kDofFields + kFrictionloss];
    Mask on = loss > 0.0;
    if (!any(on)) continue;
    const double* s = m.dof_soft + 7 * i;
    Law L = soft_law(T{}, 0, o.h, splat(s[0]), splat(s[1]), splat(s[2]), splat(s[3]), splat(s[4]), s[5], s[6], splat(m.dof_invweight[i]));
    DryFriction& d = w.dry[w.ndry++];
    d.on = on; d.dof = i; d.R = L.R; d.carry = L.carry;
    d.b0 = select(on, o.h * loss, splat(1));
    d.c0 = -L.carry * w.v[i];
  }
}

template <class G>
static Vec<G::N> relative_twist(const Model& m, const Vec<G::N>* twist, int index) {
  Vec<G::N> t = twist[m.con_bodyA[index]];
  if (m.con_bodyB[index] >= 0) t -= twist[m.con_bodyB[index]];
  return t;
}

// Kinematics, forces, M~ and active rows at (q, v, u) in w; given_*: the rows of a step read back from its tape.
template <class G>
static void prepare(const Model& m, const Options& o, Work<G>& w, const Mask* given_contacts = nullptr, const Mask* given_limits = nullptr) {
  kinematics(m, w, w.q);
  inertias(m, w);
  inverse_dynamics<G>(m, w, w.v, nullptr, w.bias);
  mass_matrix(m, w);
  joint_forces(m, o, w);
  find_contacts(m, o, w, given_contacts);
  find_limits(m, o, w, given_limits);
  for (int i = 0; i < w.ncon; ++i) {
    Contact<G>& c = w.con[i];
    Vec<G::N> t = relative_twist<G>(m, w.vel, c.index);
    c.cn0 -= c.carry * dot(c.Wr[0], t);
    for (int r = 1; r < c.rows; ++r) c.ct0[r - 1] = -c.carry * dot(c.Wr[r], t);
    c.bounce = c.time = T{};
  }
}

// Which dofs a row touches; the others are eliminated now, once. H becomes a factor of M~ itself; vf the free velocity.
template <class G>
static void free_velocity(const Model& m, Work<G>& w) {
  int nv = m.nv;
  Pattern pat = pattern_of(m, w);
  for (int i = 0; i < nv; ++i) w.dynamic[i] = 0;
  for (int g = 0; g < w.ngroups; ++g)
    for (int k = m.grp_dptr[w.groups[g].group]; k < m.grp_dptr[w.groups[g].group + 1]; ++k) w.dynamic[m.grp_dof[k]] = 1;
  for (int i = 0; i < w.nlim; ++i) w.dynamic[w.lim[i].dof] = 1;
  for (int i = 0; i < w.ndry; ++i) w.dynamic[w.dry[i].dof] = 1;
  w.ndyn = 0;
  for (int k = nv - 1; k >= 0; --k) {
    if (w.dynamic[k]) {
      w.dyn_list[w.ndyn++] = k;
      for (int a = pat.ptr[k]; a < pat.ptr[k + 1]; ++a) w.dynamic[pat.idx[a]] = 1;
    }
    copy_row(w.H0, w.M, nv, pat, k);
  }
  for (int k = nv - 1; k >= 0; --k)
    if (!w.dynamic[k]) { eliminate(w.H0, nv, pat, k); copy_row(w.H, w.H0, nv, pat, k); }
  for (int i = 0; i < w.ndyn; ++i) copy_row(w.H, w.H0, nv, pat, w.dyn_list[i]);
  for (int i = 0; i < w.ndyn; ++i) eliminate(w.H, nv, pat, w.dyn_list[i]);
  for (int i = 0; i < nv; ++i) w.vf[i] = w.rhs[i];
  solve(w.H, nv, pat, w.vf);
  for (int i = 0; i < nv; ++i) w.vf[i] += w.v[i];
}

// Newton restitution of rigid contacts that close within the step: J v' + e J vf >= 0, the impulse acting at the time of impact.
template <class G>
static void find_bounces(const Model& m, const Options& o, Work<G>& w) {
  for (int g = 0; g < w.ngroups; ++g)
    for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
      Contact<G>& c = w.con[i];
      if (m.con_law[c.index] != kRigid) continue;
      T e = w.P[m.oContact + c.index * kContactFields + kRestitution];
      if (!any(e > 0.0)) continue;
      InteriorPoint<G> ip(m, o, w);
      T speed = -dot(c.Wr[0], ip.twist(w.groups[g].group, w.vf));
      Mask hits = c.on & (e > 0.0) & (speed > o.rest_speed) & (c.phi < speed * o.h);
      c.bounce = keep(hits, e);
      c.time = keep(hits, vmax(c.phi, T{}) / select(hits, speed, splat(1)));
      c.cn0 = select(hits, -e * speed, c.cn0);
      c.dc_dphi = select(hits, T{}, c.dc_dphi);
      c.speed = speed;
    }
}

struct Outcome { Mask done, fallback; T iterations, residual; };

// Linear residuals computed afresh at the current point (they shrink by 1 - alpha only up to round-off), left in the rows
// and in rv; returns them relative: momentum to the impulses, rows to the speeds of all rows.
template <class G>
static T fresh_residuals(const Model& m, Work<G>& w, const InteriorPoint<G>& ip) {
  int nv = m.nv;
  T *r = w.rv, scale = splat(1e-12), momentum = T{}, speed = splat(1e-6), row = T{};
  for (int k = 0; k < nv; ++k)
    if (!w.dynamic[k]) { w.delta[k] = T{}; solve_up(w.H0, nv, ip.pat, k, w.delta); }
  for (int k = 0; k < nv; ++k) { w.vn[k] = w.vf[k] + w.delta[k]; r[k] = -w.M[k * (nv + 1)] * w.delta[k]; }
  for (int i = 0; i < nv; ++i)
    for (int a = m.anc_ptr[i]; a < m.anc_ptr[i + 1]; ++a) {
      int j = m.anc_idx[a];
      r[i] -= w.M[i * nv + j] * w.delta[j];
      r[j] -= w.M[j * nv + i] * w.delta[i];
    }
  for (int i = 0; i < nv; ++i) scale = vmax(scale, vmax(vabs(r[i]), w.M[i * (nv + 1)] * vabs(w.vf[i])));
  auto compare = [&](Mask on, T c, T slack, T compliance) {
    T error = slack - c - compliance;
    speed = vmax(speed, keep(on, vmax(vabs(c), vabs(compliance))));
    row = vmax(row, keep(on, vabs(error)));
    return error;
  };
  for (int g = 0; g < w.ngroups; ++g) {
    Vec<G::N> t = ip.twist(w.groups[g].group, w.vn), F = zero<G::N>();
    for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
      Contact<G>& c = w.con[i];
      speed = vmax(speed, keep(c.on, vabs(c.cn0)));
      c.r1 = compare(c.on, dot(c.Wr[0], t) + c.cn0, c.s, c.Rn * c.gam);
      F += keep(c.on, c.gam) * c.Wr[0];
      for (int k = 1; k < c.rows; ++k) {
        c.r2[k - 1] = compare(c.on & c.rub, dot(c.Wr[k], t) + c.ct0[k - 1], c.eta[k - 1], c.Rt * c.b[k - 1]);
        F += keep(c.on & c.rub, c.b[k - 1]) * c.Wr[k];
      }
    }
    ip.add_wrench(w.groups[g].group, F, r);
  }
  for (int i = 0; i < w.nlim; ++i) {
    Limit& l = w.lim[i];
    speed = vmax(speed, keep(l.on, vabs(l.c0)));
    l.r1 = compare(l.on, l.sign * w.vn[l.dof] + l.c0, l.s, l.R * l.gam);
    r[l.dof] += keep(l.on, l.sign * l.gam);
  }
  for (int i = 0; i < w.ndry; ++i) {
    DryFriction& d = w.dry[i];
    d.r2 = compare(d.on, w.vn[d.dof] + d.c0, d.eta, d.R * d.b);
    r[d.dof] += keep(d.on, d.b);
  }
  for (int i = 0; i < nv; ++i) momentum = vmax(momentum, vabs(r[i]));
  return vmax(row / speed, momentum / scale);
}

template <class G, class F>
static void for_solver_state(const Model& m, Work<G>& w, F f) {
  int k = 0;
  for (int i = 0; i < m.nv; ++i) f(w.delta[i], w.save[k++]);
  for (int i = 0; i < w.ncon; ++i) {
    Contact<G>& c = w.con[i];
    f(c.gam, w.save[k++]); f(c.s, w.save[k++]);
    if (c.rows == 1) continue;
    f(c.eta0, w.save[k++]);
    CMBRL_FOR(r, G::NT) { f(c.b[r], w.save[k++]); f(c.eta[r], w.save[k++]); }
  }
  for (int i = 0; i < w.nlim; ++i) { f(w.lim[i].gam, w.save[k++]); f(w.lim[i].s, w.save[k++]); }
  for (int i = 0; i < w.ndry; ++i) { f(w.dry[i].b, w.save[k++]); f(w.dry[i].eta0, w.save[k++]); f(w.dry[i].eta, w.save[k++]); }
}

// Contact solve at the kappas set in the rows, with the ladder: aggressive, conservative, friction growing from several
// shares of it (where the path of the full friction folds), and the same with slightly compliant contacts.
template <class G>
static Outcome contact_solve(const Model& m, const Options& o, Work<G>& w) {
  InteriorPoint<G> ip(m, o, w);
  struct Rung { Strategy strategy; double compliance; };
  static constexpr double tau = 0.9;
  const Rung ladder[] = {{{G::NT == 1 ? 0.95 : 0.9, 0.3, 1, true, false, o.max_iterations}, 0},
                         {{tau, 0.4, 3, false, false, 60}, 0},
                         {{tau, 0.3, 3, false, true, 60, 0.3}, 0},
                         {{tau, 0.3, 3, false, true, 60, 0.1}, 0},
                         {{tau, 0.3, 3, false, true, 60, 0.5}, 0},
                         {{tau, 0.3, 3, false, true, 60, 0.2}, 0},
                         {{tau, 0.3, 3, false, true, 60, 0.7}, 0},
                         {{tau, 0.3, 3, false, true, 120, 0.3, 1.3}, 0},
                         {{tau, 0.3, 3, false, true, 60, 0.3}, 1e-3},
                         {{tau, 0.3, 3, false, true, 150, 0.1, 1.3}, 1e-2}};
  const int rungs = int(sizeof ladder / sizeof *ladder);
  Outcome out{none(), none(), T{}, T{}};
  out.done = ip.run(all(), ladder[0].strategy, out.iterations);
  for (int rung = 1; rung < rungs && any(~out.done); ++rung) {
    Mask before = out.done;
    for_solver_state(m, w, [](T& x, T& kept) { kept = x; });
    bool compliant = ladder[rung].compliance > 0;
    for (int i = 0; compliant && i < w.ncon; ++i) {
      T soft = keep(~before, splat(ladder[rung].compliance * m.con_invweight[w.con[i].index]));
      w.con[i].Rn += soft;
      w.con[i].Rt += soft;
    }
    Mask now = ip.run(~before, ladder[rung].strategy, out.iterations);
    for_solver_state(m, w, [before](T& x, T& kept) { x = select(before, kept, x); });
    out.done |= now;
    if (compliant) out.fallback |= now;
  }
  out.residual = fresh_residuals(m, w, ip);
  for (int k = 0; k < 10; ++k) {  // Newton steps from fresh residuals where round-off spoilt them: iterative refinement
    Mask todo = out.done & ~((out.residual <= o.tolerance) & (ip.off_path(T{}) <= o.theta));
    if (!any(todo)) break;
    ip.refine(todo);
    out.residual = fresh_residuals(m, w, ip);
  }
  out.done &= (out.residual <= 10 * o.tolerance) & (ip.off_path(T{}) <= 10 * o.theta);  // NaN fails
  return out;
}

// ---- integration on the configuration manifold
static inline void quat_mul(const T* a, const T* b, T* r) {
  r[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
  r[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
  r[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
  r[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
}

// q <- q (+) d, d in the tangent space (rotations in body axes).
static inline void integrate(const Model& m, T* q, const T* d) {
  for (int j = 0; j < m.njoint; ++j) {
    T* x = q + m.jnt_qadr[j];
    const T* t = d + m.jnt_vadr[j];
    if (m.jnt_type[j] != kBall) { x[0] += t[0]; continue; }
    T angle2 = t[0] * t[0] + t[1] * t[1] + t[2] * t[2], angle = vsqrt(angle2), s, c;
    sincos(0.5 * angle, s, c);
    T k = select(angle > 1e-8, s / vmax(angle, splat(1e-30)), splat(0.5));
    T e[4] = {c, k * t[0], k * t[1], k * t[2]}, r[4];
    quat_mul(x, e, r);
    T n = 1.0 / vsqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2] + r[3] * r[3]);
    CMBRL_FOR(i, 4) x[i] = n * r[i];
  }
}

// Of q' = q (+) d at a ball joint: dq' = A dq + B dd, A = exp(-[t]x), B = right Jacobian of SO(3) (Sola et al., arXiv 1812.01537).
static inline void ball_jacobians(const T* t, T A[9], T B[9]) {
  T a2 = t[0] * t[0] + t[1] * t[1] + t[2] * t[2], a = vsqrt(a2), s, c;
  sincos(a, s, c);
  Mask small = a < 1e-4;
  T safe = select(small, splat(1), a), safe2 = safe * safe;
  T k1 = select(small, 1.0 - a2 / 6.0, s / safe);
  T k2 = select(small, 0.5 - a2 / 24.0, (1.0 - c) / safe2);
  T k3 = select(small, 1.0 / 6 - a2 / 120.0, (safe - s) / (safe2 * safe));
  T K[9] = {T{}, -t[2], t[1], t[2], T{}, -t[0], -t[1], t[0], T{}};
  CMBRL_FOR(i, 3) CMBRL_FOR(j, 3) {
    T KK = t[i] * t[j] - (i == j ? a2 : T{}), one = splat(i == j);
    A[3 * i + j] = one - k1 * K[3 * i + j] + k2 * KK;
    B[3 * i + j] = one - k2 * K[3 * i + j] + k3 * KK;
  }
}

// Whole step: from (w.q, w.v, w.u) to w.vn; the caller integrates.
template <class G>
static Outcome solve_step(const Model& m, const Options& o, Work<G>& w) {
  prepare(m, o, w);
  free_velocity(m, w);
  find_bounces(m, o, w);
  set_kappa(m, o, w, o.forward);
  return contact_solve(m, o, w);
}

// Tangent displacement of one step: h v' less what impacts inside the step lose by acting late (M~^-1 sum t_i J_i^T x_i).
template <class G>
static void displacement(const Model& m, const Options& o, Work<G>& w) {
  for (int i = 0; i < m.nv; ++i) { w.qtan[i] = o.h * w.vn[i]; w.shift[i] = T{}; }
  bool late = false;
  InteriorPoint<G> ip(m, o, w);
  for (int g = 0; g < w.ngroups; ++g)
    for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
      const Contact<G>& c = w.con[i];
      if (!any(c.bounce > 0.0)) continue;
      Vec<G::N> F = keep(c.bounce > 0.0, c.time * c.gam) * c.Wr[0];
      for (int k = 1; k < c.rows; ++k) F += keep((c.bounce > 0.0) & c.rub, c.time * c.b[k - 1]) * c.Wr[k];
      ip.add_wrench(w.groups[g].group, F, w.shift);
      late = true;
    }
  if (!late) return;
  for (int i = 0; i < w.ndyn; ++i) copy_row(w.H, w.H0, m.nv, ip.pat, w.dyn_list[i]);
  for (int i = 0; i < w.ndyn; ++i) eliminate(w.H, m.nv, ip.pat, w.dyn_list[i]);
  solve(w.H, m.nv, ip.pat, w.shift);
  for (int i = 0; i < m.nv; ++i) w.qtan[i] -= w.shift[i];
}

}  // namespace cmbrl::CMBRL_ISA
