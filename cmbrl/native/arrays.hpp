// Arrays from Python and back, without copies.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <optional>
#include <string>

#include "buffers.hpp"

namespace nb = nanobind;
using Array = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Index = nb::ndarray<const int64_t, nb::c_contig, nb::device::cpu>;

namespace cmbrl {

struct Block { void* data; size_t bytes; };

template <class X>
auto make_array(std::initializer_list<size_t> shape, X** data) {  // not initialised
  size_t n = 1;
  for (size_t s : shape) n *= s;
  auto* block = new Block{Buffers::take(n * sizeof(X)), n * sizeof(X)};
  *data = static_cast<X*>(block->data);
  nb::capsule owner(block, [](void* p) noexcept {
    auto* b = static_cast<Block*>(p);
    Buffers::give_back(b->data, b->bytes);
    delete b;
  });
  return nb::ndarray<nb::numpy, X>(*data, shape, owner);
}

inline void check(const Array& a, const char* name, std::initializer_list<int64_t> shape) {  // -1: any
  bool ok = a.ndim() == shape.size();
  size_t i = 0;
  for (int64_t s : shape) { ok = ok && (s < 0 || int64_t(a.shape(i)) == s); ++i; }
  if (!ok) throw nb::value_error((std::string("array '") + name + "' has the wrong shape").c_str());
}

}  // namespace cmbrl
