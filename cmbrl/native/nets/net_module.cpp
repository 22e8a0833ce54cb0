// cmbrl.native.NetWeights: small nets of fully connected layers. See cmbrl.train.policies.net.
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <utility>

#include "base/arrays.hpp"
#include "instruction_sets.hpp"
#include "base/memory.hpp"

using Floats = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;

namespace cmbrl {

static int64_t take(int64_t& total, int64_t count) { return std::exchange(total, total + count); }

static Net layout(const std::vector<int64_t>& widths, bool norm, std::vector<NetLayer>& layers) {
  if (widths.size() < 2 || *std::min_element(widths.begin(), widths.end()) < 1) refuse("a net needs at least two widths, none below 1");
  Net net{};
  for (size_t k = 0; k + 1 < widths.size(); ++k) {
    NetLayer l{};
    l.in = widths[k], l.out = widths[k + 1];
    l.hidden = k + 2 < widths.size(), l.norm = l.hidden && norm;
    int64_t out = padded(l.out);
    if (l.hidden) l.kept = take(net.kept, kNetRows * (out + 2));
    l.weight = take(net.parameters, l.in * l.out), l.bias = take(net.parameters, l.out);
    if (l.norm) l.gain = take(net.parameters, l.out), l.shift = take(net.parameters, l.out);
    l.forward = take(net.packed, l.in * out), l.backward = take(net.packed, l.out * padded(l.in));
    l.vectors = take(net.packed, 3 * out);
    l.weight_sum = take(net.sums, l.out * padded(l.in)), l.bias_sum = take(net.sums, out), l.gain_sum = take(net.sums, 2 * out);
    net.widest = std::max({net.widest, padded(l.in), out});
    layers.push_back(l);
  }
  net.work = 3 * kNetRows * net.widest + net.kept;
  net.layers = layers.data(), net.count = int64_t(layers.size());
  return net;
}

static void pack(const NetLayer& l, const float* given, float* packed) {
  const float* weight = given + l.weight;
  for (int64_t o = 0; o < l.out; ++o, weight += l.in) {
    float* column = packed + l.forward + o / kFloats * l.in * kFloats + o % kFloats;
    for (int64_t i = 0; i < l.in; ++i) column[i * kFloats] = weight[i];
    for (int64_t i = 0; i < l.in; i += kFloats)
      std::copy_n(weight + i, std::min<int64_t>(kFloats, l.in - i), packed + l.backward + i * l.out + o * kFloats);
  }
  float* vectors = packed + l.vectors;
  std::copy_n(given + l.bias, l.out, vectors);
  if (!l.norm) return;
  std::copy_n(given + l.gain, l.out, vectors + padded(l.out));
  std::copy_n(given + l.shift, l.out, vectors + 2 * padded(l.out));
}

static void unpad(const NetLayer& l, const float* sums, float* gradient) {
  for (int64_t o = 0; o < l.out; ++o) std::copy_n(sums + l.weight_sum + o * padded(l.in), l.in, gradient + l.weight + o * l.in);
  std::copy_n(sums + l.bias_sum, l.out, gradient + l.bias);
  if (!l.norm) return;
  std::copy_n(sums + l.gain_sum, l.out, gradient + l.gain);
  std::copy_n(sums + l.gain_sum + padded(l.out), l.out, gradient + l.shift);
}

// Weights as they are at one time, packed for the hot code.
class NetWeights {
 public:
  NetWeights(const NetWeights&) = delete;  // its layers are pointed at
  NetWeights(std::vector<int64_t> widths, bool norm, Floats parameters, const std::string& isa)
      : net_(layout(widths, norm, layers_)), backend_(find_isa(isa).nets), packed_(net_.packed, 0.0f) {
    if (parameters.ndim() != 1 || int64_t(parameters.shape(0)) != net_.parameters)
      refuse("give " + std::to_string(net_.parameters) + " parameters in one vector");
    for (const NetLayer& l : layers_) pack(l, parameters.data(), packed_.data());
  }

  nb::tuple forward(Floats x, bool keep) const {
    size_t rows = rows_of(x, "x", layers_.front().in), blocks = (rows + kNetRows - 1) / kNetRows;
    float *y, *tape = nullptr;
    nb::object out = nb::cast(make_array<float>({rows, size_t(layers_.back().out)}, &y)), kept = nb::none();
    if (keep) kept = nb::cast(make_array<float>({blocks, size_t(net_.kept)}, &tape));
    backend_.forward(net_, packed_.data(), x.data(), int64_t(rows), y, tape, work(net_.work));
    return nb::make_tuple(out, kept);
  }

  nb::tuple backward(Floats x, Floats tape, Floats gy, bool want_x, bool want_parameters) const {
    size_t rows = rows_of(x, "x", layers_.front().in), blocks = (rows + kNetRows - 1) / kNetRows;
    if (rows_of(gy, "gy", layers_.back().out) != rows || rows_of(tape, "tape", net_.kept) != blocks)
      refuse("x, tape and gy are not of the same forward pass");
    float *gx = nullptr, *gradient = nullptr;
    nb::object inputs = nb::none(), parameters = nb::none();
    if (want_x) inputs = nb::cast(make_array<float>({rows, x.shape(1)}, &gx));
    if (want_parameters) parameters = nb::cast(make_array<float>({size_t(net_.parameters)}, &gradient));
    float *own = work(net_.work + net_.sums), *sums = want_parameters ? own + net_.work : nullptr;
    backend_.backward(net_, packed_.data(), x.data(), int64_t(rows), tape.data(), gy.data(), gx, sums, own);
    if (want_parameters)
      for (const NetLayer& l : layers_) unpad(l, sums, gradient);
    return nb::make_tuple(inputs, parameters);
  }

 private:
  static size_t rows_of(const Floats& a, const char* name, int64_t width) {
    if (a.ndim() != 2 || int64_t(a.shape(1)) != width) refuse(std::string(name) + " needs rows of " + std::to_string(width) + " numbers");
    return a.shape(0);
  }

  static float* work(int64_t floats) {
    static thread_local Memory memory;
    return static_cast<float*>(memory.reserve(sizeof(float) * size_t(floats)));
  }

  std::vector<NetLayer> layers_;
  Net net_;
  const NetBackend& backend_;
  std::vector<float> packed_;
};

void bind_nets(nb::module_& module) {
  using namespace nb::literals;
  nb::class_<NetWeights>(module, "NetWeights", "Weights of a small net at one time; see cmbrl.train.policies.net.")
      .def(nb::init<std::vector<int64_t>, bool, Floats, const std::string&>(), "widths"_a, "norm"_a, "parameters"_a, "isa"_a = "")
      .def("forward", &NetWeights::forward, "x"_a, "keep"_a)
      .def("backward", &NetWeights::backward, "x"_a, "tape"_a, "gy"_a, "want_x"_a, "want_parameters"_a);
}

}  // namespace cmbrl
