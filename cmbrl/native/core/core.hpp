// The batched step of one scene, its derivatives, what it predicts of logs, and what it is made of, for Python.
#pragma once
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <memory>
#include <tuple>

#include "base/arrays.hpp"
#include "base/engine.hpp"
#include "base/memory.hpp"
#include "base/per_process.hpp"
#include "instruction_sets.hpp"
#include "scene/options.hpp"
#include "scene/scene_data.hpp"
#include "step/tape_rows.hpp"

namespace cmbrl {

// What a backward pass needs of a batch of steps.
struct Tape {
  int64_t n, size;  // elements, and doubles of each, without the rows
  void* block;
  TapeRows rows;

  Tape(int64_t n_, int64_t size_)
      : n(n_), size(size_), block(Buffers::take(bytes_of_array<double>({size_t(n_), size_t(size_)}))), rows(n_ * size_ / 4) {}
  ~Tape() { Buffers::give_back(block, n * size * sizeof(double)); }
  Tape(const Tape&) = delete;
  size_t bytes() const { return n * size * sizeof(double) + rows.bytes(); }
  void use(Batch& b) {
    b.tape = static_cast<double*>(block);
    b.tape_rows = &rows;
  }
};

class Core {
 public:
  // limits: (name, low, high) of each parameter, which a step checks; none: no check
  Core(nb::dict scene, const std::vector<std::tuple<std::string, double, double>>& limits, const std::string& isa)
      : backend_(find_isa(isa).steps), few_(isa.empty() ? find_isa(isa).few_steps : backend_) {
    std::map<std::string, std::vector<int>> ints;
    std::map<std::string, std::vector<double>> doubles;
    std::map<std::string, int> sizes;
    for (auto [key, value] : scene) {
      std::string name = nb::cast<std::string>(key);
      nb::ndarray<const int32_t, nb::c_contig, nb::device::cpu> a;
      Array b;
      if (nb::try_cast(value, a, false)) ints[name].assign(a.data(), a.data() + a.size());
      else if (nb::try_cast(value, b, false)) doubles[name].assign(b.data(), b.data() + b.size());
      else if (int size; nb::try_cast(value, size)) sizes[name] = size;
    }
    data_ = std::make_unique<SceneData>(std::move(ints), std::move(doubles), sizes);
    for (const auto& [name, low, high] : limits) {
      names_.push_back(name);
      low_.push_back(low);
      high_.push_back(high);
    }
    if (!limits.empty() && int(limits.size()) != data_->model.ntheta) refuse("give one (name, low, high) for each parameter");
  }

  // steps.cpp
  nb::dict forward(Array q, Array v, Array u, std::optional<Array> theta, nb::dict options, bool jacobian,
                   std::optional<Index> columns, bool tape, bool impulse, int threads);
  nb::dict backward(Array u, std::optional<Array> theta, Tape& tape, Array gq_next, Array gv_next, nb::dict options, bool want_theta, int threads);
  // windows.cpp
  // q, v: the states that windows start from, common to all candidates or each candidate's own.
  nb::object loss(Array q, Array v, Array u, Array q_next, Array v_next, Index starts, int horizon, Array theta, Array scale_q,
                  Array scale_v, double huber, double fail_penalty, nb::dict options, int threads);
  // Predictions from q, v (S, ...) under the rows of u from `starts` on, and their tangents: of those `begun` (2 nv, c), of which the last
  // columns move controls by `driven` (N, nu, d), and of the parameters `columns` that are not idle throughout, `told`; those `rows` (r,)
  // of them that are asked for, in `units` (1 or S, r).
  nb::dict windows(Array q, Array v, Array u, Index starts, int horizon, Array theta, Index columns, Array begun, Array driven,
                   Index rows, Array units, nb::dict options, int threads);
  // quantities.cpp
  nb::dict dynamics(Array q, Array v, std::optional<Array> theta, nb::dict options, bool contacts);
  // Of all candidates, at the nominal parameters.
  nb::object gaps(Array q);
  // What parameters (np,) make of each inverse weight, by the file's.
  nb::object weights(Array theta);
  nb::dict rows(Array q, Array v, Array u, std::optional<Array> theta, nb::dict options);
  nb::object bodies(Array q, Array v, Index chosen, int threads);
  nb::tuple bodies_backward(Array q, Array v, Index chosen, Array cotangent, int threads);
  std::string isa() const { return backend_.name; }
  int width() const { return backend_.width; }

 private:
  const Backend &backend_, &few_;  // few_: for no more elements than it is wide
  std::unique_ptr<SceneData> data_;
  std::vector<std::string> names_;
  std::vector<double> low_, high_;
  PerProcess<Engine> engine_;

  // Where there are few candidates, letting all of them in costs little.
  Options settings(nb::dict options) const {
    constexpr int few = 256;
    Options o = options_from(options);
    o.admit = data_->model.ncontact > few;
    return o;
  }
  size_t body_fields() const { return data_->model.planar ? 7 : 18; }
  std::vector<int32_t> checked_bodies(const Index& chosen) const {
    std::vector<int32_t> bodies;
    for (size_t i = 0; i < chosen.size(); ++i) {
      int64_t body = chosen.data()[i];
      if (body < 0 || body >= data_->model.nbody) refuse("body " + std::to_string(body) + " of " + std::to_string(data_->model.nbody));
      bodies.push_back(int32_t(body));
    }
    return bodies;
  }

  // As many states as v has rows, with controls and parameters where there are some.
  Batch states(const Array& q, const Array& v, const Array* u, const std::optional<Array>& theta) const {
    const Model& m = data_->model;
    Batch b{};
    b.n = int64_t(v.ndim() ? v.shape(0) : 0);
    check(q, "q", {b.n, m.nq}); check(v, "v", {b.n, m.nv});
    b.q = q.data(); b.v = v.data();
    b.q_stride = m.nq; b.v_stride = m.nv;
    if (u) {
      check(*u, "u", {b.n, m.nu});
      b.u = u->data();
      b.u_stride = m.nu;
    }
    set_theta(b, theta);
    return b;
  }
  void want(Batch& b, const int64_t* columns, int64_t count) const {
    std::vector<bool> seen(data_->model.ntheta);
    for (int64_t i = 0; i < count; ++i) {
      int64_t k = columns[i];
      if (k < 0 || k >= int64_t(seen.size()) || seen[k])
        refuse("column " + std::to_string(k) + " of " + std::to_string(seen.size()) + " parameters; give each number once, from 0");
      seen[k] = true;
    }
    b.wanted = columns;
    b.nwanted = count;
  }
  void set_theta(Batch& b, const std::optional<Array>& theta) const {
    if (!theta) return;
    int64_t nt = data_->model.ntheta;
    b.theta = theta->data();
    if (theta->ndim() == 2) { check(*theta, "theta", {b.n, nt}); b.theta_stride = nt; }
    else check(*theta, "theta", {nt});
    check_limits(b.theta, theta->ndim() == 2 ? b.n : 1);
  }
  void check_limits(const double* theta, int64_t rows) const {
    size_t nt = low_.size();
    for (const double *row = theta, *end = theta + rows * int64_t(nt); row < end; row += nt) {
      int outside = 0;
      for (size_t k = 0; k < nt; ++k) outside |= int(!(row[k] >= low_[k])) | int(!(row[k] <= high_[k]));  // NaN is outside
      if (!outside) continue;
      size_t k = 0;
      while (row[k] >= low_[k] && row[k] <= high_[k]) ++k;
      refuse("parameter " + names_[k] + " = " + text(row[k]) + (rows > 1 ? " in row " + std::to_string((row - theta) / int64_t(nt)) : "") +
             "; a step takes [" + text(low_[k]) + ", " + text(high_[k]) + "]");
    }
  }
  static std::string text(double x) {
    char digits[32];
    std::snprintf(digits, sizeof digits, "%g", x);
    return digits;
  }
  // job(backend, begin, end, memory) for chunks of n elements; per_chunk: so many, whatever they are.
  template <class F>
  void run(int64_t n, int threads, Purpose purpose, F job, int64_t per_chunk = 0) {
    const Backend& backend = n <= few_.width && !per_chunk ? few_ : backend_;
    int64_t width = backend.width, share = n / (4 * std::max(threads, 1));  // some chunks a thread, of whole packs
    int64_t chunk = per_chunk ? per_chunk : threads <= 1 ? std::max<int64_t>(n, 1) : std::clamp((share + width - 1) / width, int64_t(1), int64_t(8)) * width;
    int64_t chunks = (n + chunk - 1) / chunk;
    engine_.get().run(chunks, threads, backend.workspace_size(data_->model, purpose),
                      [&](int64_t c, int, StepMemory& memory) { job(backend, c * chunk, std::min(n, (c + 1) * chunk), memory); });
  }
};

}  // namespace cmbrl
