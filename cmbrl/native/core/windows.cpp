// Windows of a log, predicted open loop: losses of candidates, and tangents.
#include "core/core.hpp"

namespace cmbrl {

namespace {

void check_windows(const Index& starts, int horizon, int64_t rows) {
  if (horizon < 1) refuse("horizon is " + std::to_string(horizon) + "; give at least 1");
  for (size_t i = 0; i < starts.size(); ++i)
    if (int64_t start = starts.data()[i]; start < 0 || start > rows - horizon)
      refuse("start " + std::to_string(start) + " with a horizon of " + std::to_string(horizon) + " leaves the log of " +
             std::to_string(rows) + " rows");
}
std::vector<int64_t> told_columns(const WindowBatch& b) {  // in some window
  std::vector<int64_t> told;
  for (int64_t k = 0; k < b.nwanted; ++k)
    for (int64_t s = 0; s < b.nstart; ++s)
      if (b.told[s * b.nwanted + k]) { told.push_back(k); break; }
  return told;
}
// Moves them together, each to a place before its own, in units of their rows.
void keep_told(const WindowBatch& b, const std::vector<int64_t>& told, const Array& units) {
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
nb::object copied(const std::vector<int64_t>& numbers) {
  int64_t* data;
  auto out = make_array<int64_t>({numbers.size()}, &data);
  std::copy(numbers.begin(), numbers.end(), data);
  return nb::cast(out);
}
}  // namespace

nb::object Core::loss(Array q, Array v, Array u, Array q_next, Array v_next, Index starts, int horizon, Array theta, Array scale_q,
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

nb::dict Core::windows(Array q, Array v, Array u, Index starts, int horizon, Array theta, Index columns, Array begun, Array driven,
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

}  // namespace cmbrl
