#include "step/tape_rows.hpp"

#include <algorithm>
#include <mutex>
#include <vector>

#include "base/buffers.hpp"

namespace cmbrl {

namespace {
constexpr int64_t least = 512, most = int64_t(1) << 17;  // doubles of a block, but for a run that is longer
constexpr double per_block = 4294967296.0;               // a place is the number of a block times this, and where in it
}  // namespace

struct TapeRows::Blocks {
  struct Block { double* data; int64_t size; };
  std::mutex mutex;
  std::vector<Block> all;
  int64_t next, used = 0;
};

TapeRows::TapeRows(int64_t first) : blocks_(new Blocks) {
  blocks_->next = least;
  while (blocks_->next < std::min(first, most)) blocks_->next *= 2;  // powers of two come back from the buffers
}

TapeRows::~TapeRows() {
  for (auto [data, size] : blocks_->all) Buffers::give_back(data, size * sizeof(double));
}

double* TapeRows::take(int64_t n, double* place) {
  Blocks& b = *blocks_;
  std::lock_guard<std::mutex> lock(b.mutex);
  if (b.all.empty() || b.used + n > b.all.back().size) {
    int64_t size = std::max(n, b.next);
    b.all.reserve(b.all.size() + 1);
    b.all.push_back({static_cast<double*>(Buffers::take(size * sizeof(double))), size});
    b.next = std::min(2 * b.next, most);
    b.used = 0;
  }
  *place = per_block * double(b.all.size() - 1) + double(b.used);
  double* run = b.all.back().data + b.used;
  b.used += n;
  return run;
}

const double* TapeRows::at(double place) const {
  int64_t block = int64_t(place / per_block);
  return blocks_->all[block].data + (int64_t(place) - block * int64_t(per_block));
}

size_t TapeRows::bytes() const {
  size_t sum = 0;
  for (auto [data, size] : blocks_->all) sum += size * sizeof(double);
  return sum;
}

}  // namespace cmbrl
