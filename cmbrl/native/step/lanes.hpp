// Packs of lanes from the caller's arrays and back into them.
#pragma once
#include "step/rk4.hpp"

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
    T value{};
    for (int lane = 0; lane < W; ++lane) value[lane] = x[l.at[lane] * stride + i];
    out[i] = value;
    clean += 0.0 * value;
  }
}
// NaN in the lanes of `spoilt`, in all n numbers of their elements.
static void spoil(Mask spoilt, int64_t n, const Lanes& l, double* out) {
  if (!out) return;
  for (int lane = 0; lane < l.n; ++lane)
    for (int64_t i = 0; spoilt[lane] && i < n; ++i) out[l.at[lane] * n + i] = __builtin_nan("");
}
// Packs x(0) to x(n - 1) as consecutive doubles of each lane's element, from `stride` doubles an element.
template <class Read>
static void scatter_each(Read x, int64_t stride, int64_t n, const Lanes& l, double* out) {
  if (!out) return;
  int64_t i = 0;
  for (; i + W <= n; i += W) {
    T block[W];
    for (int k = 0; k < W; ++k) block[k] = x(i + k);
    transpose(block);
    for (int lane = 0; lane < l.n; ++lane) std::memcpy(out + l.at[lane] * stride + i, &block[lane], sizeof(T));
  }
  for (; i < n; ++i)
    for (int lane = 0; lane < l.n; ++lane) out[l.at[lane] * stride + i] = x(i)[lane];
}
static void scatter(const T* x, int64_t stride, int64_t n, const Lanes& l, double* out) {
  scatter_each([x](int64_t i) { return x[i]; }, stride, n, l, out);
}
// The first `before` numbers of a row, then its columns of the wanted parameters.
template <class G>
static void scatter_row(const Batch& b, const Work<G>& w, const T* row, int64_t before, int64_t stride, const Lanes& l, double* out) {
  auto read = [&](int64_t i) {
    if (i < before) return row[i];
    int column = w.column[b.wanted[i - before]];
    return column < 0 ? T{} : row[before + column];
  };
  scatter_each(read, stride, before + b.nwanted, l, out);
}
template <class G>
static void gather_parameters(const Model& m, const Batch& b, const Lanes& l, Work<G>& w, bool first) {
  if (b.theta_stride == 0 && !first) return;  // one parameter vector for the whole batch: loaded once
  const double* theta[W];
  for (int lane = 0; lane < W; ++lane) theta[lane] = b.theta ? b.theta + l.at[lane] * b.theta_stride : nullptr;
  load_parameters(m, w, b.theta ? theta : nullptr);
}

// States and controls of a pack into the workspace; returns the lanes where they are finite. The others repeat one of these:
// clamps and pruning would hide a NaN from their results.
template <class G>
static Mask gather_states(const Model& m, const Batch& b, const Lanes& l, Work<G>& w) {
  T clean = T{};
  gather(b.q, b.q_stride, m.nq, l, w.q, clean);
  gather(b.v, b.v_stride, m.nv, l, w.v, clean);
  if (b.u) gather(b.u, b.u_stride, m.nu, l, w.u, clean);
  Mask finite = clean == 0.0;
  int good = first_of(finite);
  if (good >= 0 && any(~finite)) copy_state(m, ~finite, good, w);
  return finite;
}

}  // namespace cmbrl::CMBRL_ISA
