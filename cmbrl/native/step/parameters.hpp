// Right-hand side of the implicit derivative with respect to the named parameters: each moves entries of the physical vector P.
#pragma once
#include "step/columns.hpp"
#include "step/force_columns.hpp"
#include "step/load_weights.hpp"

namespace cmbrl::CMBRL_ISA {

// Lane parameters: P = P0 + sum_k (theta_k - nominal_k) D_k and the shapes of inertias, apart from contacts, which load theirs
// when they are active.
template <class G>
static void load_parameters(const Model& m, Work<G>& w, const double* const* theta) {
  for (int i = 0; i < m.oContact; ++i) w.P[i] = splat(m.P[i]);
  w.radius_slack = T{};
  for (int k = 0; k < m.ntheta; ++k) {
    T d = T{};
    for (int lane = 0; theta && lane < W; ++lane) d[lane] = theta[lane][k] - m.par_nominal[k];
    w.dtheta[k] = d;
    for (int e = m.par_ptr[k]; e < m.par_ptr[k + 1]; ++e) w.P[m.par_idx[e]] += d * m.par_coef[e];
    w.radius_slack = vmax(w.radius_slack, m.radius_moves * m.par_radius[k] * vabs(d));
  }
  load_shapes(m, w);
  load_weights(m, w);
}

template <class G>
struct ParameterColumns : ForceColumns<G> {
  using ForceColumns<G>::m;
  using ForceColumns<G>::o;
  using ForceColumns<G>::w;
  using ForceColumns<G>::part;
  using ForceColumns<G>::at;

  // f(k-th dof of the contact's group, dof, pull) of a wrench.
  template <class Take>
  void for_pulls(const Contact<G>& c, Vec<G::N> F, Take f) {
    int group = m.con_group[c.index], begin = m.grp_dptr[group];
    if (part == Part::late_rows) F = late_weight(c) * F;
    for (int k = begin; k < m.grp_dptr[group + 1]; ++k) {
      T pull = dot(w.S[m.grp_dof[k]], F);
      f(k - begin, m.grp_dof[k], m.grp_sign[k] > 0 ? pull : -pull);
    }
  }
  void add_wrench(const Contact<G>& c, const Vec<G::N>& F) {
    for_pulls(c, F, [&](int, int dof, T pull) { at(dof) += pull; });
  }

  // Wrench of a change of the gap (dphi) together with the contact point (dp along the normal).
  Vec<G::N> gap(Contact<G>& c, double dphi, double dp) {
    Vec<G::N> relative = passing_twist(m, w, w.tn, c) - c.carry * passing_twist(m, w, w.vel, c), Y = zero<G::N>(), glide = zero<G::N>();
    Shift<G> s{};
    s.dp = dp * normal_of(c);
    if (glides(m, c)) glide = (1.0 - c.carry) * glide_shift(m, w, c, zero<G::N>(), s.dp, zero<G::D>());
    T E[1 + G::MT] = {};
    CMBRL_FOR(r, c.rows) {
      Vec<G::N> dW = wrench_shift(c, s, r);
      E[r] = dot(dW, relative) + dot(c.Wr[r], glide) + dphi * (r == 0 ? c.dc_dphi + c.dRn_dphi * c.gam : c.dRt_dphi * c.b[r - 1]);
      Y += impulse(c, r) * dW;
    }
    T closing = dphi * c.dc_dphi;
    if (c.edge) {  // whose moment changes with the point
      Vec<G::N> free = free_twist(m, w, m.con_group[c.index]) - c.carry * relative_twist<G>(m, w.vel, c.index);
      if (glides(m, c)) free += (1.0 - c.carry) * glide_of(m, w, c);
      closing += dot(wrench_shift(c, s, 0), free) + dot(c.Wr[0], glide);
    }
    return Y + response(c, E) + kappa_response(c, c.slope * closing + dphi * c.dRn_dphi * c.slope_R);
  }

  // Fields of the law: closed-form and scalar, so differenced in place (central, relative step 1e-6).
  Vec<G::N> law(Contact<G>& c, int field) {
    const T* p = c.P;
    T low[kContactFields], high[kContactFields];
    std::memcpy(low, p, sizeof low);
    std::memcpy(high, p, sizeof high);
    T step = 1e-6 * vmax(vabs(p[field]), splat(1e-3));
    low[field] -= step;
    high[field] += step;
    Known<G> a = c, b = c;
    contact_law(m, o, a, low);
    contact_law(m, o, b, high);
    T scale = 0.5 / step;
    Vec<G::N> t = passing_twist(m, w, w.vel, c), end = passing_twist(m, w, w.tn, c);
    T dcarry = scale * (b.carry - a.carry), E[1 + G::MT] = {};
    T dR = scale * (b.Rn - a.Rn), closing = select(c.bounce, T{}, scale * (b.cn0 - a.cn0) - dcarry * dot(c.Wr[0], t));
    E[0] = closing + dR * c.gam;
    for (int r = 1; r < c.rows; ++r) E[r] = scale * (b.Rt - a.Rt) * c.b[r - 1] - dcarry * dot(c.Wr[r], t);
    for (int r = 1 + G::NT; r < c.rows; ++r)
      E[r] += turning_growth(c, r, field) * (dot(c.Wr[r], end) - c.carry * dot(c.Wr[r], t));
    bool tilts = c.edge && field == field_of_edge(c.edge);  // towards what it has beside the normal
    double ratio = c.edge ? ratio_of_edge(m, c.index, c.edge) : 1;
    if (tilts) {
      T before = c.carry * dot(c.Wr[1], t);
      E[0] += ratio * (dot(c.Wr[1], end) - before);
      closing += ratio * (dot(c.Wr[1], free_twist(m, w, m.con_group[c.index]) + end - relative_twist<G>(m, w.tn, c.index)) - before);
    }
    Vec<G::N> Y = response(c, E) + kappa_response(c, c.slope * closing + c.slope_R * dR);
    if (tilts) Y += keep(c.on, ratio * c.gam) * c.Wr[1];
    for (int r = 1 + G::NT; r < c.rows; ++r) Y += (impulse(c, r) * turning_growth(c, r, field)) * c.Wr[r];
    if (field == kMu && c.rows > 1) {  // the cone itself
      T b0 = c.mu * c.gam, y[G::MT];
      CMBRL_FOR(r, c.rows - 1) y[r] = keep(c.rub, c.gam * (c.b[r] * c.eta0 / b0 - c.eta[r]));
      Y += target_response(c, T{}, y);  // under the convex law, too: of its normal row, gamma dmu eta0 cancels against b0 deta0
    }
    return Y;
  }
  // Wrench of a unit change of one field.
  Vec<G::N> contact(Contact<G>& c, int field) {
    if (field == kRadius) return gap(c, -1, -0.5);
    if (field != kRestitution) return law(c, field);
    T E[1 + G::MT] = {};
    E[0] = select(c.bounce, c.by_e, T{});
    return response(c, E) + kappa_response(c, c.slope * E[0]);
  }

  // Relative change dR of the compliance of a limit, and of dry friction.
  void limit(const Limit& l, T dR) {
    dR *= l.R;
    T pull = keep(l.on, dR * (l.slope_R / (l.s + l.gam * l.R) - l.Th * l.gam));
    if (!l.round) return this->add_along(l.line, l.sign * pull);
    CMBRL_FOR(k, 3) at(l.line - 2 + k) += l.axis[k] * pull;
  }
  // Of both limits of a line, each farther away by dphi.
  void wider(int line, double dphi) {
    for (int i = 0; i < w.nlim; ++i) {
      const Limit& l = w.lim[i];
      if (l.line != line || l.round) continue;
      T growth = (l.slope_R * l.dR_dphi + l.slope * l.dc_dphi) / (l.s + l.gam * l.R);
      this->add_along(line, l.sign * keep(l.on, dphi * (growth - l.Th * (l.dc_dphi + l.dR_dphi * l.gam))));
    }
  }
  // Of the law of both limits of a line: a field of it, differenced in place as those of contacts are.
  void stop(int line, int field, double coef) {
    const T* scale = w.P + m.oDof + line * kDofFields + kStopTime;
    for (int i = 0; i < w.nlim; ++i) {
      const Limit& l = w.lim[i];
      if (l.line != line) continue;
      T low[3] = {scale[0], scale[1], scale[2]}, high[3] = {scale[0], scale[1], scale[2]};
      T step = 1e-6 * scale[field - kStopTime], speed = along(m, w, l, w.v);
      low[field - kStopTime] -= step;
      high[field - kStopTime] += step;
      Law a = stop_law(m, o, w, l.index, l.phi, low), b = stop_law(m, o, w, l.index, l.phi, high);
      T by = (0.5 * coef) / step, dR = by * (b.R - a.R), dc = by * (b.c0 - a.c0 - (b.carry - a.carry) * speed);
      T pull = keep(l.on, (l.slope_R * dR + l.slope * dc) / (l.s + l.gam * l.R) - l.Th * (dc + dR * l.gam));
      if (l.round) CMBRL_FOR(k, 3) at(line - 2 + k) += l.axis[k] * pull;
      else this->add_along(line, l.sign * pull);
    }
  }
  void softer(const DryFriction& d, T dR) { this->add_along(d.line, keep(d.on, -d.Th * d.R * dR * d.b)); }

  void column(int k) {
    if (m.par_shape[k] >= 0 && part != Part::late_rows) this->shape(k);
    for (int e = m.par_ptr[k]; e < m.par_ptr[k + 1];) {
      int idx = m.par_idx[e];
      double coef = m.par_coef[e];
      bool row = idx >= m.oPlane && idx < m.oAct;  // a contact's plane
      if (row ? part == Part::free || part == Part::late_inertia : part == Part::late_rows) { ++e; continue; }
      if (idx < m.oDof) {  // consecutive entries of one body are one change of inertia
        int b = idx / m.body_fields;
        Inertia<G> dI{};
        for (; e < m.par_ptr[k + 1] && m.par_idx[e] / m.body_fields == b && m.par_idx[e] < m.oDof; ++e)
          add_inertia(m, w, b, m.par_idx[e] % m.body_fields, m.par_coef[e], dI);
        this->body(b, dI);
        continue;
      }
      ++e;
      if (part == Part::gyroscopic) continue;
      int line = (idx - m.oDof) / kDofFields, field = (idx - m.oDof) % kDofFields;
      if (idx < m.oPlane && field == kWider) {
        if (part == Part::step) wider(line, coef);
      } else if (idx < m.oPlane && field > kWider) {
        if (part == Part::step) stop(line, field, coef);
      } else if (idx < m.oPlane) this->line(line, field, coef);
      else if (idx < m.oAct) {
        for (int i = 0; i < w.ncon; ++i)
          if (m.con_plane[w.con[i].index] == idx - m.oPlane) add_wrench(w.con[i], coef * gap(w.con[i], -1, 0.5));
      } else if (idx < m.oFluid) this->actuator((idx - m.oAct) / kActuatorFields, (idx - m.oAct) % kActuatorFields, coef);
      else if (idx >= m.oGravity) this->gravity(idx - m.oGravity, coef);  // of a fluid: fluid_columns
    }
  }
};

// d gap / d theta_k of a contact: radii and plane heights.
template <class G>
static T gap_of_parameter(const Model& m, const Contact<G>& c, int k) {
  T by_radius = T{};
  for_candidates(c, [&](int i, Mask lanes) {
    for (int e = m.con_par_ptr[i]; e < m.con_par_ptr[i + 1]; ++e)
      if (m.con_par[e] == k && m.con_par_field[e] == kRadius) by_radius -= keep(lanes, splat(m.con_par_coef[e]));
  });
  double d = 0;
  for (int e = m.par_ptr[k]; e < m.par_ptr[k + 1]; ++e)
    if (m.con_plane[c.index] >= 0 && m.par_idx[e] == m.oPlane + m.con_plane[c.index]) d -= m.par_coef[e];
  return by_radius + d;
}

// Of contacts: each field's wrench is found once. Masses soften by the row's inverse weight.
template <class G, class F>
static void contact_columns(const Model& m, Work<G>& w, F columns) {
  for (int j = 0; j < m.nweight; ++j) w.weight_pulls[j] = 0;
  for (int i = 0; i < w.ncon; ++i) {
    Contact<G>& c = w.con[i];
    Vec<G::N> unit[kContactFields];
    bool known[kContactFields] = {};
    auto add = [&](int k, int field, T coef) {
      if (w.column[k] < 0) return;
      if (!known[field]) unit[field] = columns(k).contact(c, field);
      known[field] = true;
      columns(k).add_wrench(c, coef * unit[field]);
    };
    for_candidates(c, [&](int i, Mask lanes) {
      T weight = contact_weight(m, w, i);
      for (int e = m.con_par_ptr[i]; e < m.con_par_ptr[i + 1]; ++e) {
        T coef = keep(lanes, splat(m.con_par_coef[e]));
        if (m.con_par_field[e] == kRscale) coef *= weight;
        add(m.con_par[e], m.con_par_field[e], coef);
      }
      if (!w.softens || (m.con_weight[2 * i] < 0 && m.con_weight[2 * i + 1] < 0)) return;
      auto of_all = columns(w.parameter[0]);
      if (!known[kRscale]) unit[kRscale] = of_all.contact(c, kRscale);
      known[kRscale] = true;
      CMBRL_FOR(side, 2) if (int j = m.con_weight[2 * i + side]; j >= 0) {
        T share = keep(lanes, m.con_share[2 * i + side] * c.P[kRscale] / weight), *sum = w.weight_pull + int64_t(j) * m.nv;
        for (int d = 0; !w.weight_pulls[j] && d < m.nv; ++d) sum[d] = T{};
        w.weight_pulls[j] = 1;
        of_all.for_pulls(c, unit[kRscale], [&](int, int dof, T pull) { sum[dof] += share * pull; });
      }
    });
  }
  for (int j = 0; j < m.nweight; ++j) {  // many masses and contacts, one pull
    if (!w.weight_pulls[j]) continue;
    const T* sum = w.weight_pull + int64_t(j) * m.nv;
    for_weights(m, w, j, [&](int k, T change) {
      auto out = columns(k);
      for (int d = 0; d < m.nv; ++d) out.at(d) += change * sum[d];
    });
  }
}

// Columns of parameters (nv x np) at the solution; needs the smooth terms and the linearised rows.
template <class G>
static void parameter_terms(const Model& m, const Options& o, Work<G>& w, T* out, Part part = Part::step) {
  bool forces = part == Part::step || part == Part::free;
  if (w.np == 0) return;
  if (forces) for (int i = 0; i < m.nv * w.np; ++i) out[i] = T{};
  auto columns = [&](int k) { return ParameterColumns<G>{{m, o, w, out + w.column[k], w.np, part}}; };
  for (int i = 0; i < w.np; ++i) columns(w.parameter[i]).column(w.parameter[i]);
  if (forces && m.in_fluid()) fluid_columns(m, o, w, m.implicit_gains && !o.apart(), out);
  if (part == Part::step || part == Part::late_rows) contact_columns(m, w, columns);
  if (part == Part::step) {
    for (int i = 0; i < w.nlim; ++i)
      if (int j = m.lim_weight[w.lim[i].index]; j >= 0)
        for_weights(m, w, j, [&](int k, T change) { columns(k).limit(w.lim[i], change / w.weight[j]); });
    for (int i = 0; i < w.ndry; ++i)
      if (int j = m.line_weight[w.dry[i].line]; j >= 0)
        for_weights(m, w, j, [&](int k, T change) { columns(k).softer(w.dry[i], change / w.weight[j]); });
  }
  if (forces && w.ahead) add_product(m, w.C, w.Bp, w.np, out);
}

}  // namespace cmbrl::CMBRL_ISA
