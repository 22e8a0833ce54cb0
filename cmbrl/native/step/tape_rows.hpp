// The part of a tape that follows what touches: runs of doubles, in blocks that grow with them.
#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>

namespace cmbrl {

// Compiled once, apart from the instruction sets; threads may take runs at the same time.
class TapeRows {
 public:
  explicit TapeRows(int64_t first);  // doubles of the first block; each is twice the one before, up to a megabyte
  ~TapeRows();
  double* take(int64_t n, double* place);  // n doubles, and the number under which `at` finds them; throws OutOfMemory
  const double* at(double place) const;
  size_t bytes() const;

 private:
  struct Blocks;
  std::unique_ptr<Blocks> blocks_;
};

}  // namespace cmbrl
