// A pool that runs numbered chunks; which thread runs a chunk never changes its result.
#pragma once
#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace cmbrl {

// A run that its caller may want to end early. The calling thread asks `wanted` about twenty times a second; the others see
// the answer. What a stopped run has written is of no use.
class Interruption {
 public:
  explicit Interruption(std::function<bool()> wanted) : wanted_(std::move(wanted)) {}

  static bool stopped() { return here && here->poll(); }  // of the run that this thread works for

  bool poll() {
    if (!stop_ && wanted_ && std::this_thread::get_id() == caller_) {
      Clock::time_point now = Clock::now();
      if (next_ == Clock::time_point{}) next_ = now + period;
      if (now >= next_) {
        if (wanted_()) stop_ = true;
        next_ = Clock::now() + period;
      }
    }
    return stop_;
  }
  void stop() { stop_ = true; }

  static constexpr std::chrono::milliseconds period{50};

  class Scope {  // this thread works for it
   public:
    explicit Scope(Interruption& of) : before_(here) { here = &of; }
    ~Scope() { here = before_; }
    Scope(const Scope&) = delete;

   private:
    Interruption* before_;
  };

 private:
  using Clock = std::chrono::steady_clock;
  static inline thread_local Interruption* here = nullptr;
  std::function<bool()> wanted_;
  std::thread::id caller_ = std::this_thread::get_id();
  Clock::time_point next_{};  // only the caller's; set when it first polls, so that a short run reads no clock
  std::atomic<bool> stop_{false};
};

class ThreadPool {
 public:
  using Job = std::function<void(int64_t chunk, int thread)>;

  ThreadPool() = default;
  ThreadPool(const ThreadPool&) = delete;
  ~ThreadPool() {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      quit_ = true;
    }
    wake_.notify_all();
    for (auto& t : workers_) t.join();
  }

  // job(chunk, thread) for chunk in [0, chunks) on `threads` threads, the caller being thread 0; one run at a time. The
  // first exception of a job ends the run, as `interruption` does, and reaches the caller.
  void run(int64_t chunks, int threads, const Job& job, Interruption& interruption) {
    job_ = &job;
    interruption_ = &interruption;
    chunks_ = chunks;
    next_ = 0;
    failure_ = nullptr;
    threads = int(std::min<int64_t>(threads, chunks));
    if (threads > 1) start(threads - 1);
    drain(0);
    if (threads > 1) {
      briefly([this] { return running_ == 0; });
      std::unique_lock<std::mutex> lock(mutex_);
      while (!idle_.wait_for(lock, Interruption::period, [this] { return running_ == 0; })) {
        lock.unlock();
        interruption.poll();
        lock.lock();
      }
    }
    if (failure_) std::rethrow_exception(failure_);
  }

 private:
  void start(int helpers) {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      for (int id = int(workers_.size()) + 1; id <= helpers; ++id)
        workers_.emplace_back([this, id, round = round_.load()] { work(id, round); });
      helpers_ = running_ = helpers;
      ++round_;
    }
    wake_.notify_all();
  }
  void drain(int id) {
    Interruption::Scope scope(*interruption_);
    try {
      for (int64_t c; (c = next_.fetch_add(1)) < chunks_ && !(c > 0 && interruption_->poll());) (*job_)(c, id);
    } catch (...) {
      interruption_->stop();
      std::lock_guard<std::mutex> lock(mutex_);
      if (!failure_) failure_ = std::current_exception();
    }
  }
  // Looks for `there` for a while before its thread sleeps: to be woken takes as long as some hundred steps.
  template <class F>
  static void briefly(F there) {
    auto end = std::chrono::steady_clock::now() + std::chrono::microseconds(50);
    while (!there() && std::chrono::steady_clock::now() < end) std::this_thread::yield();
  }
  void work(int id, uint64_t seen) {
    for (;;) {
      briefly([this, seen] { return round_ != seen; });
      {
        std::unique_lock<std::mutex> lock(mutex_);
        wake_.wait(lock, [&] { return quit_ || (round_ != seen && id <= helpers_); });
        if (quit_) return;
        seen = round_;
      }
      drain(id);
      std::lock_guard<std::mutex> lock(mutex_);
      if (--running_ == 0) idle_.notify_one();
    }
  }

  std::vector<std::thread> workers_;
  std::mutex mutex_;
  std::condition_variable wake_, idle_;
  // Of the present run. Written by its caller before the workers learn of it.
  const Job* job_ = nullptr;
  Interruption* interruption_ = nullptr;
  int64_t chunks_ = 0;
  std::atomic<int64_t> next_{0};
  std::exception_ptr failure_;
  int helpers_ = 0;
  std::atomic<int> running_{0};
  std::atomic<uint64_t> round_{0};
  bool quit_ = false;
};

}  // namespace cmbrl
