// Scratch memory of one thread: every array of one step of one pack. What follows the scene is carved from one arena; what
// follows the rows that are active grows with them.
#pragma once
#include "base/fill.hpp"
#include "base/memory.hpp"
#include "scene/active_rows.hpp"
#include "scene/call.hpp"
#include "scene/packed.hpp"

namespace cmbrl::CMBRL_ISA {

struct Arena {
  char* base;
  int64_t used = 0;
  template <class X> X* take(int64_t n) {
    X* p = reinterpret_cast<X*>(base + used);
    used += (n * int64_t(sizeof(X)) + 63) / 64 * 64;
    return p;
  }
};

// What the contact solve works on.
template <class G>
struct SolverWork {
  T *vf, *vn, *delta, *rhs, *rv;           // free and next velocity, their difference, direction, momentum residual
  T *M, *H, *H0;                           // packed: M along the tree, H and H0 along the pattern of the step
  Vec<G::N>* S;                            // unit twists of the dofs
  T* line_c;                               // covectors of lines, by entry of line_dof
  Vec<G::N>* pulls;                        // scratch, by dof of a group
  uint8_t *dynamic; int *dyn_list; int ndyn;
  uint8_t* skew;                           // dofs whose rows of H friction of contacts makes unsymmetric
  Below below;                             // the factor by columns, of dynamic rows
  Contact<G>* con; int ncon;
  Limit* lim; int nlim;
  DryFriction* dry; int ndry;
  ActiveGroup* groups; int ngroups;
  bool coupled; Pattern fill;              // a contact between two moving bodies is active; pattern of the factor then
  int lanes = W;                           // the others are copies of the last of them; of one, they may try several things at once
  T *save, *path;                          // solver state of lanes that are done while others are retried; of a continuation

  void take(Arena& A, int64_t nv, int64_t mass_entries, int64_t columns, int64_t group_dofs, int64_t limits, int64_t dry_rows) {
    vf = A.take<T>(nv); vn = A.take<T>(nv);
    delta = A.take<T>(nv); rhs = A.take<T>(nv); rv = A.take<T>(nv);
    M = A.take<T>(mass_entries);
    S = A.take<Vec<G::N>>(columns); pulls = A.take<Vec<G::N>>(group_dofs);
    dynamic = A.take<uint8_t>(nv); skew = A.take<uint8_t>(nv); dyn_list = A.take<int>(nv);
    lim = A.take<Limit>(limits); dry = A.take<DryFriction>(dry_rows);
  }
  void take_contacts(Arena& A, int64_t contacts) {
    con = A.take<Contact<G>>(contacts);
    groups = A.take<ActiveGroup>(contacts);
  }
  void take_factor(Arena& A, int64_t nv, int64_t columns) {
    H = A.take<T>(nv + 2 * columns); H0 = A.take<T>(nv + 2 * columns);
    below.take(A, nv, columns);
  }
  void take_state(Arena& A, int64_t nv, int64_t contacts, int64_t limits, int64_t dry_rows) {
    int64_t state = nv + 3 * dry_rows + contacts * (3 + 2 * G::MT) + limits * 2;
    save = A.take<T>(state); path = A.take<T>(3 * state);
  }
};

// A segment around something: its ends, its length, and how that changes with the ends, in the obstacle's frame.
template <class G>
struct Bent { typename G::V a, b, g[2]; T length, H[6][6]; };

// A linkage (linkages.hpp): its ends; the wrench on A in world axes, or in its place the slider's axis; how the rotation's part of the
// length changes as A turns, and that part; of a slider-crank, how far the crank is along the axis, and one over its root.
template <class G>
struct Linkage { typename G::V a, b, force, torque, slope; T angle, reach, inverse; };

template <class G>
struct Work : SolverWork<G> {
  using V = typename G::V;
  using Motion = Vec<G::N>;
  StepMemory* memory;                      // where what grows stands
  T *P, *q, *v, *u, *vstep, *start;        // parameters but those of contacts, state, control, next velocity; state to go back to
  T *dtheta, radius_slack;                 // parameters less their nominal values; most that they add to a radius
  T *weight, *weight_slope, *weight_pull;  // factors on inverse weights; by them, changes with parameters, pulls of softer rows by dof
  uint8_t* weight_pulls;                   // those that have such pulls (inverse_weight.hpp)
  bool softens = false;                    // some parameter of inertia has a column
  int* inertia_body;                       // the bodies of parameters of inertia,
  Inertia<G>* inertia_change;              // and what they do to them at qpos0
  typename G::Rot* R; V* pos;              // bodies, relative to O
  Inertia<G> *I, *Ic;
  Motion *vel, *acc, *fc, *psid, *psidd, *sdot, *vlam, *tn, *tnlam;  // tn: twists under the next velocity
  T* Xc; V* momc;
  T *bias, *tau, *a, *kd, *kp, *open, *tmp;
  Input* inputs; int substep = 0;          // of actuators with a state (activation.hpp), at this substep
  T *drive, *drive_kp;                     // of the actuators of a line, without springs
  Mask* yields;                            // lanes in which the actuators of a dof are not clamped by its joint
  T *lift, *lift_mass; V* lift_moment;     // gravity compensation, by dof and by body
  Motion* wide_wrench; T* wide_push;       // of actuators on several dofs: unit wrench, force times gear
  Grip<G>* grips; int ngrips = 0;          // contacts that some of them pull at
  Motion* drag; T *drag_start, *drag_end;  // of a fluid, by body, and by its twists before and after the step
  T* stretch;                              // of springs at ball joints
  T *D, *K;                                // of split damping (split.hpp): packed as M; the factor of M + D
  T *gyro_q, *gyro_v, *gyro_x;             // of implicit Coriolis forces (gyro.hpp): scratch;
  double gyro_weight;                      // what the bias at hand counts
  T* free_factor;                          // of M~ along the tree, without rows
  T *line_length, *line_pull, *line_mass;  // impulse along each line at the step's start; what acts on its change of rate
  Bent<G>* bent;                           // segments around something (lines.hpp)
  Linkage<G>* linkages; T* line_slope;     // and, by entry of line_dof, how the lengths of lines change
  Tie<G>* ties; T* tie_J;                  // equality constraints; their rows, by entry of tie_dof
  Motion *drift, *drift_before;            // accelerations of bodies whose joints do not accelerate; before each dof's joint
  int *kin_count, *kin_slots;              // of each kin in the group at hand: contacts by lane; where those contacts stand
  Given* given; int ngiven;                // rows of a step that is read back from its tape: contacts by group, then by number;
  Mask* lim_on;                            // limits
  uint64_t* near; int* order;              // groups that may touch in this step, as bits; bodies along an axis
  typename G::V* centre; T *fast, *after, *reach; double *low, *high;  // of bodies: spheres that hold what may touch in this step
  LeftOut<G>* left; int nleft;             // see pruning.hpp
  T* guess; Motion* guess_twist; int nguess;  // velocities that rows are left out by: the free one, and those that solves of this step
                                           // ended with, under which left-out rows close
  T* tried = nullptr;                      // the velocity that an earlier attempt at this step ended with, if there was one
  LeftOutLimit* left_lim; int nleft_lim;
  Passed* passed; int npassed;          // see near.hpp
  bool sift;                               // clusters are tested
  bool by_sides; int side_of;              // meshes touch planes with corners of a side (side.hpp): those at hand, of which pair of geoms
  V side[4]; Mask side_there[4];
  int touch_of; Feature<G>* touch; Mask* touch_there;  // the same of hulls with each other (hull_contact.hpp)
  bool prisms;                             // a height field is touched as MuJoCo's (field_contact.hpp)
  T sight;                                 // [m] how far ahead rows look at the height field at hand (field_contact.hpp)
  SideUnderCorners<G> under;
  FrameInA<G> frame; int frame_of;         // along what clusters on one shape have around it (sieve.hpp): that of which of them
  Mask may_touch;                          // lanes in which those of the cluster at hand may overlap
  T left_out_gap;                          // smallest absolute gap of a contact that was left out
  uint64_t* bits; int *fill_ptr, *fill_idx;  // the pattern as bits, and as lists
  Below below_H, below_K;                  // both factors by columns
  T* vb; Motion *bvel, *bacc;          // where the bias is taken in a midpoint step: velocity, its twists and accelerations
  T *C, *Bq, *Bv, *Bu, *Bp;            // -h dbias/dv there; dvb = Bq dq + Bv dv + Bu du + Bp dtheta
  bool ahead;                          // smooth terms and parameters take the bias at vb
  T *Gq, *Gv, *Gu, *Gp;                // right-hand sides of the implicit derivative
  T *Fq, *Fv, *Fu, *Fp;                    // the same for the free velocity: M~ dvf = Fq dq + ...
  T *Sq, *Sv, *Su, *Sp, *Sn;               // M~ dshift = Sq dq + ... + Sn dv' (impacts at their time)
  T* Z;                                    // rows' free closing speeds by (q, v, u, theta)
  bool early, late;                        // the step has rows that look at vf; impulses that act late in it
  bool leapt;                              // the step flies to an impact first (flight.hpp)
  int np, *column, *parameter;             // columns of parameters; that of each, and what each is of (columns.hpp)
  T flown, *leap, *began;                  // for how long [s], how far, and from where
  T *Lq, *Lv, *Lu, *Lp, *dflown;           // dleap = Lq dq + Lv dv + Lu du + Lp dtheta, and the row of dflown
  T *qtan, *shift;                         // position correction of impacts at their time, integration scratch
  T* eased;                                // what the damping in M~ acts on where the derivative looks at M~ shift
  T *tq, *tv, *rhs_all;                     // tangents carried through substeps (nv x ncol)
  int nbefore;                             // their columns before those of parameters: (q, v, u) of a control step
  const T* driven; int ndriven;            // or some of a window, of which the last ones move controls so (nu x ndriven)
  int64_t most_tangents;                   // columns that they may have
  T *tangent_block, *gathered;             // some columns of them
  T *lq, *lv, *lu, *lp, *pvec;             // cotangents
  Vec<G::N>* Y;
  V O;

  // Swaps what belongs to v with what belongs to vb, for inverse dynamics there.
  void swap_velocity() {
    T* x = v; v = vb; vb = x;
    Motion* y = vel; vel = bvel; bvel = y;
    y = acc; acc = bacc; bacc = y;
  }

  // One more contact, after those that are there.
  Contact<G>& add_contact() {
    this->con = static_cast<Contact<G>*>(memory->contacts.extend((this->ncon + 1) * sizeof(Contact<G>)));
    return this->con[this->ncon++];
  }
  Grip<G>& add_grip() {
    grips = static_cast<Grip<G>*>(memory->grips.extend((ngrips + 1) * sizeof(Grip<G>)));
    return grips[ngrips++];
  }
  void add_group(ActiveGroup group) {
    this->groups = static_cast<ActiveGroup*>(memory->groups.extend((this->ngroups + 1) * sizeof(ActiveGroup)));
    this->groups[this->ngroups++] = group;
  }
  void give(const Given& row) {
    given = static_cast<Given*>(memory->given.extend((ngiven + 1) * sizeof(Given)));
    given[ngiven++] = row;
  }
  void leave_out(const LeftOut<G>& row) {
    left = static_cast<LeftOut<G>*>(memory->left.extend((nleft + 1) * sizeof(LeftOut<G>)));
    left[nleft++] = row;
  }
  void pass_over(const Passed& cluster) {
    passed = static_cast<Passed*>(memory->passed.extend((npassed + 1) * sizeof(Passed)));
    passed[npassed++] = cluster;
  }
  template <class Take> static void carve(Memory& memory, Take take) {
    Arena probe{nullptr};
    take(probe);
    Arena arena{static_cast<char*>(memory.reserve(probe.used))};
    take(arena);
  }
  // Room for the factors, once the pattern is known, and for what the rows need, once they are.
  void make_factor(int64_t nv, int64_t columns) {
    carve(memory->factor, [&](Arena& A) {
      this->take_factor(A, nv, columns);
      below_H.take(A, nv, columns); below_K.take(A, nv, columns);
      fill_idx = A.take<int>(columns);
    });
  }
  void make_rows(const Model& m) {
    int64_t closing = 2 * int64_t(this->ncon) + this->nlim + 1;
    if (closing < 2 * m.nv) closing = 2 * m.nv;
    carve(memory->rows, [&](Arena& A) {
      this->take_state(A, m.nv, this->ncon, this->nlim, this->ndry);
      Z = Gq ? A.take<T>(closing * most_tangents) : nullptr;
    });
  }

  Work(Arena& A, const Model& m, Purpose purpose, StepMemory* growing) : memory(growing) {
    int64_t nv = m.nv, nb = m.nbody, ncol = 2 * nv + m.nu + m.ntheta, words = FillPattern::words(m.ngroup);  // past an int, perhaps
    P = A.take<T>(m.oContact); dtheta = A.take<T>(m.ntheta + 1); weight = A.take<T>(m.nweight);
    q = A.take<T>(m.nq); v = A.take<T>(nv); u = A.take<T>(m.nu + 1);
    vstep = A.take<T>(nv); start = A.take<T>(m.nq + nv);
    this->take(A, nv, m.mass.row(m.nv), nv, m.max_group_dofs, m.nlimit, m.nline);
    R = A.take<typename G::Rot>(nb); pos = A.take<V>(nb);
    I = A.take<Inertia<G>>(nb); Ic = A.take<Inertia<G>>(nb);
    vel = A.take<Motion>(nb); acc = A.take<Motion>(nb); fc = A.take<Motion>(nb); tn = A.take<Motion>(nb);
    psid = A.take<Motion>(nv); psidd = A.take<Motion>(nv); sdot = A.take<Motion>(nv);
    vlam = A.take<Motion>(nv); tnlam = A.take<Motion>(nv);
    Xc = A.take<T>(nb * G::NX); momc = A.take<V>(nb);
    bias = A.take<T>(nv); tau = A.take<T>(m.nline); a = A.take<T>(nv); kd = A.take<T>(m.nline); kp = A.take<T>(m.nline); open = A.take<T>(m.nu + 1); inputs = A.take<Input>(m.nstate);
    tmp = A.take<T>(nv); yields = A.take<Mask>(nv); drive = A.take<T>(m.nline); drive_kp = A.take<T>(m.nline);
    this->line_c = A.take<T>(m.line_ptr[m.nline]);
    D = A.take<T>(m.mass.row(m.nv)); free_factor = A.take<T>(m.mass.row(m.nv)); K = A.take<T>(m.mass.row(m.nv));
    line_length = A.take<T>(m.nline); line_pull = A.take<T>(m.nline); line_mass = A.take<T>(m.nline);
    if (m.nlift > 0) { lift = A.take<T>(nv); lift_mass = A.take<T>(nb); lift_moment = A.take<V>(nb); }
    if (m.ngyro > 0) { gyro_q = A.take<T>(nv * nv); gyro_v = A.take<T>(nv * nv); gyro_x = A.take<T>(nv); }
    if (m.nwide > 0) { wide_wrench = A.take<Motion>(m.nwide); wide_push = A.take<T>(m.nwide); }
    if (m.in_fluid()) { drag = A.take<Motion>(nb); drag_start = A.take<T>(nb * G::N * G::N); drag_end = A.take<T>(nb * G::N * G::N); }
    if (m.nballspring > 0) stretch = A.take<T>(nv);
    if (m.nwrap > 0) bent = A.take<Bent<G>>(m.nwrap);
    if (m.nlink > 0) { linkages = A.take<Linkage<G>>(m.nlink); line_slope = A.take<T>(m.line_ptr[m.nline]); }
    touch = A.take<Feature<G>>(m.most_touches); touch_there = A.take<Mask>(m.most_touches);
    ties = A.take<Tie<G>>(m.ntie); tie_J = A.take<T>(m.ntie ? int64_t(m.tie_ptr[m.ntie]) * Tie<G>::kRows : 0);
    drift = A.take<Motion>(m.ntie ? nb : 0); drift_before = A.take<Motion>(m.ntie ? nv : 0);
    near = A.take<uint64_t>(words); kin_count = A.take<int>(W * int64_t(m.nkin)); kin_slots = A.take<int>(m.ncontact); order = A.take<int>(nb);
    centre = A.take<V>(nb); fast = A.take<T>(nb); after = A.take<T>(nb); reach = A.take<T>(nb); low = A.take<double>(nb); high = A.take<double>(nb);
    bits = A.take<uint64_t>(nv * FillPattern::words(m.nv)); fill_ptr = A.take<int>(nv + 1);
    vb = A.take<T>(nv); bvel = A.take<Motion>(nb); bacc = A.take<Motion>(nb);
    left_lim = A.take<LeftOutLimit>(m.nlimit);
    guess = A.take<T>(kGuesses * nv); guess_twist = A.take<Motion>(kGuesses * nb); nguess = 0;
    qtan = A.take<T>(nv); shift = A.take<T>(nv); leap = A.take<T>(nv); began = A.take<T>(m.nq);
    leapt = false;
    np = 0;
    nbefore = 2 * m.nv + m.nu; driven = nullptr; most_tangents = ncol;
    column = A.take<int>(m.ntheta); parameter = A.take<int>(m.ntheta);
    if (purpose == Purpose::step) { Gq = nullptr; return; }
    lim_on = A.take<Mask>(m.nlimit);
    weight_slope = A.take<T>(m.weight_slopes[m.nweight]); weight_pull = A.take<T>(m.nweight * nv); weight_pulls = A.take<uint8_t>(m.nweight);
    inertia_body = A.take<int>(m.ninertial); inertia_change = A.take<Inertia<G>>(m.ninertial);
    auto block = [&](T*& q_, T*& v_, T*& u_, T*& p_) {
      q_ = A.take<T>(nv * nv); v_ = A.take<T>(nv * nv); u_ = A.take<T>(nv * (m.nu + 1)); p_ = A.take<T>(nv * (m.ntheta + 1));
    };
    C = A.take<T>(nv * nv);
    block(Gq, Gv, Gu, Gp);
    block(Bq, Bv, Bu, Bp);
    block(Fq, Fv, Fu, Fp);
    block(Sq, Sv, Su, Sp);
    block(Lq, Lv, Lu, Lp);
    dflown = A.take<T>(ncol);
    Sn = A.take<T>(nv * nv);
    lq = A.take<T>(nv); lv = A.take<T>(nv); lu = A.take<T>(m.nu + 1); lp = A.take<T>(m.ntheta + 1); pvec = A.take<T>(nv);
    Y = A.take<Vec<G::N>>(m.max_group_dofs + 1);
    int64_t tangents = purpose == Purpose::jacobian ? nv * ncol : nv;
    tq = A.take<T>(tangents); tv = A.take<T>(tangents); rhs_all = A.take<T>(tangents); tangent_block = A.take<T>(2 * nv * kBlock); gathered = A.take<T>(2 * nv * kBlock);
  }
};

}  // namespace cmbrl::CMBRL_ISA
