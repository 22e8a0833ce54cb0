// How the elements of a batch are gathered into packs: by the rows that a survey expects, then those that are set aside.
#include "step/attempts.hpp"

#include <cstdio>
#include <cstdlib>

using namespace cmbrl;

static void expect(bool holds, const char* what) {
  if (holds) return;
  std::printf("attempts: %s\n", what);
  std::exit(1);
}

// The lists of a batch with so many rows an element, of which those with `hard` rows need a second attempt, and those with `missed`
// rows one that knows where the first has led to.
static bool sets_aside;  // whether the first attempt did
static std::vector<Elements> lists_of(const std::vector<int32_t>& rows, int width, bool surveyed, int32_t hard, int32_t missed = -1) {
  int64_t n = int64_t(rows.size());
  std::vector<int32_t> status(n), iterations(n);
  Batch b{};
  b.n = n;
  b.status = status.data();
  b.iterations = iterations.data();
  std::vector<Elements> lists;
  auto survey = [&] {
    if (surveyed) std::copy(rows.begin(), rows.end(), b.iterations);
    return surveyed;
  };
  Options o{};
  o.admit = 1;
  step_in_attempts(o, b, width, survey, [&](const Options& now, const Elements* some) {
    if (lists.empty()) sets_aside = now.set_aside;
    lists.push_back(some ? *some : Elements());
    for (int64_t i = 0; i < n; ++i)
      status[i] = rows[i] == hard && !now.last_attempt ? kUnsolved : rows[i] == missed && !now.again ? kMissed : 0;
  });
  return lists;
}

int main() {
  std::vector<int32_t> rows{3, 0, 9, 3, 0, 9, 5};
  expect(lists_of(rows, 4, true, -1) == std::vector<Elements>{{2, 5, 6, 0, 3, 1, 4}}, "those with the most rows first, then in the order given");
  expect(!sets_aside, "states that are told apart stay where they are");
  lists_of({3, 3, 3, 3, 3}, 4, true, -1);
  expect(sets_aside, "the pack decides where the survey tells nothing apart");
  expect(lists_of(rows, 4, false, -1) == std::vector<Elements>{{}}, "as they come, where a survey is not worth it");
  expect(lists_of(rows, 7, true, -1) == std::vector<Elements>{{}}, "one pack is not sorted");
  expect(lists_of(rows, 4, true, 3) == std::vector<Elements>{{2, 5, 6, 0, 3, 1, 4}, {0, 3}}, "what is hard is stepped again");
  expect(lists_of(rows, 4, true, 3, 9) == std::vector<Elements>{{2, 5, 6, 0, 3, 1, 4}, {0, 3}, {2, 5}}, "and so is what left out too many rows");
  std::printf("attempts: ok\n");
}
