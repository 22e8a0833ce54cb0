// The Python module: cmbrl.native.
#include <nanobind/nanobind.h>
#include <nanobind/stl/vector.h>

#include "base/buffers.hpp"

namespace cmbrl {
void bind_core(nanobind::module_& module);
void bind_drives(nanobind::module_& module);
void bind_nets(nanobind::module_& module);
void bind_problems(nanobind::module_& module);
}  // namespace cmbrl

NB_MODULE(_core, module) {
  nanobind::set_leak_warnings(false);  // a model that a script still holds when the interpreter ends is no fault
  cmbrl::bind_core(module);
  cmbrl::bind_problems(module);
  cmbrl::bind_nets(module);
  cmbrl::bind_drives(module);
  module.def("kept_buffers", &cmbrl::Buffers::sizes, "Bytes of every block kept for the next results, the oldest first.");
}
