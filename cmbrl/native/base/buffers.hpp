// Memory for results. They come back when Python drops them: a training loop asks for the same sizes
// again and again, and fresh pages from the system would cost more than a small step.
#pragma once
#include <cstdlib>
#include <cstdint>
#include <memory>
#include <mutex>
#include <new>
#include <string>
#include <vector>

#include "base/memory.hpp"

namespace cmbrl {

class Buffers {  // with the GIL held
 public:
  static void* take(size_t bytes) {
    {
      std::lock_guard<std::mutex> lock(mutex());
      std::vector<Block>& blocks = kept();
      for (size_t k = blocks.size(); k-- > 0;)
        if (blocks[k].bytes == bytes) {
          void* p = blocks[k].data;
          total() -= bytes;
          blocks.erase(blocks.begin() + k);
          return p;
        }
    }
    void* p = std::malloc(bytes ? bytes : 1);
    if (!p) throw OutOfMemory(bytes, "a result (a smaller batch needs less)");
    return p;
  }
  static void give_back(void* p, size_t bytes) {
    std::lock_guard<std::mutex> lock(mutex());
    std::vector<Block>& blocks = kept();
    blocks.push_back({p, bytes});
    total() += bytes;
    while (total() > most_bytes || blocks.size() > most_blocks) {  // the one that was not asked for the longest
      total() -= blocks[0].bytes;
      std::free(blocks[0].data);
      blocks.erase(blocks.begin());
    }
  }
  static std::vector<size_t> sizes() {  // in the order in which they came back
    std::lock_guard<std::mutex> lock(mutex());
    std::vector<size_t> all;
    for (const Block& block : kept()) all.push_back(block.bytes);
    return all;
  }

 private:
  struct Block { void* data; size_t bytes; };
  static constexpr size_t most_bytes = size_t(256) << 20, most_blocks = 1024;
  static std::mutex& mutex() { static auto* m = new std::mutex; return *m; }
  static std::vector<Block>& kept() { static auto* k = new std::vector<Block>; return *k; }
  static size_t& total() { static size_t t = 0; return t; }
};

}  // namespace cmbrl
