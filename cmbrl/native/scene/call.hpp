// What the core needs to know of one call: its options, what it reads and writes, and the entry points of an instruction set.
// Plain as model.hpp is, for the same reason.
#pragma once
#include "scene/model.hpp"

namespace cmbrl {

class TapeRows;
struct StepMemory;

// What a call needs room for: steps; products with derivatives of steps; whole Jacobians.
enum class Purpose { step, product, jacobian };

enum SmoothingMode { kConstant = 0, kGaussian = 1, kScaled = 2, kNearest = 3 };
struct Smoothing {
  int mode;
  double kappa;   // [J]: constant, or peak of the published adaptive rule
  double floor;   // [m^2/s^2]: kappa of a row times its inverse weight, at least
  double dry;     // [rad/s or m/s]: kappa of dry friction by its largest impulse
  double length;  // [m]: of the Gaussian schedule; reach of the published rule
  int stop;       // 1: kappa is a constant to the derivative
};

struct Options {
  double h;
  int substeps, leapfrog, midpoint, implicit_springs;  // midpoint: velocity-dependent forces half a step ahead
  int rk4;           // four stages a step, in which nothing is implicit (rk4.hpp)
  int solves() const { return rk4 ? 4 * substeps : substeps; }  // of a control step
  int split;         // damping is explicit to the rows, and implicit afterwards (split.hpp)
  bool apart() const { return split || rk4; }  // nothing that damps is implicit to the rows
  int convex;        // contacts slide by the convex law (newton.hpp), not by Coulomb's
  int both_ways;     // candidates act wherever rows look ahead or do not: gaps are wanted of all of them
  int look_ahead;    // soft contacts and limits act if they would close within the step; otherwise once they have, as in MuJoCo
  Smoothing forward, backward;
  double prune;      // [m/s] rows predicted to separate faster are left out; infinity keeps all
  double tolerance;  // relative, on the linear residuals; products to within theta * kappa
  double theta;
  int max_iterations;
  double rest_speed;  // [m/s] approach speeds below it do not bounce
  int backward_differs;  // from forward
  bool (*stopped)();     // asked between packs, and in long control steps: the caller gave up, so no result is needed
  int set_aside;      // lanes with many more rows than the others are not stepped with them
  int admit;          // rows that were left out and close are let in by their names; otherwise the lane is stepped again
  int again;          // elements were stepped before, as far as v_next, under which rows that were left out close
  int last_attempt;   // a lane that fails has failed; otherwise it is stepped again
  unsigned rungs;     // of the solver's ladder that may be climbed, as bits; the first is always
};

// Where leaving out rows that separate faster than `prune` was too slow.
static inline double wider(double prune) { return prune < 1e3 ? __builtin_fmax(10 * prune, 1) : __builtin_inf(); }

// Statuses of elements that are to be stepped again: a solve needs the ladder, a row that was left out closes, there are many more
// rows than the rest of the pack has.
enum Unfinished { kUnsolved = -1, kMissed = -2, kCrowded = -3 };

// Everything one element of a batch reads and writes; null where the caller does not want it. Strides are rows of C arrays.
struct Batch {
  int64_t n;
  const double *q, *v, *u, *theta;
  int64_t q_stride, v_stride, u_stride, theta_stride;  // 0: shared by all elements
  double *q_next, *v_next;
  int32_t *status, *iterations, *rung;  // status: 0 converged, 1 softer than the model, 2 failed or from an input that is not finite
  double *residual, *impulse;    // impulse (n, ncontact, 1 + NT): normal, tangents, summed over the substeps [N s]
  const int64_t *wanted;         // parameters to differentiate by
  int64_t nwanted;
  double *jacobian;              // (n, 2 nv, 2 nv + nu + nwanted)
  double *tape;                  // (n, tape_size), written by the forward pass and read by the backward pass
  TapeRows *tape_rows;           // what of it follows the contacts that are on
  const double *gq_next, *gv_next;  // cotangents (tangent space for q)
  double *gq, *gv, *gu, *gtheta;  // gtheta (n, nwanted)
};

struct LossBatch {  // mean Huber loss of open-loop predictions, candidate by candidate
  int64_t ncandidate, nstart;
  int horizon;
  const double *q, *v;  // where windows start: (nstart, ...), or (ncandidate, nstart, ...) if each candidate has its own
  int64_t own;          // windows from one candidate's states to the next one's: 0 or nstart
  const double *u, *q_next, *v_next, *theta, *scale_q, *scale_v;
  const int64_t *starts;
  double huber, fail_penalty;
  double *loss;  // (ncandidate, nstart): summed over steps and coordinates; the caller averages in order
};

struct WindowBatch {  // open-loop predictions and their derivatives: by columns that are given, of which the last ones move controls, and parameters
  int64_t nstart;
  int horizon;
  const double *q, *v, *u, *theta;  // where windows start (nstart, ...), controls of the log's rows, one parameter vector
  const int64_t *starts, *wanted;
  int64_t nbefore, ndriven, nwanted, nrow;
  const double *begun, *driven;  // tangents of the starts (2 nv, nbefore), and of the controls (rows, nu, ndriven)
  const int64_t *rows;           // of (q, v), whose tangents are asked for
  double *q_next, *v_next;       // (nstart, horizon, ...)
  double *tangents;              // (nstart, nbefore + nwanted, horizon, nrow), but for columns that `told` (nstart, nwanted) lacks: zeros, or nothing
  uint8_t *told;
};

constexpr int kEdges = 10;  // of a pyramid of friction, at most (edges.hpp)

// What a physics step asks of its contacts, limits last, as arrays over all candidates, nrow = rows_a_contact ncontact + nlimit;
// active: 0 pruned.
struct RowBatch {
  int rows_a_contact;        // 1; where pyramids have rows of their own, the whole contact and then its edges
  int rows;                  // of each: normal, tangents, and those that turn where some contact has them
  double *M, *v_free;        // (n, nv, nv) with armature and implicit damping, (n, nv)
  double *J, *b, *mu, *R;    // (n, nrow, rows, nv), (n, nrow, rows), (n, nrow), (n, nrow, rows)
  int32_t *active, *convex;  // (n, nrow)
};

struct BodyBatch {  // motions of `count` bodies (n, count, fields), or cotangents of them; fields: see bodies.hpp
  int count;
  const int32_t* bodies;
  double* motion;
  const double* cotangent;
};

struct Backend {  // one per instruction set
  const char* name;
  int width;
  int64_t (*workspace_size)(const Model&, Purpose);  // bytes, without what grows with the rows that are active
  int64_t (*tape_size)(const Model&, const Options&);       // doubles per element, without what follows the contacts that are on
  void (*survey)(const Model&, const Options&, const Batch&, int64_t begin, int64_t end, StepMemory&);  // see survey.hpp
  // elements: those numbered begin to end of this list; of the batch itself if there is none
  void (*forward)(const Model&, const Options&, const Batch&, const int64_t* elements, int64_t begin, int64_t end, StepMemory&);
  void (*backward)(const Model&, const Options&, const Batch&, const int64_t* elements, int64_t begin, int64_t end, StepMemory&);
  void (*loss)(const Model&, const Options&, const LossBatch&, int64_t candidate_pack, int64_t begin, int64_t end, StepMemory&);
  void (*windows)(const Model&, const Options&, const WindowBatch&, int64_t begin, int64_t end, StepMemory&);
  void (*dynamics)(const Model&, const Options&, const Batch&, double* M, double* bias, double* length, double* gap, double* J, int64_t begin, int64_t end, StepMemory&);
  void (*weights)(const Model&, const double* theta, double* out, StepMemory&);  // factors (nweight,) on inverse weights
  void (*rows)(const Model&, const Options&, const Batch&, const RowBatch&, int64_t begin, int64_t end, StepMemory&);
  void (*bodies)(const Model&, const Batch&, const BodyBatch&, int64_t begin, int64_t end, StepMemory&);
  void (*bodies_backward)(const Model&, const Batch&, const BodyBatch&, int64_t begin, int64_t end, StepMemory&);
};

}  // namespace cmbrl
