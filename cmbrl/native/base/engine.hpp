// Runs a native batch for Python: without the GIL, on several threads with a workspace each, and open to Ctrl-C.
#pragma once
#include <nanobind/nanobind.h>

#include "base/buffers.hpp"
#include "base/threads.hpp"

namespace cmbrl {

namespace nb = nanobind;

class Engine {
 public:
  // job(chunk, thread, workspace) for chunk in [0, chunks), each thread with a workspace of `bytes`. Called with the GIL;
  // callers wait for each other. Throws what a job throws, OutOfMemory, and KeyboardInterrupt or what else a Python signal
  // handler raises.
  template <class F>
  void run(int64_t chunks, int threads, int64_t bytes, F job) {
    unsigned long self = PyThread_get_thread_ident();
    if (owner_ == self) throw std::runtime_error("this model is in the middle of a batch: a signal handler cannot step it");
    Interruption interruption(self == main_ ? signals : nullptr);
    {
      nb::gil_scoped_release release;
      Turn turn(*this, self, interruption);
      threads = int(std::max<int64_t>(1, std::min<int64_t>(threads, chunks)));
      if (turn.taken) {
        if (int(workspaces_.size()) < threads) workspaces_.resize(threads);
        for (int k = 0; k < threads; ++k) workspaces_[k].scene.reserve(size_t(bytes));
        pool_.run(chunks, threads, [&](int64_t chunk, int thread) { job(chunk, thread, workspaces_[thread]); }, interruption);
      }
    }
    if (PyErr_Occurred()) throw nb::python_error();
  }

 private:
  static bool signals() {
    nb::gil_scoped_acquire acquire;
    return PyErr_CheckSignals() != 0;  // the exception stays set in this thread
  }

  class Turn {  // not taken: interrupted while waiting for it
   public:
    Turn(Engine& engine, unsigned long self, Interruption& interruption) : engine_(engine) {
      std::unique_lock<std::mutex> lock(engine.mutex_);
      while (engine.owner_ != 0) {
        if (engine.free_.wait_for(lock, Interruption::period, [&] { return engine.owner_ == 0; })) break;
        lock.unlock();
        if (interruption.poll()) return;
        lock.lock();
      }
      engine.owner_ = self;
      taken = true;
    }
    ~Turn() {
      if (!taken) return;
      {
        std::lock_guard<std::mutex> lock(engine_.mutex_);
        engine_.owner_ = 0;
      }
      engine_.free_.notify_one();
    }
    Turn(const Turn&) = delete;
    bool taken = false;

   private:
    Engine& engine_;
  };

  std::mutex mutex_;
  std::condition_variable free_;
  std::atomic<unsigned long> owner_{0};  // the Python thread whose batch runs; 0: none
  ThreadPool pool_;
  std::vector<StepMemory> workspaces_;
  // Python runs signal handlers in its main thread only; another one need not ask.
  unsigned long main_ = nb::cast<unsigned long>(nb::module_::import_("threading").attr("main_thread")().attr("ident"));
};

}  // namespace cmbrl
