// An object that a child made by fork has anew. Threads do not survive a fork, and a lock that some thread held stays locked
// in the child for ever: so the child leaves the parent's object alone, without destroying it, and makes one of its own.
#pragma once
#include <pthread.h>

#include <atomic>
#include <memory>

namespace cmbrl {

inline unsigned forks() {  // between this process and the one that loaded the module
  static std::atomic<unsigned> count{0};
  static const int registered = pthread_atfork(nullptr, nullptr, [] { ++count; });
  (void)registered;
  return count;
}

template <class X>
class PerProcess {
 public:
  ~PerProcess() {
    if (made_in_ != forks()) (void)object_.release();
  }
  X& get() {  // with the GIL held
    if (!object_ || made_in_ != forks()) {
      (void)object_.release();
      object_ = std::make_unique<X>();
      made_in_ = forks();
    }
    return *object_;
  }

 private:
  std::unique_ptr<X> object_;
  unsigned made_in_ = forks();
};

}  // namespace cmbrl
