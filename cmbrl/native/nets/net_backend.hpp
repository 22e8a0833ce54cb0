// A small net of fully connected layers, as its hot code sees it. Widths are padded to whole panels of kFloats columns.
#pragma once
#include <cstdint>

namespace cmbrl {

constexpr int kFloats = 16;       // columns of a panel: of a register of the widest instruction set, or of several
constexpr int64_t kNetRows = 64;  // rows that go through all layers together, so that they stay in the first caches

inline int64_t padded(int64_t width) { return (width + kFloats - 1) / kFloats * kFloats; }

struct NetLayer {
  int64_t in, out;    // widths
  bool hidden, norm;  // followed by ELU; and then by LayerNorm
  int64_t kept;       // where its activations begin on the tape of kNetRows rows: (rows, padded(out)), then mean and scale
  int64_t weight, bias, gain, shift;       // where they begin in the caller's vector: (out, in), (out), (out), (out)
  int64_t forward, backward, vectors;      // packed: panels of the transposed weight and of the weight; bias, gain, shift
  int64_t weight_sum, bias_sum, gain_sum;  // of gradients: (out, padded(in)), (padded(out)); gain and shift
};

struct Net {
  const NetLayer* layers;
  int64_t count;
  int64_t parameters, packed, sums, kept, work;  // floats: of the caller's vector, packed, of gradients; for kNetRows rows
  int64_t widest;                                // padded width
};

// work: net.work floats. One per instruction set.
struct NetBackend {
  void (*forward)(const Net&, const float* packed, const float* x, int64_t rows, float* y, float* tape, float* work);  // tape: or null
  // Sets gx and the sums of the parameters' gradients, each unless null.
  void (*backward)(const Net&, const float* packed, const float* x, int64_t rows, const float* tape, const float* gy, float* gx,
                   float* sums, float* work);
};

}  // namespace cmbrl
