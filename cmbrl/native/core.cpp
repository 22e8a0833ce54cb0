// The core for one instruction set (CMBRL_ISA): packs of lanes in and out of the caller's arrays. Compiled once per set.
#include "control.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G>
static int64_t bytes_of(const Model& m, Purpose purpose) {
  Arena probe{nullptr};
  Work<G>(probe, m, purpose, nullptr);
  return probe.used;
}
template <class G>
static Work<G> open(const Model& m, Purpose purpose, StepMemory& memory) {
  Arena arena{static_cast<char*>(memory.scene.reserve(bytes_of<G>(m, purpose)))};
  return Work<G>(arena, m, purpose, &memory);
}

// A packed matrix as full ones, one for each lane.
static void scatter_packed(const T* M, int nv, Pattern p, const Lanes& l, double* out) {
  for (int lane = 0; lane < l.n; ++lane) {
    double* full = out + l.at[lane] * nv * nv;
    std::memset(full, 0, sizeof(double) * nv * nv);
    for (int i = 0; i < nv; ++i) {
      Row<const T> row(M, p, i);
      full[i * nv + i] = (*row.diagonal)[lane];
      for (int a = 0; a < row.n; ++a) {
        int j = p.columns(i)[a];
        full[i * nv + j] = row.before[a][lane];
        full[j * nv + i] = row.mirror[a][lane];
      }
    }
  }
}

// clean stays 0 in a lane whose numbers are finite, and becomes NaN in any other.
static void gather(const double* x, int64_t stride, int n, const Lanes& l, T* out, T& clean) {
  for (int i = 0; i < n; ++i) {
    for (int lane = 0; lane < W; ++lane) out[i][lane] = x[l.at[lane] * stride + i];
    clean += 0.0 * out[i];
  }
}
// A lane without a clean input does the work of `good`, one that has it: clamps and pruning would hide a NaN from its result.
static void copy_lane(Mask from_good, int good, int n, T* x) {
  for (int i = 0; i < n; ++i) x[i] = select(from_good, splat(x[i][good]), x[i]);
}
static int first_of(Mask lanes) {
  for (int lane = 0; lane < W; ++lane)
    if (lanes[lane]) return lane;
  return -1;
}
// NaN in the lanes of `spoilt`, in all n numbers of their elements.
static void spoil(Mask spoilt, int64_t n, const Lanes& l, double* out) {
  if (!out) return;
  for (int lane = 0; lane < l.n; ++lane)
    for (int64_t i = 0; spoilt[lane] && i < n; ++i) out[l.at[lane] * n + i] = __builtin_nan("");
}
// Packs x as n consecutive doubles of each lane.
static void scatter(const T* x, int64_t n, const Lanes& l, double* const* out) {
  int64_t i = 0;
  for (; i + W <= n; i += W) {
    T block[W];
    for (int k = 0; k < W; ++k) block[k] = x[i + k];
    transpose(block);
    for (int lane = 0; lane < l.n; ++lane) std::memcpy(out[lane] + i, &block[lane], sizeof(T));
  }
  for (; i < n; ++i)
    for (int lane = 0; lane < l.n; ++lane) out[lane][i] = x[i][lane];
}
static void scatter(const T* x, int64_t stride, int64_t n, const Lanes& l, double* out) {
  if (!out) return;
  double* to[W];
  for (int lane = 0; lane < l.n; ++lane) to[lane] = out + l.at[lane] * stride;
  scatter(x, n, l, to);
}
template <class G>
static void gather_parameters(const Model& m, const Batch& b, const Lanes& l, Work<G>& w, bool first) {
  if (b.theta_stride == 0 && !first) return;  // one parameter vector for the whole batch: loaded once
  const double* theta[W];
  for (int lane = 0; lane < W; ++lane) theta[lane] = b.theta ? b.theta + l.at[lane] * b.theta_stride : nullptr;
  load_parameters(m, w, b.theta ? theta : nullptr);
}

// States and controls of a pack into the workspace; returns the lanes where they are finite. The others repeat one of these.
template <class G>
static Mask gather_states(const Model& m, const Batch& b, const Lanes& l, Work<G>& w) {
  T clean = T{};
  gather(b.q, b.q_stride, m.nq, l, w.q, clean);
  gather(b.v, b.v_stride, m.nv, l, w.v, clean);
  if (b.u) gather(b.u, b.u_stride, m.nu, l, w.u, clean);
  Mask finite = clean == 0.0;
  int good = first_of(finite);
  if (good < 0 || !any(~finite)) return finite;
  copy_lane(~finite, good, m.nq, w.q);
  copy_lane(~finite, good, m.nv, w.v);
  if (b.u) copy_lane(~finite, good, m.nu, w.u);
  return finite;
}

// Statuses of lanes that are to be stepped again: a solve needs the ladder, a row that was left out closes.
enum Unfinished { kUnsolved = -1, kMissed = -2 };

template <class G>
static void forward_pack(const Model& m, const Options& o, const Batch& b, const Lanes& l, Work<G>& w) {
  int nv = m.nv, ncol = 2 * nv + m.nu + (b.jacobian_theta ? m.ntheta : 0);
  int64_t stride = tape_stride<G>(m), impulses = m.ncontact * (1 + G::NT);
  Mask finite = gather_states(m, b, l, w);
  for (int lane = 0; b.impulse && lane < l.n; ++lane) std::memset(b.impulse + l.at[lane] * impulses, 0, impulses * sizeof(double));
  auto record = [&](int s) {
    if (b.impulse)
      for (int i = 0; i < w.ncon; ++i)
        for (int lane = 0; lane < l.n; ++lane) {
          const Contact<G>& c = w.con[i];
          double* x = b.impulse + l.at[lane] * impulses + c.index * (1 + G::NT);
          if (c.on[lane]) x[0] += c.gam[lane];
          for (int r = 1; r < c.rows; ++r)
            if (c.on[lane] && c.rub[lane]) x[r] += c.b[r - 1][lane];
        }
    if (!b.tape && !b.jacobian) return Recorded{all(), T{}};
    Recorded solved = solve_backward(m, o, w);
    if (!b.tape) return solved;
    double* block[W];
    for (int lane = 0; lane < W; ++lane) block[lane] = b.tape + (l.at[lane] * o.substeps + s) * stride;
    tape_write(m, w, block);
    return solved;
  };
  StepStats st{none(), none(), T{}, T{}, T{}};
  if (any(finite)) st = b.jacobian ? control_step_jacobian(m, o, w, b.jacobian_theta, ncol, record) : control_step(m, o, w, record);
  if (b.jacobian) {
    int64_t half = int64_t(nv) * ncol;
    scatter(w.tq, 2 * half, half, l, b.jacobian);
    scatter(w.tv, 2 * half, half, l, b.jacobian + half);
  }
  T clean = T{};
  for (int i = 0; i < m.nq; ++i) clean += 0.0 * w.q[i];
  for (int i = 0; i < nv; ++i) clean += 0.0 * w.v[i];
  st.done &= finite & (clean == 0.0);
  scatter(w.q, m.nq, m.nq, l, b.q_next);
  scatter(w.v, nv, nv, l, b.v_next);
  bool whole_ladder = o.rungs >= kRungs;
  for (int lane = 0; lane < l.n; ++lane) {
    int64_t i = l.at[lane];
    bool final = st.done[lane] || whole_ladder || !finite[lane];
    b.status[i] = !final ? kUnsolved : !st.done[lane] ? 2 : st.missed[lane] ? kMissed : st.rung[lane] >= kSofter ? 1 : 0;
    b.iterations[i] = int32_t(st.iterations[lane]);
    b.rung[i] = int32_t(st.rung[lane]);
    b.residual[i] = st.residual[lane];
  }
  if (!any(~finite)) return;
  auto spoil_all = [&](int64_t n, double* out) { spoil(~finite, n, l, out); };
  spoil_all(m.nq, b.q_next);
  spoil_all(nv, b.v_next);
  spoil_all(1, b.residual);
  spoil_all(2 * nv * ncol, b.jacobian);
  spoil_all(impulses, b.impulse);
  spoil_all(stride * o.substeps, b.tape);
}

// A hard solve takes the time of many easy ones, and a pack that of its slowest lane: so those that the first rung of the
// ladder does not solve are set aside, and stepped again in packs of their own, as are those that leave out a row too many.
template <class G>
static void forward_packs(const Model& m, const Options& o, const Batch& b, int64_t begin, int64_t end, StepMemory& memory) {
  Work<G> w = open<G>(m, b.jacobian ? Purpose::jacobian : Purpose::step, memory);
  Options now = o;
  now.rungs = end - begin > W ? 1 : kRungs;
  bool first = true;
  auto pack = [&](const Lanes& l) {
    if (!first && o.stopped && o.stopped()) return;
    gather_parameters(m, b, l, w, first);
    first = false;
    forward_pack(m, now, b, l, w);
  };
  for (int64_t e = begin; e < end; e += W) pack(lanes_from(e, end));
  now.rungs = kRungs;
  auto again = [&](Unfinished which) {
    Lanes l{{}, 0};
    auto run = [&] {
      for (int lane = l.n; lane < W; ++lane) l.at[lane] = l.at[l.n - 1];
      pack(l);
      l.n = 0;
    };
    for (int64_t i = begin; i < end; ++i) {
      if (b.status[i] != which) continue;
      l.at[l.n++] = i;
      if (l.n == W) run();
    }
    if (l.n > 0) run();
  };
  again(kUnsolved);
  while (now.prune < 1e300) {
    now.prune = wider(now.prune);
    again(kMissed);
  }
}

template <class G>
static void backward_packs(const Model& m, const Options& o, const Batch& b, int64_t begin, int64_t end, StepMemory& memory) {
  Work<G> w = open<G>(m, Purpose::product, memory);
  int nv = m.nv;
  int64_t stride = tape_stride<G>(m) * o.substeps;
  for (int64_t e = begin; e < end; e += W) {
    if (e > begin && o.stopped && o.stopped()) return;
    Lanes l = lanes_from(e, end);
    gather_parameters(m, b, l, w, e == begin);
    T clean = T{};
    gather(b.u, b.u_stride, m.nu, l, w.u, clean);
    gather(b.gq_next, nv, nv, l, w.lq, clean);
    gather(b.gv_next, nv, nv, l, w.lv, clean);
    for (int i = 0; i < m.nu; ++i) w.lu[i] = T{};
    for (int i = 0; i < m.ntheta; ++i) w.lp[i] = T{};
    const double* tape[W];
    for (int lane = 0; lane < W; ++lane) {
      tape[lane] = b.tape + l.at[lane] * stride;
      clean[lane] += 0.0 * tape[lane][0];  // NaN throughout after an input that was not finite
    }
    Mask finite = clean == 0.0;
    int good = first_of(finite);
    if (good >= 0) {
      if (any(~finite)) {
        for (int lane = 0; lane < W; ++lane) tape[lane] = tape[finite[lane] ? lane : good];
        copy_lane(~finite, good, m.nu, w.u);
      }
      control_step_backward(m, o, w, tape, b.gtheta != nullptr);
    }
    scatter(w.lq, nv, nv, l, b.gq);
    scatter(w.lv, nv, nv, l, b.gv);
    scatter(w.lu, m.nu, m.nu, l, b.gu);
    scatter(w.lp, m.ntheta, m.ntheta, l, b.gtheta);
    spoil(~finite, nv, l, b.gq);
    spoil(~finite, nv, l, b.gv);
    spoil(~finite, m.nu, l, b.gu);
    spoil(~finite, m.ntheta, l, b.gtheta);
  }
}

// A step of all lanes, with more rows where one that was left out closes.
template <class G>
static StepStats loss_step(const Model& m, const Options& o, Work<G>& w) {
  for (int i = 0; i < m.nq; ++i) w.start[i] = w.q[i];
  for (int i = 0; i < m.nv; ++i) w.start[m.nq + i] = w.v[i];
  Options now = o;
  for (;;) {
    StepStats st = control_step(m, now, w, [](int) { return Recorded{all(), T{}}; });
    if (!any(st.missed)) return st;
    now.prune = wider(now.prune);
    for (int i = 0; i < m.nq; ++i) w.q[i] = w.start[i];
    for (int i = 0; i < m.nv; ++i) w.v[i] = w.start[m.nq + i];
  }
}

// Open-loop Huber loss of one pack of candidates over all starts: lanes share the state, so they share the active set.
template <class G>
static void candidate_loss(const Model& m, const Options& o, const LossBatch& b, int64_t first, StepMemory& memory) {
  Work<G> w = open<G>(m, Purpose::step, memory);
  Lanes l = lanes_from(first, b.ncandidate);
  const double* theta[W];
  for (int lane = 0; lane < W; ++lane) theta[lane] = b.theta + l.at[lane] * m.ntheta;
  load_parameters(m, w, theta);
  auto huber = [&](T r) {
    T a = vabs(r);
    return select(a < b.huber, 0.5 * r * r, b.huber * (a - 0.5 * b.huber));
  };
  for (int64_t s = 0; s < b.nstart; ++s) {
    int64_t row = b.starts[s];
    T loss = T{};
    double clean = 0;  // NaN from an input that is not finite, and then so is the loss
    auto spread = [&](const double* x, int n, T* out) {
      for (int i = 0; i < n; ++i) { out[i] = splat(x[i]); clean += 0.0 * x[i]; }
    };
    spread(b.q + row * m.nq, m.nq, w.q);
    spread(b.v + row * m.nv, m.nv, w.v);
    for (int k = 0; k < b.horizon; ++k, ++row) {
      if (o.stopped && o.stopped()) return;
      spread(b.u + row * m.nu, m.nu, w.u);
      StepStats st = loss_step(m, o, w);
      const double *qn = b.q_next + row * m.nq, *vn = b.v_next + row * m.nv;
      for (int j = 0; j < m.njoint; ++j) {
        int a = m.jnt_qadr[j], d = m.jnt_vadr[j];
        if (m.jnt_type[j] != kBall) { loss += huber((w.q[a] - qn[a]) / b.scale_q[d]); continue; }
        T inverse[4] = {splat(qn[a]), splat(-qn[a + 1]), splat(-qn[a + 2]), splat(-qn[a + 3])}, e[4];
        quat_mul(inverse, w.q + a, e);  // rotation error as twice the vector part (small angles)
        CMBRL_FOR(r, 3) loss += huber(2.0 * select(e[0] < 0.0, -e[1 + r], e[1 + r]) / b.scale_q[d + r]);
      }
      for (int i = 0; i < m.nv; ++i) loss += huber((w.v[i] - vn[i]) / b.scale_v[i]);
      loss += clean;
      loss = select(st.done & (loss < 1e15), loss, loss + b.fail_penalty);
      loss = select(loss < 1e15, loss, splat(1e15));
    }
    for (int lane = 0; lane < l.n; ++lane) b.loss[l.at[lane] * b.loss_stride + s] = loss[lane];
  }
}

// M (n, nv, nv) with armature, bias (n, nv), gaps (n, ncontact), normal and tangent rows J (n, ncontact, 1 + NT, nv).
template <class G>
static void smooth_quantities(const Model& m, const Options& o, const Batch& b, double* M, double* bias, double* gap, double* J,
                              int64_t begin, int64_t end, StepMemory& memory) {
  Work<G> w = open<G>(m, Purpose::step, memory);
  int nv = m.nv, rows = 1 + G::NT;
  Options every = o;
  every.prune = __builtin_inf();
  for (int64_t e = begin; e < end; e += W) {
    Lanes l = lanes_from(e, end);
    gather_parameters(m, b, l, w, e == begin);
    Mask finite = gather_states(m, b, l, w);
    kinematics(m, w, w.q);
    inertias(m, w);
    inverse_dynamics<G>(m, w, w.v, nullptr, w.bias);
    mass_matrix(m, w);
    for (int i = 0; i < nv; ++i) w.M[m.tree().row(i)] += w.P[m.oDof + i * kDofFields + kArmature];
    find_contacts(m, every, w, nullptr);
    scatter_packed(w.M, nv, m.tree(), l, M);
    scatter(w.bias, nv, nv, l, bias);
    for (int i = 0; i < w.ncon; ++i) {
      const Contact<G>& c = w.con[i];
      for (int lane = 0; lane < l.n; ++lane) gap[l.at[lane] * m.ncontact + c.index] = c.phi[lane];
      int g = m.con_group[c.index];
      for (int r = 0; r < c.rows; ++r)
        for (int k = m.grp_dptr[g]; k < m.grp_dptr[g + 1]; ++k) {
          T x = dot(w.S[m.grp_dof[k]], c.Wr[r]);
          for (int lane = 0; lane < l.n; ++lane)
            J[((l.at[lane] * m.ncontact + c.index) * rows + r) * nv + m.grp_dof[k]] = m.grp_sign[k] > 0 ? x[lane] : -x[lane];
        }
    }
    spoil(~finite, nv * nv, l, M);
    spoil(~finite, nv, l, bias);
    spoil(~finite, m.ncontact, l, gap);
  }
}

// Rows of a step as its solve has them in the end, with those that were left out too soon. Dry friction has no row here: it
// acts in vf with the impulses it has in that solution.
template <class G>
static void rows_of_step(const Model& m, const Options& o, Work<G>& w) {
  Options now = o;
  auto set_up = [&] {
    prepare(m, now, w);
    free_velocity(m, now, w);
    find_bounces(m, now, w);
  };
  for (;;) {
    set_up();
    solve_smoothed(m, now, w, o.forward, false);
    if (!any(missed_rows(m, now, w))) break;
    now.prune = wider(now.prune);
  }
  for (int i = 0; i < m.nv; ++i) w.shift[i] = T{};
  for (int i = 0; i < w.ndry; ++i) w.shift[w.dry[i].dof] = keep(w.dry[i].on, w.dry[i].b);
  set_up();  // the solve may have changed the rows; leaves the factor of M~ in H
  if (w.ndry == 0) return;
  solve(w.H, m.nv, pattern_of(m, w), w.shift);
  for (int i = 0; i < m.nv; ++i) w.vf[i] += w.shift[i];
}

// The rows of the first physics step of a control step. The arrays come in as zeros.
template <class G>
static void step_rows(const Model& m, const Options& o, const Batch& b, const RowBatch& out, int64_t begin, int64_t end, StepMemory& memory) {
  Work<G> w = open<G>(m, Purpose::step, memory);
  int nv = m.nv, rows = 1 + G::NT, nrow = m.ncontact + m.nlimit;
  for (int64_t e = begin; e < end; e += W) {
    Lanes l = lanes_from(e, end);
    gather_parameters(m, b, l, w, e == begin);
    Mask finite = gather_states(m, b, l, w);
    if (o.leapfrog) { scaled(m, w.v, 0.5 * o.h, w.qtan); integrate(m, w.q, w.qtan); }
    rows_of_step(m, o, w);
    scatter_packed(w.M, nv, m.tree(), l, out.M);
    scatter(w.vf, nv, nv, l, out.v_free);
    spoil(~finite, nv * nv, l, out.M);
    spoil(~finite, nv, l, out.v_free);
    for (int lane = 0; lane < l.n; ++lane) {
      int64_t base = l.at[lane] * nrow;
      for (int g = 0; g < w.ngroups; ++g)
        for (int i = w.groups[g].begin; i < w.groups[g].end; ++i) {
          const Contact<G>& c = w.con[i];
          if (!c.on[lane]) continue;
          int64_t at = base + c.index;
          out.active[at] = 1;
          out.mu[at] = c.rub[lane] ? c.mu[lane] : 0;
          for (int r = 0; r < (c.rub[lane] ? c.rows : 1); ++r) {
            out.b[at * rows + r] = (r ? c.ct0[r - 1] : c.cn0)[lane];
            out.R[at * rows + r] = (r ? c.Rt : c.Rn)[lane];
            for (int k = m.grp_dptr[w.groups[g].group]; k < m.grp_dptr[w.groups[g].group + 1]; ++k)
              out.J[(at * rows + r) * nv + m.grp_dof[k]] = m.grp_sign[k] * dot(w.S[m.grp_dof[k]], c.Wr[r])[lane];
          }
        }
      for (int i = 0; i < w.nlim; ++i) {
        const Limit& c = w.lim[i];
        if (!c.on[lane]) continue;
        int64_t at = base + m.ncontact + c.index;
        out.active[at] = 1;
        out.b[at * rows] = c.c0[lane];
        out.R[at * rows] = c.R[lane];
        out.J[at * rows * nv + c.dof] = c.sign[lane];
      }
    }
  }
}

#define CMBRL_EITHER(call) (m.planar ? call(Planar) : call(Spatial))
extern const Backend backend;
const Backend backend = {
#define CMBRL_STR2(x) #x
#define CMBRL_STR(x) CMBRL_STR2(x)
    CMBRL_STR(CMBRL_ISA), W,
    [](const Model& m, Purpose p) { return m.planar ? bytes_of<Planar>(m, p) : bytes_of<Spatial>(m, p); },
    [](const Model& m, const Options& o) { return (m.planar ? tape_stride<Planar>(m) : tape_stride<Spatial>(m)) * o.substeps; },
    [](const Model& m, const Options& o, const Batch& b, int64_t s, int64_t e, StepMemory& w) {
      m.planar ? forward_packs<Planar>(m, o, b, s, e, w) : forward_packs<Spatial>(m, o, b, s, e, w);
    },
    [](const Model& m, const Options& o, const Batch& b, int64_t s, int64_t e, StepMemory& w) {
      m.planar ? backward_packs<Planar>(m, o, b, s, e, w) : backward_packs<Spatial>(m, o, b, s, e, w);
    },
    [](const Model& m, const Options& o, const LossBatch& b, int64_t first, StepMemory& w) {
      m.planar ? candidate_loss<Planar>(m, o, b, first, w) : candidate_loss<Spatial>(m, o, b, first, w);
    },
    [](const Model& m, const Options& o, const Batch& b, double* M, double* bias, double* gap, double* J, int64_t s, int64_t e, StepMemory& w) {
      m.planar ? smooth_quantities<Planar>(m, o, b, M, bias, gap, J, s, e, w)
               : smooth_quantities<Spatial>(m, o, b, M, bias, gap, J, s, e, w);
    },
    [](const Model& m, const Options& o, const Batch& b, const RowBatch& out, int64_t s, int64_t e, StepMemory& w) {
      m.planar ? step_rows<Planar>(m, o, b, out, s, e, w) : step_rows<Spatial>(m, o, b, out, s, e, w);
    },
};

}  // namespace cmbrl::CMBRL_ISA
