// A net forwards and backwards: linear layers, each but the last followed by ELU and, if wanted, LayerNorm. Fused, because
// at the size of policies and critics the passes between the products cost as much as these.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <utility>

#include "nets/net_backend.hpp"

namespace cmbrl::CMBRL_ISA {

#if defined(__AVX512F__)
constexpr int kLanes = 16, kTile = 12;  // floats in a register; rows whose sums fill the registers
#elif defined(__AVX__)
constexpr int kLanes = 8, kTile = 6;
#else
constexpr int kLanes = 4, kTile = 3;
#endif
constexpr int kParts = kFloats / kLanes;

using F = float __attribute__((vector_size(4 * kLanes)));
using I = int32_t __attribute__((vector_size(4 * kLanes)));
using Loose = F __attribute__((aligned(4), may_alias));  // at any address
static F load(const float* p) { return *reinterpret_cast<const Loose*>(p); }
static void store(float* p, F x) { *reinterpret_cast<Loose*>(p) = x; }
static F choose(I mask, F a, F b) { return (F)((mask & (I)a) | (~mask & (I)b)); }
static float sum(F x) {
  float total = 0;
  for (int i = 0; i < kLanes; ++i) total += x[i];
  return total;
}

// c (R, kFloats) += a (R, depth) b (depth, kFloats); element (r, p) of a is a[r * row + p * step].
template <int R>
static void tile(const float* a, int64_t row, int64_t step, const float* b, int64_t b_row, int64_t depth, float* c, int64_t c_row) {
  F total[R][kParts];
  for (int r = 0; r < R; ++r)
    for (int k = 0; k < kParts; ++k) total[r][k] = load(c + r * c_row + k * kLanes);
  for (int64_t p = 0; p < depth; ++p, a += step, b += b_row) {
    F part[kParts];
    for (int k = 0; k < kParts; ++k) part[k] = load(b + k * kLanes);
    for (int r = 0; r < R; ++r)
      for (int k = 0; k < kParts; ++k) total[r][k] += a[r * row] * part[k];
  }
  for (int r = 0; r < R; ++r)
    for (int k = 0; k < kParts; ++k) store(c + r * c_row + k * kLanes, total[r][k]);
}
template <int R>
static void last_tile(int64_t rows, const float* a, int64_t row, int64_t step, const float* b, int64_t b_row, int64_t depth, float* c,
                      int64_t c_row) {
  if constexpr (R > 0) {
    if (rows == R) tile<R>(a, row, step, b, b_row, depth, c, c_row);
    else last_tile<R - 1>(rows, a, row, step, b, b_row, depth, c, c_row);
  }
}

struct Panels { const float* data; int64_t panel, row; };  // columns [kFloats k, kFloats (k + 1)) begin at data + k * panel

// c (rows, columns) += a (rows, depth) b (depth, columns), columns a multiple of kFloats.
static void multiply(const float* a, int64_t row, int64_t step, Panels b, int64_t rows, int64_t depth, int64_t columns, float* c) {
  for (int64_t j = 0; j < columns / kFloats; ++j) {
    const float* panel = b.data + j * b.panel;
    int64_t r = 0;
    for (; r + kTile <= rows; r += kTile) tile<kTile>(a + r * row, row, step, panel, b.row, depth, c + r * columns + j * kFloats, columns);
    last_tile<kTile - 1>(rows - r, a + r * row, row, step, panel, b.row, depth, c + r * columns + j * kFloats, columns);
  }
}

// exp(x) - 1 for x <= 0, to 2 units in the last place: x = n log 2 + r, a polynomial in r, and 2^n.
static F expm1(F x) {
  x = choose(x < -87.0f, F{} - 87.0f, x);
  const float magic = 12582912.0f;  // rounds to a whole number
  F n = (x * 1.44269504f + magic) - magic;
  F r = (x - n * 0.693359375f) + n * 2.12194440e-4f;
  F p = F{} + 1.9875691500e-4f;
  for (float c : {1.3981999507e-3f, 8.3334519073e-3f, 4.1665795894e-2f, 1.6666665459e-1f, 5.0000001201e-1f}) p = p * r + c;
  p = p * r * r + r;
  F power = (F)((__builtin_convertvector(n, I) + 127) << 23);
  return power * p + (power - 1.0f);
}

// Rows e (rows, padded) of a hidden layer, before ELU; after it, with mean and scale of each row (rows, 2) in `moments`.
static void activate(const NetLayer& l, int64_t rows, float* e, float* moments) {
  int64_t width = padded(l.out);
  for (int64_t r = 0; r < rows; ++r, e += width, moments += 2) {
    F total{};
    for (int64_t k = 0; k < width; k += kLanes) {
      F x = load(e + k);
      x = choose(x > 0.0f, x, expm1(choose(x > 0.0f, F{}, x)));
      store(e + k, x);
      total += x;
    }
    if (!l.norm) continue;
    float mean = sum(total) / float(l.out);
    F square{};
    for (int64_t k = 0; k < width; k += kLanes) {
      F off = load(e + k) - mean;
      square += off * off;
    }
    float variance = (sum(square) - float(width - l.out) * mean * mean) / float(l.out);  // without the padding, which is 0
    moments[0] = mean;
    // An overflow stays visible: a scale of 0 would hide it.
    moments[1] = variance < __builtin_inff() ? 1.0f / std::sqrt(std::max(variance, 0.0f) + 1e-5f) : __builtin_nanf("");
  }
}

// What the next layer sees (rows, padded) of a hidden layer's activations.
static void normalise(const NetLayer& l, const float* packed, int64_t rows, const float* e, const float* moments, float* n) {
  int64_t width = padded(l.out);
  if (!l.norm) {
    std::memcpy(n, e, sizeof(float) * rows * width);
    return;
  }
  const float *gain = packed + l.vectors + width, *shift = gain + width;
  for (int64_t r = 0; r < rows; ++r, moments += 2)
    for (int64_t k = 0; k < width; k += kLanes, e += kLanes, n += kLanes)
      store(n, (load(e) - moments[0]) * moments[1] * load(gain + k) + load(shift + k));
}

// Cotangents g (rows, padded) of what the next layer sees into those of this one's sums, before ELU. Adds
// to the sums for gain and shift, unless null.
static void deactivate(const NetLayer& l, const float* packed, int64_t rows, const float* e, const float* moments, float* g,
                       float* sums) {
  int64_t width = padded(l.out);
  const float* gain = packed + l.vectors + width;
  for (int64_t r = 0; r < rows; ++r, e += width, g += width, moments += 2) {
    float mean = moments[0], scale = moments[1], first = 0, second = 0;
    if (l.norm) {
      F plain{}, along{};
      for (int64_t k = 0; k < width; k += kLanes) {
        F message = load(g + k), x = (load(e + k) - mean) * scale;
        if (sums) {
          store(sums + k, load(sums + k) + message * x);
          store(sums + width + k, load(sums + width + k) + message);
        }
        message *= load(gain + k);
        plain += message;
        along += message * x;
        store(g + k, message);
      }
      first = sum(plain) / float(l.out);
      second = sum(along) / float(l.out);
    }
    for (int64_t k = 0; k < width; k += kLanes) {
      F x = load(e + k), message = load(g + k);
      if (l.norm) message = scale * (message - first - (x - mean) * scale * second);
      store(g + k, message * choose(x > 0.0f, F{} + 1.0f, x + 1.0f));
    }
  }
}

static void add_rows(const float* g, int64_t width, int64_t rows, float* total) {
  for (int64_t r = 0; r < rows; ++r)
    for (int64_t k = 0; k < width; k += kLanes, g += kLanes) store(total + k, load(total + k) + load(g));
}
static void copy_rows(const float* from, int64_t width, int64_t rows, float* to, int64_t to_width) {  // pads by 0, or cuts
  for (int64_t r = 0; r < rows; ++r, from += width, to += to_width) {
    std::memcpy(to, from, sizeof(float) * std::min(width, to_width));
    if (to_width > width) std::memset(to + width, 0, sizeof(float) * (to_width - width));
  }
}

static void net_forward(const Net& net, const float* packed, const float* x, int64_t rows, float* y, float* tape, float* work) {
  float *seen = work, *out = seen + kNetRows * net.widest, *own = out + kNetRows * net.widest;
  const NetLayer& last = net.layers[net.count - 1];
  for (int64_t begin = 0; begin < rows; begin += kNetRows) {
    int64_t count = std::min(kNetRows, rows - begin), in_row = net.layers[0].in;
    float* kept = tape ? tape + begin / kNetRows * net.kept : own;
    const float* in = x + begin * in_row;
    for (int64_t k = 0; k < net.count; ++k) {
      const NetLayer& l = net.layers[k];
      int64_t width = padded(l.out);
      float* sums = l.hidden ? kept + l.kept : out;
      for (int64_t r = 0; r < count; ++r) std::memcpy(sums + r * width, packed + l.vectors, sizeof(float) * width);
      multiply(in, in_row, 1, {packed + l.forward, l.in * kFloats, kFloats}, count, l.in, width, sums);
      if (!l.hidden) break;
      float* moments = sums + kNetRows * width;
      activate(l, count, sums, moments);
      normalise(l, packed, count, sums, moments, seen);
      in = seen;
      in_row = width;
    }
    copy_rows(out, padded(last.out), count, y + begin * last.out, last.out);
  }
}

static void net_backward(const Net& net, const float* packed, const float* x, int64_t rows, const float* tape, const float* gy, float* gx,
                         float* sums, float* work) {
  float *g = work, *before = g + kNetRows * net.widest, *seen = before + kNetRows * net.widest;
  const NetLayer& last = net.layers[net.count - 1];
  if (sums) std::memset(sums, 0, sizeof(float) * net.sums);
  for (int64_t begin = 0; begin < rows; begin += kNetRows) {
    int64_t count = std::min(kNetRows, rows - begin);
    const float* kept = tape + begin / kNetRows * net.kept;
    copy_rows(gy + begin * last.out, last.out, count, g, padded(last.out));
    for (int64_t k = net.count - 1; k >= 0; --k) {
      const NetLayer &l = net.layers[k], *below = k ? &l - 1 : nullptr;
      int64_t in = padded(l.in), out = padded(l.out);
      const float *e = below ? kept + below->kept : nullptr, *moments = below ? e + kNetRows * in : nullptr;
      if (sums) {
        if (below) normalise(*below, packed, count, e, moments, seen);
        else copy_rows(x + begin * l.in, l.in, count, seen, in);
        multiply(g, 1, out, {seen, kFloats, in}, l.out, count, in, sums + l.weight_sum);
        add_rows(g, out, count, sums + l.bias_sum);
      }
      if (!below && !gx) break;
      std::memset(before, 0, sizeof(float) * count * in);
      multiply(g, out, 1, {packed + l.backward, l.out * kFloats, kFloats}, count, l.out, in, before);
      if (below) deactivate(*below, packed, count, e, moments, before, sums ? sums + below->gain_sum : nullptr);
      else copy_rows(before, in, count, gx + begin * l.in, l.in);
      std::swap(g, before);
    }
  }
}

}  // namespace cmbrl::CMBRL_ISA
