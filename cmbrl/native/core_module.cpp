// cmbrl.native.Core: the batched step of one scene, its derivatives, losses of candidates, and what it is made of.
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <memory>
#include <numeric>
#include <tuple>

#include "base/arrays.hpp"
#include "step/attempts.hpp"
#include "base/engine.hpp"
#include "instruction_sets.hpp"
#include "base/memory.hpp"
#include "scene/options.hpp"
#include "base/per_process.hpp"
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

  nb::dict forward(Array q, Array v, Array u, std::optional<Array> theta, nb::dict options, bool jacobian,
                   std::optional<Index> columns, bool tape, bool impulse, int threads) {
    const Model& m = data_->model;
    Options o = settings(options);
    Batch b = states(q, v, &u, theta);
    nb::dict out;
    size_t n = b.n;
    out["q_next"] = make_array<double>({n, size_t(m.nq)}, &b.q_next);
    out["v_next"] = make_array<double>({n, size_t(m.nv)}, &b.v_next);
    out["status"] = make_array<int32_t>({n}, &b.status);
    out["iterations"] = make_array<int32_t>({n}, &b.iterations);
    out["rung"] = make_array<int32_t>({n}, &b.rung);
    out["residual"] = make_array<double>({n}, &b.residual);
    if (columns) want(b, columns->data(), int64_t(columns->size()));
    size_t ncol = 2 * m.nv + m.nu + size_t(b.nwanted);
    if (jacobian) out["jacobian"] = make_array<double>({n, size_t(2 * m.nv), ncol}, &b.jacobian);
    if (tape) {
      auto* made = new Tape(b.n, backend_.tape_size(m, o));
      made->use(b);
      out["tape"] = nb::cast(made, nb::rv_policy::take_ownership);
    }
    if (impulse) {
      size_t rows = m.planar ? 2 : 3;
      out["impulse"] = make_array<double>({n, size_t(m.ncontact), rows}, &b.impulse);
    }
    auto survey = [&] {
      if (o.admit) run(b.n, threads, Purpose::step, [&](const Backend& backend, int64_t s, int64_t e, StepMemory& w) { backend.survey(m, o, b, s, e, w); });
      return o.admit != 0;
    };
    step_in_attempts(o, b, backend_.width, survey, [&](const Options& now, const Elements* some) {
      run(some ? int64_t(some->size()) : b.n, threads, jacobian ? Purpose::jacobian : Purpose::step,
          [&](const Backend& backend, int64_t s, int64_t e, StepMemory& w) { backend.forward(m, now, b, some ? some->data() : nullptr, s, e, w); });
    });
    return out;
  }

  nb::dict backward(Array u, std::optional<Array> theta, Tape& tape, Array gq_next, Array gv_next, nb::dict options, bool want_theta, int threads) {
    const Model& m = data_->model;
    Options o = settings(options);
    Batch b{};
    b.n = int64_t(gv_next.ndim() ? gv_next.shape(0) : 0);
    check(u, "u", {b.n, m.nu});
    if (tape.n != b.n || tape.size != backend_.tape_size(m, o))
      refuse("the tape is of " + std::to_string(tape.n) + " other steps; give that of the forward pass over these " + std::to_string(b.n));
    check(gq_next, "gq_next", {b.n, m.nv}); check(gv_next, "gv_next", {b.n, m.nv});
    b.u = u.data(); b.u_stride = m.nu;
    tape.use(b);
    b.gq_next = gq_next.data(); b.gv_next = gv_next.data();
    set_theta(b, theta);
    nb::dict out;
    size_t n = b.n;
    out["gq"] = make_array<double>({n, size_t(m.nv)}, &b.gq);
    out["gv"] = make_array<double>({n, size_t(m.nv)}, &b.gv);
    out["gu"] = make_array<double>({n, size_t(m.nu)}, &b.gu);
    std::vector<int64_t> every(want_theta ? m.ntheta : 0);
    std::iota(every.begin(), every.end(), 0);
    want(b, every.data(), int64_t(every.size()));
    if (want_theta) out["gtheta"] = make_array<double>({n, every.size()}, &b.gtheta);
    Elements order = most_contacts_first(b.tape, b.n, o.solves(), tape.size / o.solves());
    run(b.n, threads, Purpose::product,
        [&](const Backend& backend, int64_t s, int64_t e, StepMemory& w) { backend.backward(m, o, b, order.data(), s, e, w); });
    return out;
  }

  // q, v: the states that windows start from, common to all candidates or each candidate's own.
  nb::object loss(Array q, Array v, Array u, Array q_next, Array v_next, Index starts, int horizon, Array theta, Array scale_q,
                  Array scale_v, double huber, double fail_penalty, nb::dict options, int threads) {
    const Model& m = data_->model;
    Options o = settings(options);
    int64_t rows = int64_t(v_next.ndim() ? v_next.shape(0) : 0), count = int64_t(starts.size());
    check(u, "u", {rows, m.nu}); check(q_next, "q_next", {rows, m.nq}); check(v_next, "v_next", {rows, m.nv});
    check(theta, "theta", {-1, m.ntheta}); check_limits(theta.data(), theta.shape(0)); check(scale_q, "scale_q", {m.nv}); check(scale_v, "scale_v", {m.nv});
    int64_t candidates = int64_t(theta.shape(0));
    bool own = q.ndim() == 3;
    if (own) { check(q, "q", {candidates, count, m.nq}); check(v, "v", {candidates, count, m.nv}); }
    else { check(q, "q", {count, m.nq}); check(v, "v", {count, m.nv}); }
    check_windows(starts, horizon, rows);
    LossBatch b{candidates, count, horizon, q.data(), v.data(), own ? count : 0, u.data(), q_next.data(), v_next.data(),
                theta.data(), scale_q.data(), scale_v.data(), starts.data(), huber, fail_penalty, nullptr};
    auto out = make_array<double>({size_t(candidates), size_t(count)}, &b.loss);
    int64_t width = backend_.width, packs = (candidates + width - 1) / width, slices = (count + 255) / 256;
    run(packs * slices, threads, Purpose::step, [&](const Backend&, int64_t k, int64_t, StepMemory& w) {
      int64_t begin = k % slices * 256;
      backend_.loss(m, o, b, k / slices * width, begin, std::min<int64_t>(count, begin + 256), w);
    }, 1);
    return nb::cast(out);
  }

  // Predictions from q, v (S, ...) under the rows of u from `starts` on, and their tangents: of those `begun` (2 nv, c), of which the last
  // columns move controls by `driven` (N, nu, d), and of the parameters `columns` that are not idle throughout, `told`; those `rows` (r,)
  // of them that are asked for, in `units` (1 or S, r).
  nb::dict windows(Array q, Array v, Array u, Index starts, int horizon, Array theta, Index columns, Array begun, Array driven,
                   Index rows, Array units, nb::dict options, int threads) {
    const Model& m = data_->model;
    Options o = settings(options);
    int64_t count = int64_t(starts.size()), log = int64_t(u.ndim() ? u.shape(0) : 0);
    check(q, "q", {count, m.nq}); check(v, "v", {count, m.nv}); check(u, "u", {log, m.nu}); check(theta, "theta", {m.ntheta});
    check(begun, "begun", {2 * m.nv, -1}); check(driven, "driven", {log, m.nu, -1});
    check_windows(starts, horizon, log);
    check_limits(theta.data(), 1);
    check(units, "units", {units.ndim() == 2 && units.shape(0) == 1 ? 1 : count, int64_t(rows.size())});
    if (driven.shape(2) > begun.shape(1)) refuse("more columns move controls than there are; give a tangent for each");
    for (size_t i = 0; i < rows.size(); ++i)
      if (rows.data()[i] < 0 || rows.data()[i] >= 2 * m.nv) refuse("row " + std::to_string(rows.data()[i]) + " of " + std::to_string(2 * m.nv));
    Batch wanted{};
    want(wanted, columns.data(), int64_t(columns.size()));
    WindowBatch b{count, horizon, q.data(), v.data(), u.data(), theta.data(), starts.data(), wanted.wanted, int64_t(begun.shape(1)),
                  int64_t(driven.shape(2)), wanted.nwanted, int64_t(rows.size()), begun.data(), driven.data(), rows.data(),
                  nullptr, nullptr, nullptr, nullptr};
    size_t n = count, steps = horizon, all = size_t(b.nbefore + b.nwanted);
    nb::dict out;
    out["q_next"] = make_array<double>({n, steps, size_t(m.nq)}, &b.q_next);
    out["v_next"] = make_array<double>({n, steps, size_t(m.nv)}, &b.v_next);
    std::vector<uint8_t> told(n * b.nwanted);
    b.told = told.data();
    nb::capsule owner = take_block(bytes_of_array<double>({n, all, steps, size_t(b.nrow)}), &b.tangents);
    run(count, threads, Purpose::product, [&](const Backend& backend, int64_t s, int64_t e, StepMemory& w) { backend.windows(m, o, b, s, e, w); });
    std::vector<int64_t> columns_told = told_columns(b);
    keep_told(b, columns_told, units);
    out["told"] = copied(columns_told);
    out["tangents"] = nb::ndarray<nb::numpy, double>(b.tangents, {n, b.nbefore + columns_told.size(), steps, size_t(b.nrow)}, owner);
    return out;
  }

  nb::dict dynamics(Array q, Array v, std::optional<Array> theta, nb::dict options, bool contacts) {
    const Model& m = data_->model;
    Options o = settings(options);
    Batch b = states(q, v, nullptr, theta);
    nb::dict out;
    size_t n = b.n, nv = m.nv, rows = m.planar ? 2 : 3;
    double *M, *bias, *length, *gap = nullptr, *J = nullptr;
    out["M"] = make_array<double>({n, nv, nv}, &M);
    out["bias"] = make_array<double>({n, nv}, &bias);
    out["length"] = make_array<double>({n, size_t(m.nline)}, &length);
    if (contacts) {
      out["gap"] = make_array<double>({n, size_t(m.ncontact)}, &gap);
      out["J"] = make_array<double>({n, size_t(m.ncontact), rows, nv}, &J);
      std::memset(J, 0, n * m.ncontact * rows * nv * sizeof(double));
    }
    run(b.n, 1, Purpose::step, [&](const Backend& backend, int64_t s, int64_t e, StepMemory& w) { backend.dynamics(m, o, b, M, bias, length, gap, J, s, e, w); });
    return out;
  }

  // Of all candidates, at the nominal parameters.
  nb::object gaps(Array q) {
    const Model& m = data_->model;
    int64_t n = int64_t(q.ndim() ? q.shape(0) : 0);
    check(q, "q", {n, m.nq});
    std::vector<double> still(m.nv);
    Batch b{};
    b.n = n; b.q = q.data(); b.q_stride = m.nq; b.v = still.data();
    Options o{};
    o.h = 1;
    double* gap;
    auto out = make_array<double>({size_t(n), size_t(m.ncontact)}, &gap);
    run(n, 1, Purpose::step,
        [&](const Backend& backend, int64_t s, int64_t e, StepMemory& w) { backend.dynamics(m, o, b, nullptr, nullptr, nullptr, gap, nullptr, s, e, w); });
    return nb::cast(out);
  }

  nb::dict rows(Array q, Array v, Array u, std::optional<Array> theta, nb::dict options) {
    const Model& m = data_->model;
    Options o = settings(options);
    Batch b = states(q, v, &u, theta);
    RowBatch r{};
    r.rows_a_contact = 1;
    r.rows = m.planar ? 2 : 3;
    for (int i = 0; i < m.ncontact; ++i) {
      if (o.convex && m.con_pyramid[i]) r.rows_a_contact = std::max(r.rows_a_contact, 1 + m.con_pyramid[i]);
      else r.rows = std::max(r.rows, rows_of_contact(m.planar, m.con_dim[i]));
    }
    size_t n = b.n, nv = m.nv, nrow = m.ncontact * r.rows_a_contact + m.nlimit, rows = r.rows;
    nb::dict out;
    out["M"] = make_array<double>({n, nv, nv}, &r.M);
    out["v_free"] = make_array<double>({n, nv}, &r.v_free);
    out["J"] = make_array<double>({n, nrow, rows, nv}, &r.J);
    out["b"] = make_array<double>({n, nrow, rows}, &r.b);
    out["mu"] = make_array<double>({n, nrow}, &r.mu);
    out["R"] = make_array<double>({n, nrow, rows}, &r.R);
    out["active"] = make_array<int32_t>({n, nrow}, &r.active);
    out["convex"] = make_array<int32_t>({n, nrow}, &r.convex);
    for (auto [block, size] : {std::pair{r.J, rows * nv}, {r.b, rows}, {r.mu, size_t(1)}, {r.R, rows}})
      std::memset(block, 0, n * nrow * size * sizeof(double));
    for (int32_t* flags : {r.active, r.convex}) std::memset(flags, 0, n * nrow * sizeof(int32_t));
    run(b.n, 1, Purpose::step, [&](const Backend& backend, int64_t s, int64_t e, StepMemory& w) { backend.rows(m, o, b, r, s, e, w); });
    return out;
  }

  nb::object bodies(Array q, Array v, Index chosen, int threads) {
    const Model& m = data_->model;
    Batch b = states(q, v, nullptr, std::nullopt);
    std::vector<int32_t> bodies = checked_bodies(chosen);
    BodyBatch out{int(bodies.size()), bodies.data(), nullptr, nullptr};
    auto motion = make_array<double>({size_t(b.n), bodies.size(), body_fields()}, &out.motion);
    run(b.n, threads, Purpose::step, [&](const Backend& backend, int64_t s, int64_t e, StepMemory& w) { backend.bodies(m, b, out, s, e, w); });
    return nb::cast(motion);
  }

  nb::tuple bodies_backward(Array q, Array v, Index chosen, Array cotangent, int threads) {
    const Model& m = data_->model;
    Batch b = states(q, v, nullptr, std::nullopt);
    std::vector<int32_t> bodies = checked_bodies(chosen);
    check(cotangent, "cotangent", {b.n, int64_t(bodies.size()), int64_t(body_fields())});
    BodyBatch out{int(bodies.size()), bodies.data(), nullptr, cotangent.data()};
    auto gq = make_array<double>({size_t(b.n), size_t(m.nv)}, &b.gq), gv = make_array<double>({size_t(b.n), size_t(m.nv)}, &b.gv);
    run(b.n, threads, Purpose::step, [&](const Backend& backend, int64_t s, int64_t e, StepMemory& w) { backend.bodies_backward(m, b, out, s, e, w); });
    return nb::make_tuple(gq, gv);
  }

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

  static std::vector<int64_t> told_columns(const WindowBatch& b) {  // in some window
    std::vector<int64_t> told;
    for (int64_t k = 0; k < b.nwanted; ++k)
      for (int64_t s = 0; s < b.nstart; ++s)
        if (b.told[s * b.nwanted + k]) { told.push_back(k); break; }
    return told;
  }
  // Moves them together, each to a place before its own, in units of their rows.
  static void keep_told(const WindowBatch& b, const std::vector<int64_t>& told, const Array& units) {
    int64_t size = b.horizon * b.nrow;
    double* to = b.tangents;
    std::vector<double> scale(b.nrow);
    for (int64_t s = 0; s < b.nstart; ++s) {
      const double* unit = units.data() + (units.shape(0) == 1 ? 0 : s * b.nrow);
      for (int64_t r = 0; r < b.nrow; ++r) scale[r] = 1 / unit[r];
      for (int64_t c = 0; c < b.nbefore + int64_t(told.size()); ++c, to += size) {
        int64_t k = c < b.nbefore ? -1 : told[c - b.nbefore];
        const double* from = b.tangents + (s * (b.nbefore + b.nwanted) + (k < 0 ? c : b.nbefore + k)) * size;
        if (k >= 0 && !b.told[s * b.nwanted + k]) std::memset(to, 0, size * sizeof(double));
        else
          for (int64_t i = 0; i < size; i += b.nrow)
            for (int64_t r = 0; r < b.nrow; ++r) to[i + r] = scale[r] * from[i + r];
      }
    }
  }
  static nb::object copied(const std::vector<int64_t>& numbers) {
    int64_t* data;
    auto out = make_array<int64_t>({numbers.size()}, &data);
    std::copy(numbers.begin(), numbers.end(), data);
    return nb::cast(out);
  }
  static void check_windows(const Index& starts, int horizon, int64_t rows) {
    if (horizon < 1) refuse("horizon is " + std::to_string(horizon) + "; give at least 1");
    for (size_t i = 0; i < starts.size(); ++i)
      if (int64_t start = starts.data()[i]; start < 0 || start > rows - horizon)
        refuse("start " + std::to_string(start) + " with a horizon of " + std::to_string(horizon) + " leaves the log of " +
               std::to_string(rows) + " rows");
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

void bind_core(nb::module_& module) {
  using namespace nb::literals;
  nb::class_<Tape>(module, "Tape", "What a backward pass needs of the steps of a forward pass.")
      .def_prop_ro("nbytes", &Tape::bytes, "Memory that it takes.");
  nb::class_<Core>(module, "Core", "Batched complementarity step of one scene; see cmbrl.models.ComplementarityModel.")
      .def(nb::init<nb::dict, const std::vector<std::tuple<std::string, double, double>>&, const std::string&>(), "scene"_a,
           "limits"_a = nb::list(), "isa"_a = "")
      .def("forward", &Core::forward, "q"_a, "v"_a, "u"_a, "theta"_a.none(), "options"_a, "jacobian"_a = false,
           "columns"_a.none() = nb::none(), "tape"_a = false, "impulse"_a = false, "threads"_a = 1)
      .def("backward", &Core::backward, "u"_a, "theta"_a.none(), "tape"_a, "gq_next"_a, "gv_next"_a, "options"_a,
           "want_theta"_a = false, "threads"_a = 1)
      .def("loss", &Core::loss, "q"_a, "v"_a, "u"_a, "q_next"_a, "v_next"_a, "starts"_a, "horizon"_a, "theta"_a, "scale_q"_a,
           "scale_v"_a, "huber"_a, "fail_penalty"_a, "options"_a, "threads"_a = 1)
      .def("windows", &Core::windows, "q"_a, "v"_a, "u"_a, "starts"_a, "horizon"_a, "theta"_a, "columns"_a, "begun"_a, "driven"_a,
           "rows"_a, "units"_a, "options"_a, "threads"_a = 1)
      .def("dynamics", &Core::dynamics, "q"_a, "v"_a, "theta"_a.none(), "options"_a,
           "contacts"_a = true)
      .def("gaps", &Core::gaps, "q"_a)
      .def("rows", &Core::rows, "q"_a, "v"_a, "u"_a, "theta"_a.none(), "options"_a)
      .def("bodies", &Core::bodies, "q"_a, "v"_a, "bodies"_a, "threads"_a = 1)
      .def("bodies_backward", &Core::bodies_backward, "q"_a, "v"_a, "bodies"_a, "cotangent"_a, "threads"_a = 1)
      .def_prop_ro("isa", &Core::isa)
      .def_prop_ro("width", &Core::width);
}

}  // namespace cmbrl
