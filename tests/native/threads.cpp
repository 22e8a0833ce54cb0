// The pool by itself: chunks run once, exceptions reach the caller, growth and interruption. Prints what is wrong.
#include "base/threads.hpp"

#include <cstdio>
#include <stdexcept>
#include <string>

using namespace cmbrl;

static int wrong = 0;
static void expect(bool ok, const char* what) {
  if (!ok) { std::printf("wrong: %s\n", what); ++wrong; }
}

static void every_chunk_once(ThreadPool& pool, int threads) {
  std::vector<std::atomic<int>> runs(1000);
  Interruption never(nullptr);
  pool.run(1000, threads, [&](int64_t c, int) { ++runs[c]; }, never);
  bool once = true;
  for (auto& n : runs) once &= n == 1;
  expect(once, "a chunk did not run exactly once");
}

// Chunk 0 waits until another thread has thrown, or throws itself.
static void exception_of(bool worker) {
  ThreadPool pool;
  std::string caught;
  std::atomic<bool> thrown{false};
  Interruption never(nullptr);
  try {
    pool.run(2, 2, [&](int64_t, int thread) {
      if ((thread > 0) == worker) { thrown = true; throw std::runtime_error("mine"); }
      while (!thrown) std::this_thread::yield();
    }, never);
  } catch (const std::runtime_error& error) { caught = error.what(); }
  expect(caught == "mine", worker ? "a worker's exception is lost" : "the caller's exception is lost");
  every_chunk_once(pool, 2);
}

static void interruption(int threads) {
  ThreadPool pool;
  std::atomic<int> asked{0}, elsewhere{0}, ran{0};
  auto caller = std::this_thread::get_id();
  Interruption second([&] { elsewhere += std::this_thread::get_id() != caller; return ++asked == 2; });
  pool.run(1'000'000, threads, [&](int64_t c, int) {
    ++ran;
    while (c == 1 && !Interruption::stopped()) std::this_thread::yield();
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }, second);
  expect(asked == 2 && elsewhere == 0 && ran < 1000, "an interruption is not answered");
  expect(!Interruption::stopped(), "an interruption outlives its run");
  every_chunk_once(pool, threads);
}

int main() {
  for (int round = 0; round < 200; ++round) {  // workers that have just started must not take the last run for theirs
    ThreadPool pool;
    for (int threads : {2, 4, 1, 3, 6}) every_chunk_once(pool, threads);
  }
  exception_of(true);
  exception_of(false);
  interruption(1);
  interruption(2);
  if (!wrong) std::puts("threads: ok");
  return wrong != 0;
}
