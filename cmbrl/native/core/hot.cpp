// The core for one instruction set (CMBRL_ISA). Compiled once per set.
#include "step/bodies.hpp"
#include "step/loss.hpp"
#include "step/passes.hpp"
#include "step/quantities.hpp"
#include "step/survey.hpp"
#include "step/windows.hpp"

namespace cmbrl::CMBRL_ISA {

extern const Backend backend;
const Backend backend = {
#define CMBRL_STR2(x) #x
#define CMBRL_STR(x) CMBRL_STR2(x)
    CMBRL_STR(CMBRL_ISA), W,
    [](const Model& m, Purpose p) { return m.planar ? bytes_of<Planar>(m, p) : bytes_of<Spatial>(m, p); },
    [](const Model& m, const Options& o) { return tape_stride(m) * o.solves(); },
    [](const Model& m, const Options& o, const Batch& b, int64_t s, int64_t e, StepMemory& w) {
      m.planar ? survey<Planar>(m, o, b, s, e, w) : survey<Spatial>(m, o, b, s, e, w);
    },
    [](const Model& m, const Options& o, const Batch& b, const int64_t* x, int64_t s, int64_t e, StepMemory& w) {
      m.planar ? forward_packs<Planar>(m, o, b, x, s, e, w) : forward_packs<Spatial>(m, o, b, x, s, e, w);
    },
    [](const Model& m, const Options& o, const Batch& b, const int64_t* x, int64_t s, int64_t e, StepMemory& w) {
      m.planar ? backward_packs<Planar>(m, o, b, x, s, e, w) : backward_packs<Spatial>(m, o, b, x, s, e, w);
    },
    [](const Model& m, const Options& o, const LossBatch& b, int64_t first, int64_t s, int64_t e, StepMemory& w) {
      m.planar ? candidate_loss<Planar>(m, o, b, first, s, e, w) : candidate_loss<Spatial>(m, o, b, first, s, e, w);
    },
    [](const Model& m, const Options& o, const WindowBatch& b, int64_t s, int64_t e, StepMemory& w) {
      m.planar ? window_packs<Planar>(m, o, b, s, e, w) : window_packs<Spatial>(m, o, b, s, e, w);
    },
    [](const Model& m, const Options& o, const Batch& b, double* M, double* bias, double* length, double* gap, double* J, int64_t s, int64_t e, StepMemory& w) {
      m.planar ? smooth_quantities<Planar>(m, o, b, M, bias, length, gap, J, s, e, w)
               : smooth_quantities<Spatial>(m, o, b, M, bias, length, gap, J, s, e, w);
    },
    [](const Model& m, const double* theta, double* out, StepMemory& w) { m.planar ? weights_at<Planar>(m, theta, out, w) : weights_at<Spatial>(m, theta, out, w); },
    [](const Model& m, const Options& o, const Batch& b, const RowBatch& out, int64_t s, int64_t e, StepMemory& w) {
      m.planar ? step_rows<Planar>(m, o, b, out, s, e, w) : step_rows<Spatial>(m, o, b, out, s, e, w);
    },
    [](const Model& m, const Batch& b, const BodyBatch& out, int64_t s, int64_t e, StepMemory& w) {
      m.planar ? body_motions<Planar>(m, b, out, s, e, w) : body_motions<Spatial>(m, b, out, s, e, w);
    },
    [](const Model& m, const Batch& b, const BodyBatch& out, int64_t s, int64_t e, StepMemory& w) {
      m.planar ? body_motions_backward<Planar>(m, b, out, s, e, w) : body_motions_backward<Spatial>(m, b, out, s, e, w);
    },
};

}  // namespace cmbrl::CMBRL_ISA
