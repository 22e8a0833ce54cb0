// Result arrays are taken from here and come back when Python drops them: a training loop asks for the same sizes again and
// again, and fresh pages from the system would cost more than a small step.
#pragma once
#include <cstdlib>
#include <map>
#include <new>
#include <mutex>
#include <vector>

namespace cmbrl {

class Buffers {
 public:
  static void* take(size_t bytes) {
    {
      std::lock_guard<std::mutex> lock(mutex());
      auto& free_list = lists()[bytes];
      if (!free_list.empty()) {
        void* p = free_list.back();
        free_list.pop_back();
        kept() -= bytes;
        return p;
      }
    }
    void* p = std::malloc(bytes ? bytes : 1);
    if (!p) throw std::bad_alloc();
    return p;
  }
  static void give_back(void* p, size_t bytes) {
    std::lock_guard<std::mutex> lock(mutex());
    if (kept() + bytes > limit) { std::free(p); return; }
    kept() += bytes;
    lists()[bytes].push_back(p);
  }

 private:
  static constexpr size_t limit = size_t(256) << 20;
  static std::mutex& mutex() { static auto* m = new std::mutex; return *m; }
  static std::map<size_t, std::vector<void*>>& lists() { static auto* l = new std::map<size_t, std::vector<void*>>; return *l; }
  static size_t& kept() { static size_t k = 0; return k; }
};

}  // namespace cmbrl
