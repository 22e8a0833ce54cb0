// The settings of a step, from a Python dictionary.
#pragma once
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include "base/arrays.hpp"
#include "base/engine.hpp"
#include "scene/call.hpp"

namespace cmbrl {

inline PyObject* key(const char* name) {  // of a literal, made once: a new string costs more than the look-up
  static std::vector<std::pair<const char*, PyObject*>> known;
  for (auto [text, string] : known)
    if (text == name) return string;
  known.emplace_back(name, PyUnicode_InternFromString(name));
  return known.back().second;
}
template <class X>
X option(nb::dict options, const char* name) {
  nb::handle value = PyDict_GetItemWithError(options.ptr(), key(name));
  if (!value) refuse(std::string("setting '") + name + "' is missing");
  X x;
  if (!nb::try_cast(value, x))
    refuse(std::string("setting '") + name + "' is " + nb::repr(value).c_str() + "; give " +
           (std::is_integral_v<X> ? "a whole number below 2^31" : "a number"));
  return x;
}
inline Smoothing smoothing_from(nb::dict d) {
  return {option<int>(d, "mode"), option<double>(d, "kappa"), option<double>(d, "floor"), option<double>(d, "dry"),
          option<double>(d, "length"), option<int>(d, "stop")};
}
inline Options options_from(nb::dict d) {
  Options o{};
  o.h = option<double>(d, "h"); o.substeps = option<int>(d, "substeps"); o.leapfrog = option<int>(d, "leapfrog"); o.rk4 = option<int>(d, "rk4");
  o.midpoint = option<int>(d, "midpoint");
  o.implicit_springs = option<int>(d, "implicit_springs"); o.split = option<int>(d, "split");
  o.convex = option<int>(d, "convex"); o.look_ahead = option<int>(d, "look_ahead");
  o.forward = smoothing_from(option<nb::dict>(d, "forward")); o.backward = smoothing_from(option<nb::dict>(d, "backward"));
  const Smoothing &f = o.forward, &b = o.backward;
  o.backward_differs = f.mode != b.mode || f.kappa != b.kappa || f.floor != b.floor || f.dry != b.dry || f.length != b.length || f.stop != b.stop;
  o.prune = option<double>(d, "prune"); o.tolerance = option<double>(d, "tolerance"); o.theta = option<double>(d, "theta");
  o.max_iterations = option<int>(d, "max_iterations"); o.rest_speed = option<double>(d, "rest_speed");
  o.stopped = &Interruption::stopped;
  o.rungs = d.contains("rungs") ? unsigned(option<int>(d, "rungs")) : ~0u;  // for tests
  return o;
}

}  // namespace cmbrl
