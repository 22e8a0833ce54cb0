// Arrays from Python and back, without copies.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <optional>
#include <string>

#include "base/buffers.hpp"

namespace nb = nanobind;
using Array = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Index = nb::ndarray<const int64_t, nb::c_contig, nb::device::cpu>;

namespace cmbrl {

struct Block { void* data; size_t bytes; };

template <class X>
size_t bytes_of_array(std::initializer_list<size_t> shape) {
  size_t bytes = sizeof(X);
  for (size_t s : shape)
    if (__builtin_mul_overflow(bytes, s, &bytes)) throw OutOfMemory(SIZE_MAX, "a result (a smaller batch needs less)");
  return bytes;
}

template <class X>
nb::capsule take_block(size_t bytes, X** data) {  // not initialised; given back with the capsule
  auto* block = new Block{Buffers::take(bytes), bytes};
  *data = static_cast<X*>(block->data);
  return nb::capsule(block, [](void* p) noexcept {
    auto* b = static_cast<Block*>(p);
    Buffers::give_back(b->data, b->bytes);
    delete b;
  });
}
template <class X>
auto make_array(std::initializer_list<size_t> shape, X** data) {
  nb::capsule owner = take_block(bytes_of_array<X>(shape), data);
  return nb::ndarray<nb::numpy, X>(*data, shape, owner);
}

[[noreturn]] inline void refuse(const std::string& message) {  // one line: what is wrong, where, and what to do
  nb::object error = nb::module_::import_("cmbrl.errors").attr("UserError");
  PyErr_SetObject(error.ptr(), error(message).ptr());
  throw nb::python_error();
}

inline void check(const Array& a, const char* name, std::initializer_list<int64_t> shape) {  // -1: any
  bool ok = a.ndim() == shape.size();
  size_t i = 0;
  for (int64_t s : shape) { ok = ok && (s < 0 || int64_t(a.shape(i)) == s); ++i; }
  if (ok) return;
  auto text = [](size_t dimensions, auto size) {
    std::string list;
    for (size_t k = 0; k < dimensions; ++k) list += (k ? ", " : "") + (size(k) < 0 ? std::string("any") : std::to_string(size(k)));
    return "(" + list + ")";
  };
  refuse(std::string("array '") + name + "' has the shape " + text(a.ndim(), [&](size_t k) { return int64_t(a.shape(k)); }) +
         "; give " + text(shape.size(), [&](size_t k) { return shape.begin()[k]; }));
}

}  // namespace cmbrl
