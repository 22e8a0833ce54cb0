// cmbrl.native.Problems: contact problems given by arrays, and their solutions.
#include <algorithm>

#include "base/arrays.hpp"
#include "base/engine.hpp"
#include "instruction_sets.hpp"
#include "base/per_process.hpp"

namespace cmbrl {

// Contact problems of one shape: arrays in, kept as they are; every solve writes the same arrays. See
// cmbrl.contact.solvers.native.
class Problems {
 public:
  Problems(Array M, Array J, Array v_free, Array b, Array mu, Array R, bool derivative, std::optional<Array> convex)
      : inputs_{M, J, v_free, b, mu, R}, convex_(convex) {
    bool known = J.ndim() == 4 && (J.shape(2) == 2 || J.shape(2) == 3 || J.shape(2) == 4 || J.shape(2) == 6);
    if (!known) refuse("array 'J' must be of shape (batch, contacts, 2, 3, 4 or 6, nv)");
    ProblemBatch& p = batch_;
    p.n = J.shape(0); p.contacts = int(J.shape(1)); p.tangents = int(J.shape(2)) - 1; p.nv = int(J.shape(3));
    int64_t rows = 1 + p.tangents;
    check(M, "M", {p.n, p.nv, p.nv}); check(v_free, "v_free", {p.n, p.nv}); check(b, "b", {p.n, p.contacts, rows});
    check(mu, "mu", {p.n, p.contacts}); check(R, "R", {p.n, p.contacts, rows});
    if (convex) check(*convex, "convex", {p.n, p.contacts});
    p.convex = convex ? convex->data() : nullptr;
    p.M = M.data(); p.J = J.data(); p.v_free = v_free.data(); p.b = b.data(); p.mu = mu.data(); p.R = R.data();
    size_t n = p.n, nv = p.nv;
    out_["v"] = make_array<double>({n, nv}, &p.v);
    out_["impulse"] = make_array<double>({n, size_t(p.contacts), size_t(rows)}, &p.impulse);
    out_["status"] = make_array<int32_t>({n}, &p.status);
    out_["iterations"] = make_array<int32_t>({n}, &p.iterations);
    out_["residual"] = make_array<double>({n}, &p.residual);
    if (derivative) out_["derivative"] = make_array<double>({n, nv, nv}, &p.derivative);
  }

  void solve(double tolerance, std::optional<Array> kappa, int threads, const std::string& isa) {
    static PerProcess<Engine> engine;
    ProblemBatch& p = batch_;
    if (kappa) check(*kappa, "kappa", {p.n});
    p.kappa = kappa ? kappa->data() : nullptr;
    p.tolerance = tolerance;
    const InstructionSet& set = find_isa(isa);
    const ProblemBackend& backend = p.n <= set.few_problems.width ? set.few_problems : set.problems;
    engine.get().run((p.n + backend.width - 1) / backend.width, threads, backend.workspace_size(p),
                     [&](int64_t pack, int, StepMemory& memory) {
                       static thread_local ProblemStructure structure;
                       int64_t begin = pack * backend.width, end = std::min(p.n, begin + backend.width);
                       backend.solve(structure.of(p, begin, end), p, begin, end, memory.scene.data());
                     });
  }

  nb::dict results() const { return out_; }

 private:
  Array inputs_[6];
  std::optional<Array> convex_;
  ProblemBatch batch_{};
  nb::dict out_;
};

void bind_problems(nb::module_& module) {
  using namespace nb::literals;
  nb::class_<Problems>(module, "Problems", "Contact problems of one shape; see cmbrl.contact.solvers.native.")
      .def(nb::init<Array, Array, Array, Array, Array, Array, bool, std::optional<Array>>(), "M"_a, "J"_a, "v_free"_a, "b"_a, "mu"_a, "R"_a,
           "derivative"_a = false, "convex"_a.none() = nb::none())
      .def("solve", &Problems::solve, "tolerance"_a, "kappa"_a.none() = nb::none(), "threads"_a = 1, "isa"_a = "")
      .def_prop_ro("results", &Problems::results);
}

}  // namespace cmbrl
