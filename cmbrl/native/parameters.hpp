// Right-hand side of the implicit derivative with respect to the named parameters: each moves entries of the physical vector P.
#pragma once
#include "derivative.hpp"

namespace cmbrl::CMBRL_ISA {

// Lane parameters: P = P0 + sum_k (theta_k - nominal_k) D_k, apart from contacts, which load theirs when they are active.
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
}

// Of the step's equation; or of that of late impulses, M~ shift = sum t_i J_i^T x_i (impact.hpp): its rows, its left side.
enum class Part { step, late_rows, late_inertia };

template <class G>
struct ParameterColumns {
  const Model& m;
  const Options& o;
  Work<G>& w;
  T* out;      // nv values, stride
  int stride;
  Part part;
  T& at(int dof) { return out[dof * stride]; }

  void add_wrench(const Contact<G>& c, Vec<G::N> F) {
    int group = m.con_group[c.index];
    if (part == Part::late_rows) F = late_weight(c) * F;
    for (int k = m.grp_dptr[group]; k < m.grp_dptr[group + 1]; ++k) {
      T f = dot(w.S[m.grp_dof[k]], F);
      at(m.grp_dof[k]) += m.grp_sign[k] > 0 ? f : -f;
    }
  }

  void compensation(int b, const Inertia<G>& dI) {
    if (part != Part::step || m.body_lift[b] == 0) return;
    double share = m.body_lift[b] * o.h;
    Vec<G::N> f = lift<G>(share * dI.m, share * (dI.h + dI.m * lift_point(m, w, b)), upwards(m, w));
    for (int d = m.body_lastdof[b]; d >= 0; d = m.above(d)) at(d) += keep(lifted(m, w, d), dot(w.S[d], f));
  }
  void body(int b, const Inertia<G>& dI) {  // inverse dynamics is linear in the inertia
    if (m.nlift > 0) compensation(b, dI);
    bool ahead = part == Part::step && w.ahead;
    const Vec<G::N> &acc = (ahead ? w.bacc : w.acc)[b], &vel = (ahead ? w.bvel : w.vel)[b];
    Vec<G::N> f = dI * acc + cross_force<G>(vel, dI * vel);
    double scale = part == Part::step ? o.h : 1;
    for (int d = m.body_lastdof[b]; d >= 0; d = m.above(d)) at(d) -= scale * dot(w.S[d], f);
  }
  void add_inertia(int b, int field, double coef, Inertia<G>& dI) {
    const T* p = w.P + b * m.body_fields;
    typename G::V c;
    CMBRL_FOR(i, G::D) c[i] = p[1 + i];
    c = w.pos[b] + G::rotate(w.R[b], c);
    T k = splat(coef);
    if (field == 0) {
      dI.m += k;
      dI.h += k * c;
      G::add_steiner(dI.I, k, c);
    } else if (field <= G::D) {
      typename G::V e = zero<G::D>();
      e[field - 1] = k;
      e = G::rotate(w.R[b], e);
      dI.h += p[0] * e;
      G::add_steiner_derivative(dI.I, p[0], c, e);
    } else {
      T unit[G::SYM] = {}, world[G::SYM];
      unit[field - 1 - G::D] = k;
      G::sym_rotate(w.R[b], unit, world);
      CMBRL_FOR(i, G::SYM) dI.I[i] += world[i];
    }
  }

  void add_along(int line, T x) {
    for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k) at(m.line_dof[k]) += w.line_c[k] * x;
  }
  void line(int i, int field, double coef) {
    bool late = part == Part::late_inertia;
    if (late && field != kArmature && (field != kDamping || !damps_implicitly(m, i))) return;
    T before = late ? T{} : along(m, w, i, w.v), after = along(m, w, i, late ? w.shift : w.vn);
    Spring spring = spring_of(m, w, i);
    switch (field) {
      case kArmature: add_along(i, -coef * (after - before)); break;
      case kDamping: add_along(i, -coef * o.h * (damps_implicitly(m, i) ? after : before)); break;
      case kStiffness: {
        if (i < m.nv && m.dof_qadr[i] < 0 && m.nballspring > 0) spring.stretch = w.stretch[i];
        Mask stretched = spring.stiffness != 0.0;
        if (o.implicit_springs) spring.stretch += keep(stretched, o.h * after);
        add_along(i, -coef * o.h * spring.stretch);
        break;
      }
      case kSpringref: add_along(i, coef * o.h * spring.stiffness); break;
      default:
        for (int k = 0; k < w.ndry; ++k) {
          const DryFriction& d = w.dry[k];
          if (d.line != i) continue;
          T inv = 1.0 / (d.eta0 - d.b * d.eta / d.b0 + d.R * (d.b0 - d.b * d.b / d.b0));
          add_along(i, keep(d.on, coef * o.h * inv * (d.b * (d.eta0 - o.backward.dry) / d.b0 - d.eta)));
        }
    }
  }

  // Change of gap (dphi) together with the contact point (dp along the normal).
  void gap(Contact<G>& c, double dphi, double dp, double coef) {
    Vec<G::N> relative = relative_twist<G>(m, w.tn, c.index) - c.carry * relative_twist<G>(m, w.vel, c.index), Y = zero<G::N>();
    Shift<G> s{};
    s.dp = dp * c.d[0];
    T E[1 + G::NT];
    CMBRL_FOR(r, c.rows) {
      Vec<G::N> dW = wrench_shift(c, s, r);
      E[r] = dot(dW, relative) + dphi * (r == 0 ? c.dc_dphi + c.dRn_dphi * c.gam : c.dRt_dphi * c.b[r - 1]);
      Y += impulse(c, r) * dW;
    }
    Y += response(c, E) + kappa_response(c, dphi * (c.dc_dphi * c.slope + c.dRn_dphi * c.slope_R));
    add_wrench(c, coef * Y);
  }

  // Fields of the law: closed-form and scalar, so differenced in place (central, relative step 1e-6).
  void law(Contact<G>& c, int field, double coef) {
    const T* p = c.P;
    T low[kContactFields], high[kContactFields];
    std::memcpy(low, p, sizeof low);
    std::memcpy(high, p, sizeof high);
    T step = 1e-6 * vmax(vabs(p[field]), splat(1e-3));
    low[field] -= step;
    high[field] += step;
    Contact<G> a = c, b = c;
    contact_law(m, o, a, low);
    contact_law(m, o, b, high);
    T scale = 0.5 / step;
    Vec<G::N> t = relative_twist<G>(m, w.vel, c.index);
    T dcarry = scale * (b.carry - a.carry), E[1 + G::NT];
    T dR = scale * (b.Rn - a.Rn);
    E[0] = select(c.bounce, T{}, scale * (b.cn0 - a.cn0) - dcarry * dot(c.Wr[0], t)) + dR * c.gam;
    for (int r = 1; r < c.rows; ++r) E[r] = scale * (b.Rt - a.Rt) * c.b[r - 1] - dcarry * dot(c.Wr[r], t);
    Vec<G::N> Y = response(c, E) + kappa_response(c, c.slope * (E[0] - dR * c.gam) + c.slope_R * dR);
    if (field == kMu && c.rows > 1) {  // the cone itself
      T b0 = c.mu * c.gam, y[G::NT];
      CMBRL_FOR(r, G::NT) y[r] = c.gam * (c.b[r] * c.eta0 / b0 - c.eta[r]);
      CMBRL_FOR(r, G::NT) CMBRL_FOR(k, G::NT) Y += keep(c.on & c.rub, c.Ai[r][k] * y[k]) * c.Wr[1 + r];
    }
    add_wrench(c, coef * Y);
  }

  void wide(int a, int field, double coef) {
    const T* p = w.P + m.oAct + a * kActuatorFields;
    if (part != Part::step || field > kBias0) return;
    int k = 0;
    while (m.wide_act[k] != a) ++k;
    Drive drive = wide_drive(m, w, a);
    T ctrl = vmin(vmax(w.u[a], splat(m.act_ctrl[2 * a])), splat(m.act_ctrl[2 * a + 1]));
    T push = field == kGear ? drive.force : keep(drive.free, field == kGain ? p[kGear] * ctrl : p[kGear]);
    for_arms(m, w, k, [&](int d, T arm) { at(d) += keep(w.yields[d], coef * o.h * arm * push); });
  }

  // M~ keeps the velocity gains of a joint that clamps its actuators, and their force does not change there.
  void actuator(int a, int field, double coef) {
    const T* p = w.P + m.oAct + a * kActuatorFields;
    int line = m.act_line[a];
    if (line < 0) return wide(a, field, coef);
    T q = w.line_length[line], v = along(m, w, line, w.v), after = along(m, w, line, w.vn);
    T dv = m.implicit_gains ? after - v : T{}, g = p[kGear];
    T flo = splat(m.act_force[2 * a]), fhi = splat(m.act_force[2 * a + 1]);
    T ctrl = vmin(vmax(w.u[a], splat(m.act_ctrl[2 * a])), splat(m.act_ctrl[2 * a + 1]));
    T force = p[kGain] * ctrl + p[kBias0] + g * (p[kBias1] * q + p[kBias2] * v);
    Mask free = (force >= flo) & (force <= fhi);
    T pull = p[kBias1] * q + p[kBias2] * (v + dv);
    T spring = o.implicit_springs ? o.h * after : T{};
    if (part == Part::late_inertia) {
      if (!m.implicit_gains) return;
      T late = along(m, w, line, w.shift);
      if (field == kGear) add_along(line, keep(free, coef * o.h * 2.0 * g * p[kBias2] * late));
      if (field == kBias2) add_along(line, keep(free, coef * o.h * g * g * late));
      return;
    }
    T r, held = T{};  // held: through M~ alone
    if (field == kGear) held = keep(free, 2.0 * g * p[kBias2] * dv);
    if (field == kBias2) held = keep(free, g * g * dv);
    if (line >= m.nv && field == kGear) held += keep(free, 2.0 * g * p[kBias1] * spring);
    if (line >= m.nv && field == kBias1) held = keep(free, g * g * spring);
    switch (field) {
      case kGear: r = select(free, force + g * (pull + p[kBias2] * dv) + 2.0 * g * p[kBias1] * spring, vmin(vmax(force, flo), fhi)); break;
      case kGain: r = keep(free, g * ctrl); break;
      case kBias0: r = keep(free, g); break;
      case kBias1: r = keep(free, g * g * (q + spring)); break;
      default: r = keep(free, g * g * (v + dv));
    }
    for (int k = m.line_ptr[line]; k < m.line_ptr[line + 1]; ++k)
      at(m.line_dof[k]) += coef * o.h * w.line_c[k] * select(w.yields[m.line_dof[k]], r, held);
  }

  void gravity(int axis, double coef) {
    if (part != Part::step) return;
    Vec<G::N> fall = zero<G::N>();
    fall[G::A + axis] = splat(coef * o.h);
    for (int i = 0; i < m.nv; ++i) at(i) += dot(w.S[i], w.Ic[m.dof_body[i]] * fall);
    if (m.nlift == 0) return;
    typename G::V down = lin<G>(fall);
    for (int i = 0; i < m.nv; ++i) {
      int b = m.dof_body[i];
      at(i) -= keep(lifted(m, w, i), dot(w.S[i], lift<G>(w.lift_mass[b], w.lift_moment[b], down)));
    }
  }

  void column(int k) {
    for (int e = m.par_ptr[k]; e < m.par_ptr[k + 1];) {
      int idx = m.par_idx[e];
      double coef = m.par_coef[e];
      bool row = idx >= m.oPlane && idx < m.oAct;  // a contact's plane
      if ((part == Part::late_rows && !row) || (part == Part::late_inertia && row)) { ++e; continue; }
      if (idx < m.oDof) {  // consecutive entries of one body are one change of inertia
        int b = idx / m.body_fields;
        Inertia<G> dI{};
        for (; e < m.par_ptr[k + 1] && m.par_idx[e] / m.body_fields == b && m.par_idx[e] < m.oDof; ++e)
          add_inertia(b, m.par_idx[e] % m.body_fields, m.par_coef[e], dI);
        body(b, dI);
        continue;
      }
      ++e;
      if (idx < m.oPlane) line((idx - m.oDof) / kDofFields, (idx - m.oDof) % kDofFields, coef);
      else if (idx < m.oAct) {
        for (int i = 0; i < w.ncon; ++i)
          if (m.con_plane[w.con[i].index] == idx - m.oPlane) gap(w.con[i], -1, 0.5, coef);
      } else if (idx < m.oGravity) actuator((idx - m.oAct) / kActuatorFields, (idx - m.oAct) % kActuatorFields, coef);
      else gravity(idx - m.oGravity, coef);
    }
  }
  void contact(Contact<G>& c, int field, double coef) {
    if (field == kRadius) gap(c, -1, -0.5, coef);
    else if (field != kRestitution) law(c, field, coef);
    else {
      T E[1 + G::NT] = {};
      E[0] = select(c.bounce, c.by_e, T{});
      add_wrench(c, coef * (response(c, E) + kappa_response(c, c.slope * E[0])));
    }
  }
};

// d gap / d theta_k of a contact: radii and plane heights.
template <class G>
static T gap_of_parameter(const Model& m, const Contact<G>& c, int k) {
  double d = 0;
  for (int e = m.con_par_ptr[c.index]; e < m.con_par_ptr[c.index + 1]; ++e)
    if (m.con_par[e] == k && m.con_par_field[e] == kRadius) d -= m.con_par_coef[e];
  for (int e = m.par_ptr[k]; e < m.par_ptr[k + 1]; ++e)
    if (m.con_plane[c.index] >= 0 && m.par_idx[e] == m.oPlane + m.con_plane[c.index]) d -= m.par_coef[e];
  return splat(d);
}

// Columns of all parameters (nv x ntheta) at the solution; needs the smooth terms and the linearised rows.
template <class G>
static void parameter_terms(const Model& m, const Options& o, Work<G>& w, T* out, Part part = Part::step) {
  if (part == Part::step) for (int i = 0; i < m.nv * m.ntheta; ++i) out[i] = T{};
  auto columns = [&](int k) { return ParameterColumns<G>{m, o, w, out + k, m.ntheta, part}; };
  for (int k = 0; k < m.ntheta; ++k) columns(k).column(k);
  for (int i = 0; i < w.ncon && part != Part::late_inertia; ++i) {
    Contact<G>& c = w.con[i];
    for (int e = m.con_par_ptr[c.index]; e < m.con_par_ptr[c.index + 1]; ++e)
      columns(m.con_par[e]).contact(c, m.con_par_field[e], m.con_par_coef[e]);
  }
  if (part == Part::step && w.ahead) add_product(m, w.C, w.Bp, m.ntheta, out);
}

}  // namespace cmbrl::CMBRL_ISA
