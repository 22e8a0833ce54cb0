// What a step is made of: dynamics, gaps, rows, and motions of bodies.
#include "core/core.hpp"

namespace cmbrl {

nb::dict Core::dynamics(Array q, Array v, std::optional<Array> theta, nb::dict options, bool contacts) {
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

nb::object Core::gaps(Array q) {
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

nb::object Core::weights(Array theta) {
  const Model& m = data_->model;
  check(theta, "theta", {m.ntheta});
  double* factors;
  auto out = make_array<double>({size_t(m.nweight)}, &factors);
  run(1, 1, Purpose::step, [&](const Backend& backend, int64_t, int64_t, StepMemory& w) { backend.weights(m, theta.data(), factors, w); });
  return nb::cast(out);
}

nb::dict Core::rows(Array q, Array v, Array u, std::optional<Array> theta, nb::dict options) {
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

nb::object Core::bodies(Array q, Array v, Index chosen, int threads) {
  const Model& m = data_->model;
  Batch b = states(q, v, nullptr, std::nullopt);
  std::vector<int32_t> bodies = checked_bodies(chosen);
  BodyBatch out{int(bodies.size()), bodies.data(), nullptr, nullptr};
  auto motion = make_array<double>({size_t(b.n), bodies.size(), body_fields()}, &out.motion);
  run(b.n, threads, Purpose::step, [&](const Backend& backend, int64_t s, int64_t e, StepMemory& w) { backend.bodies(m, b, out, s, e, w); });
  return nb::cast(motion);
}

nb::tuple Core::bodies_backward(Array q, Array v, Index chosen, Array cotangent, int threads) {
  const Model& m = data_->model;
  Batch b = states(q, v, nullptr, std::nullopt);
  std::vector<int32_t> bodies = checked_bodies(chosen);
  check(cotangent, "cotangent", {b.n, int64_t(bodies.size()), int64_t(body_fields())});
  BodyBatch out{int(bodies.size()), bodies.data(), nullptr, cotangent.data()};
  auto gq = make_array<double>({size_t(b.n), size_t(m.nv)}, &b.gq), gv = make_array<double>({size_t(b.n), size_t(m.nv)}, &b.gv);
  run(b.n, threads, Purpose::step, [&](const Backend& backend, int64_t s, int64_t e, StepMemory& w) { backend.bodies_backward(m, b, out, s, e, w); });
  return nb::make_tuple(gq, gv);
}

}  // namespace cmbrl
