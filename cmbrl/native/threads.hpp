// A fixed pool that runs numbered chunks; which thread runs a chunk never changes its result.
#pragma once
#include <atomic>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace cmbrl {

class ThreadPool {
 public:
  ~ThreadPool() {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      stop_ = true;
    }
    wake_.notify_all();
    for (auto& t : workers_) t.join();
  }

  // job(chunk, thread) for chunk in [0, chunks) on `threads` threads, the caller being thread 0.
  void run(int64_t chunks, int threads, const std::function<void(int64_t, int)>& job) {
    if (threads <= 1 || chunks <= 1) {
      for (int64_t c = 0; c < chunks; ++c) job(c, 0);
      return;
    }
    while (int(workers_.size()) < threads - 1) workers_.emplace_back([this, id = int(workers_.size()) + 1] { work(id); });
    {
      std::lock_guard<std::mutex> lock(mutex_);
      job_ = &job;
      chunks_ = chunks;
      next_ = 0;
      helpers_ = threads - 1;
      running_ = int(workers_.size());
      ++round_;
    }
    wake_.notify_all();
    drain(0);
    std::unique_lock<std::mutex> lock(mutex_);
    idle_.wait(lock, [this] { return running_ == 0; });
  }

 private:
  void drain(int id) {
    for (int64_t c; (c = next_.fetch_add(1)) < chunks_;) (*job_)(c, id);
  }
  void work(int id) {
    for (uint64_t seen = 0;;) {
      {
        std::unique_lock<std::mutex> lock(mutex_);
        wake_.wait(lock, [&] { return stop_ || round_ != seen; });
        if (stop_) return;
        seen = round_;
      }
      if (id <= helpers_) drain(id);
      std::lock_guard<std::mutex> lock(mutex_);
      if (--running_ == 0) idle_.notify_one();
    }
  }

  std::vector<std::thread> workers_;
  std::mutex mutex_;
  std::condition_variable wake_, idle_;
  const std::function<void(int64_t, int)>* job_ = nullptr;
  std::atomic<int64_t> next_{0};
  int64_t chunks_ = 0;
  int helpers_ = 0, running_ = 0;
  uint64_t round_ = 0;
  bool stop_ = false;
};

}  // namespace cmbrl
