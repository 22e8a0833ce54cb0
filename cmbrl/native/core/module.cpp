// cmbrl.native.Core and Tape.
#include "core/core.hpp"

namespace cmbrl {

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
      .def("weights", &Core::weights, "theta"_a)
      .def("rows", &Core::rows, "q"_a, "v"_a, "u"_a, "theta"_a.none(), "options"_a)
      .def("bodies", &Core::bodies, "q"_a, "v"_a, "bodies"_a, "threads"_a = 1)
      .def("bodies_backward", &Core::bodies_backward, "q"_a, "v"_a, "bodies"_a, "cotangent"_a, "threads"_a = 1)
      .def_prop_ro("isa", &Core::isa)
      .def_prop_ro("width", &Core::width);
}

}  // namespace cmbrl
