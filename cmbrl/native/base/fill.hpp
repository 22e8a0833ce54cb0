// The pattern of a symmetric matrix that is eliminated from its last row to its first, as bits: row k holds the columns
// before k that it is coupled to. Eliminating k couples all of them.
#pragma once
#include <cstdint>

namespace cmbrl {
namespace {  // a copy for every instruction set: one that the linker shares could use what a processor lacks

struct FillPattern {
  uint64_t* bits;  // nv x words(nv)
  int nv;

  static int words(int nv) { return (nv + 63) / 64; }
  uint64_t* row(int k) { return bits + int64_t(k) * words(nv); }
  void clear() {
    for (int64_t i = 0; i < int64_t(nv) * words(nv); ++i) bits[i] = 0;
  }
  void couple(int k, int with) { row(k)[with / 64] |= uint64_t(1) << with % 64; }
  void couple_before(int k, const uint64_t* columns) {  // all of them that stand before k
    for (int x = 0; x < k / 64; ++x) row(k)[x] |= columns[x];
    row(k)[k / 64] |= columns[k / 64] & ((uint64_t(1) << k % 64) - 1);
  }
  void couple_all(const uint64_t* columns) {
    for_each(columns, [&](int k) { couple_before(k, columns); });
  }
  void fill_in() {
    for (int k = nv - 1; k >= 0; --k) for_each(row(k), [&](int a) { couple_before(a, row(k)); });
  }
  int64_t count() const {
    int64_t n = 0;
    for (int64_t i = 0; i < int64_t(nv) * words(nv); ++i) n += __builtin_popcountll(bits[i]);
    return n;
  }
  // Columns of row k at idx[ptr[k]] to idx[ptr[k + 1] - 1], rising; ptr has nv + 1 entries, idx count().
  void list(int* ptr, int* idx) {
    int count = 0;
    for (int k = 0; k < nv; ++k) {
      ptr[k] = count;
      for_each(row(k), [&](int a) { idx[count++] = a; });
    }
    ptr[nv] = count;
  }
  template <class F>
  void for_each(const uint64_t* columns, F f) const {
    for (int word = 0; word < words(nv); ++word)
      for (uint64_t left = columns[word]; left; left &= left - 1) f(64 * word + __builtin_ctzll(left));
  }
};

}  // namespace
}  // namespace cmbrl
