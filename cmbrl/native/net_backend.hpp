// A small net of fully connected layers, as its hot code sees it. Widths are padded to whole vectors of kFloats.
#pragma once
#include <cstdint>
#include <vector>

namespace cmbrl {

constexpr int kFloats = 16;       // of a vector, on every instruction set
constexpr int64_t kNetRows = 64;  // rows that go through all layers together, so that they stay in the first caches

inline int64_t padded(int64_t width) { return (width + kFloats - 1) / kFloats * kFloats; }

struct NetLayer {
  int64_t in, out;      // widths
  bool hidden, norm;    // followed by ELU; and then by LayerNorm
  int64_t kept;         // where its activations begin on the tape of kNetRows rows: (rows, padded(out)), then mean and scale
  // Offsets of the parameters: in the caller's vector (out, in), (out); packed in panels of kFloats columns.
  int64_t weight, bias, gain, shift;
  int64_t forward, backward, vectors;  // panels of the transposed weight and of the weight; bias, gain, shift
};

struct Net {
  std::vector<NetLayer> layers;
  int64_t parameters = 0, packed = 0, kept = 0, widest = 0;  // floats: given, packed, of a block's tape; largest padded width
};

struct NetBackend {
  void (*forward)(const Net&, const float* packed, const float* x, int64_t rows, float* y, float* tape);  // tape: or null
  // gx, gradient: or null. The gradient is set, not added to.
  void (*backward)(const Net&, const float* packed, const float* x, int64_t rows, const float* tape, const float* gy, float* gx,
                   float* gradient);
};

}  // namespace cmbrl
