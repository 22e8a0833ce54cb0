// Memory of one thread, in blocks that grow with what a step needs: what touches, and how the factor fills.
#pragma once
#include <cstddef>
#include <memory>
#include <new>
#include <string>

namespace cmbrl {

class OutOfMemory : public std::bad_alloc {  // Python's MemoryError
 public:
  OutOfMemory(size_t bytes, const char* what_for)
      : text_("no memory for " + std::string(what_for) + " of " + std::to_string(bytes) + " bytes") {}
  const char* what() const noexcept override { return text_.c_str(); }

 private:
  std::string text_;
};

// Zeros at first, at a multiple of 64 bytes; the system hands out their pages only as they are written. Throws
// OutOfMemory. Compiled once, apart from the instruction sets.
class Memory {
 public:
  void* reserve(size_t bytes);  // at least these; what was there is lost when they grow
  void* extend(size_t bytes);   // at least these; what was there is kept
  void* data() const;

 private:
  struct Free { void operator()(void* p) const; };
  std::unique_ptr<void, Free> block_;
  size_t bytes_ = 0;
};

struct StepMemory { Memory scene, contacts, groups, given, grips, left, passed, rows, factor, stages, window; };

}  // namespace cmbrl
