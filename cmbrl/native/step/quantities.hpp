// What a step is made of, for callers who look inside: smooth dynamics, and the rows of its contact problem.
#pragma once
#include "step/lanes.hpp"

namespace cmbrl::CMBRL_ISA {

// M (n, nv, nv) with armature, bias (n, nv), lengths of lines (n, nline), gaps (n, ncontact), normal and tangent rows J
// (n, ncontact, 1 + NT, nv), without rows that turn: those that are not null.
template <class G>
static void smooth_quantities(const Model& m, const Options& o, const Batch& b, double* M, double* bias, double* length, double* gap, double* J,
                              int64_t begin, int64_t end, StepMemory& memory) {
  Work<G> w = open<G>(m, Purpose::step, memory);
  int nv = m.nv, rows = 1 + G::NT;
  Options every = o;
  every.prune = __builtin_inf();
  every.convex = 0;  // whole contacts
  every.look_ahead = 1;
  every.both_ways = 1;
  for (int64_t e = begin; e < end; e += W) {
    Lanes l = lanes_from(e, end);
    gather_parameters(m, b, l, w, e == begin);
    Mask finite = gather_states(m, b, l, w);
    kinematics(m, w, w.q);
    find_lines(m, w);
    inertias(m, w);
    inverse_dynamics<G>(m, w, w.v, nullptr, w.bias);
    mass_matrix(m, w);
    for (int i = 0; i < m.nline; ++i) add_square(m, w, i, w.P[m.oDof + i * kDofFields + kArmature], w.M, m.mass);
    w.ncon = 0;
    if (gap || J) find_contacts(m, every, w, false);
    for (int i = 0; gap && i < m.ncontact; ++i)
      for (int lane = 0; m.con_type[i] == kHulls && lane < l.n; ++lane) gap[l.at[lane] * m.ncontact + i] = kAway;
    if (M) scatter_packed(w.M, nv, m.mass, l, M);
    scatter(w.bias, nv, nv, l, bias);
    scatter(w.line_length, m.nline, m.nline, l, length);
    for (int i = 0; i < w.ncon; ++i) {
      const Contact<G>& c = w.con[i];
      for (int lane = 0; gap && lane < l.n; ++lane)
        if (!c.hulls || c.on[lane]) gap[l.at[lane] * m.ncontact + c.index] = c.phi[lane];
      int g = m.con_group[c.index];
      for (int r = 0; J && r < c.rows && r < rows; ++r)
        for (int k = m.grp_dptr[g]; k < m.grp_dptr[g + 1]; ++k) {
          T x = dot(w.S[m.grp_dof[k]], c.Wr[r]);
          for (int lane = 0; lane < l.n; ++lane)
            J[((l.at[lane] * m.ncontact + c.index) * rows + r) * nv + m.grp_dof[k]] = m.grp_sign[k] > 0 ? x[lane] : -x[lane];
        }
    }
    spoil(~finite, nv * nv, l, M);
    spoil(~finite, nv, l, bias);
    spoil(~finite, m.nline, l, length);
    spoil(~finite, m.ncontact, l, gap);
  }
}

// Factors (nweight,) on inverse weights at parameters theta.
template <class G>
static void weights_at(const Model& m, const double* theta, double* out, StepMemory& memory) {
  Work<G> w = open<G>(m, Purpose::step, memory);
  const double* each[W];
  for (int lane = 0; lane < W; ++lane) each[lane] = theta;
  load_parameters(m, w, each);
  for (int j = 0; j < m.nweight; ++j) out[j] = w.weight[j][0];
}

// Rows of a step as its solve has them in the end, with those that were left out too soon. Dry friction has no row here: it
// acts in vf with the impulses it has in that solution.
template <class G>
static void rows_of_step(const Model& m, const Options& o, Work<G>& w) {
  Options now = o;
  auto set_up = [&] {
    for (int i = 0; i < m.nq; ++i) w.q[i] = w.start[i];
    set_up_step(m, now, w);
  };
  for (int i = 0; i < m.nq; ++i) w.start[i] = w.q[i];
  for (;;) {
    Mask missed;
    w.nguess = 0;
    set_up();
    solve_with_missed(m, now, w, none(), missed);
    if (!any(missed)) break;
    now.prune = wider(now.prune);
  }
  for (int i = 0; i < m.nv; ++i) w.shift[i] = T{};
  for (int i = 0; i < w.ndry; ++i) add_pull(m, w, w.dry[i].line, keep(w.dry[i].on, w.dry[i].b), w.shift);
  set_up();  // the solve may have changed the rows
  if (w.ndry == 0) return;
  solve(w.free_factor, m.nv, m.mass, w.shift);
  for (int i = 0; i < m.nv; ++i) w.vf[i] += w.shift[i];
}

// The rows of the first physics step of a control step. The arrays come in as zeros.
template <class G>
static void step_rows(const Model& m, const Options& o, const Batch& b, const RowBatch& out, int64_t begin, int64_t end, StepMemory& memory) {
  Work<G> w = open<G>(m, Purpose::step, memory);
  int nv = m.nv, rows = out.rows, first_limit = m.ncontact * out.rows_a_contact, nrow = first_limit + m.nlimit;
  for (int64_t e = begin; e < end; e += W) {
    Lanes l = lanes_from(e, end);
    gather_parameters(m, b, l, w, e == begin);
    Mask finite = gather_states(m, b, l, w);
    if (o.leapfrog) { scaled(m, w.v, 0.5 * o.h, w.qtan); integrate(m, w.q, w.qtan); }
    rows_of_step(m, o, w);
    scatter_packed(w.M, nv, m.mass, l, out.M);
    scatter(w.vf, nv, nv, l, out.v_free);
    spoil(~finite, nv * nv, l, out.M);
    spoil(~finite, nv, l, out.v_free);
    for (int lane = 0; lane < l.n; ++lane) {
      int64_t base = l.at[lane] * nrow;
      for (int g = 0; g < w.ngroups; ++g)
        for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
          const Contact<G>& c = w.con[i];
          if (!c.on[lane]) continue;
          int64_t at = base + c.of[lane] * out.rows_a_contact + c.edge;
          bool rubs = c.rows > 1 && c.rub[lane];
          out.active[at] = 1;
          out.mu[at] = rubs ? c.mu[lane] : 0;
          out.convex[at] = rubs && c.convex[lane];
          for (int r = 0; r < (rubs ? rows : 1); ++r) {
            out.R[at * rows + r] = (r ? c.Rt : c.Rn)[lane];
            if (r >= c.rows) continue;  // others turn, too
            out.b[at * rows + r] = (r ? c.ct0[r - 1] : c.cn0)[lane];
            for (int k = m.grp_dptr[w.groups[g].group]; k < m.grp_dptr[w.groups[g].group + 1]; ++k)
              out.J[(at * rows + r) * nv + m.grp_dof[k]] = m.grp_sign[k] * dot(w.S[m.grp_dof[k]], c.Wr[r])[lane];
          }
        }
      for (int i = 0; i < w.nlim; ++i) {
        const Limit& c = w.lim[i];
        if (!c.on[lane]) continue;
        int64_t at = base + first_limit + c.index;
        out.active[at] = 1;
        out.b[at * rows] = c.c0[lane];
        out.R[at * rows] = c.R[lane];
        for (int k = 0; c.round && k < 3; ++k) out.J[at * rows * nv + c.line - 2 + k] = c.axis[k][lane];
        for (int k = c.round ? m.line_ptr[c.line + 1] : m.line_ptr[c.line]; k < m.line_ptr[c.line + 1]; ++k)
          out.J[at * rows * nv + m.line_dof[k]] = c.sign[lane] * w.line_c[k][lane];
      }
    }
  }
}

}  // namespace cmbrl::CMBRL_ISA
