// Batches of steps, and their derivatives.
#include <numeric>

#include "core/core.hpp"
#include "step/attempts.hpp"

namespace cmbrl {

nb::dict Core::forward(Array q, Array v, Array u, std::optional<Array> theta, nb::dict options, bool jacobian,
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

nb::dict Core::backward(Array u, std::optional<Array> theta, Tape& tape, Array gq_next, Array gv_next, nb::dict options, bool want_theta, int threads) {
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

}  // namespace cmbrl
