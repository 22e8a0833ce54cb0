#include "base/memory.hpp"

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <utility>

namespace cmbrl {

void Memory::Free::operator()(void* p) const { std::free(p); }

void* Memory::data() const { return reinterpret_cast<void*>((reinterpret_cast<uintptr_t>(block_.get()) + 63) / 64 * 64); }

void* Memory::reserve(size_t bytes) {
  if (bytes > bytes_) {
    block_.reset();  // first, so that the old and the new need not both fit
    bytes_ = 0;
    block_.reset(std::calloc(bytes + 64, 1));
    if (!block_) throw OutOfMemory(bytes, "a workspace (a smaller scene needs less)");
    bytes_ = bytes;
  }
  return data();
}

void* Memory::extend(size_t bytes) {
  if (bytes > bytes_) {
    Memory larger;
    larger.reserve(std::max(bytes, bytes_ + bytes_ / 2));
    if (block_) std::memcpy(larger.data(), data(), bytes_);
    std::swap(block_, larger.block_);
    std::swap(bytes_, larger.bytes_);
  }
  return data();
}

}  // namespace cmbrl
