// Which elements of a batch are stepped together. What is stepped again, or goes back, is chosen from the whole batch, so that
// results do not depend on threads.
#pragma once
#include <algorithm>
#include <cstdint>
#include <numeric>
#include <vector>

#include "scene/call.hpp"

namespace cmbrl {

using Elements = std::vector<int64_t>;

// Steps a batch. A hard solve takes the time of many easy ones, and a pack that of its slowest lane: so those that the first
// rung of the ladder does not solve are set aside, and stepped again in packs of their own, as are those that leave out a row too
// many, and those with many rows. step(options, elements): of all, where there is no list. survey(): writes into b.iterations
// about how many rows each will have, for those that have as many to be stepped together, unless that is not worth it.
template <class Survey, class Step>
void step_in_attempts(const Options& o, const Batch& b, int width, Survey survey, Step step) {
  Options now = o;
  bool one_pack = b.n <= width;
  auto most_rows_first = [&](Elements& some) {  // where b.iterations is the number of rows
    std::stable_sort(some.begin(), some.end(), [&](int64_t x, int64_t y) { return b.iterations[x] > b.iterations[y]; });
  };
  auto again = [&](Unfinished which) {
    Elements chosen;
    for (int64_t i = 0; i < b.n; ++i)
      if (b.status[i] == which) chosen.push_back(i);
    if (which == kCrowded) most_rows_first(chosen);
    if (!chosen.empty()) step(now, &chosen);
    return !chosen.empty();
  };
  now.last_attempt = one_pack;
  now.admit = o.admit && one_pack;
  now.rungs = one_pack ? o.rungs : 1;
  Elements every;
  if (!one_pack && survey()) {
    every.resize(b.n);
    std::iota(every.begin(), every.end(), 0);
    most_rows_first(every);
  }
  bool told_apart = !every.empty() && b.iterations[every.front()] > b.iterations[every.back()];  // then packs have their like already
  now.set_aside = !one_pack && !told_apart;
  step(now, every.empty() ? nullptr : &every);
  now.set_aside = 0;
  again(kCrowded);
  now.last_attempt = 1;
  now.rungs = o.rungs;
  again(kUnsolved);
  now.again = now.admit = o.admit;
  if (!o.admit) now.prune = wider(now.prune);
  while (again(kMissed)) now.prune = wider(now.prune);
}

// Elements of a tape, those with the most contacts first; stride: of a substep.
inline Elements most_contacts_first(const double* tape, int64_t n, int substeps, int64_t stride) {
  constexpr double few = 8;  // contacts of a substep that are not worth it
  std::vector<double> contacts(n);
  Elements order(n);
  std::iota(order.begin(), order.end(), 0);
  for (int64_t i = 0; i < n * substeps; ++i) {
    double count = tape[i * stride + stride - 2];
    contacts[i / substeps] += count > 0 ? count : 0;  // NaN after an input that was not finite
  }
  if (n > 0 && *std::max_element(contacts.begin(), contacts.end()) > few * substeps)
    std::stable_sort(order.begin(), order.end(), [&](int64_t x, int64_t y) { return contacts[x] > contacts[y]; });
  return order;
}

}  // namespace cmbrl
