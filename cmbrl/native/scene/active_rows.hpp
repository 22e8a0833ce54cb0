// What a step knows of a contact, a limit, dry friction or a tie of a pack, and of the rows that it left out.
#pragma once
#include "base/algebra.hpp"
#include "scene/model.hpp"

namespace cmbrl::CMBRL_ISA {

// Closest features of a candidate: point on A's core shape, unit normal from B to A, distance between the core shapes, and
// which directions of B's (and A's) shape the closest point is free to follow. What a kind of candidate has not is zero.
template <class G>
struct Feature {
  typename G::V a, n, axisA, axisB, beside;
  T dist, free_s, free_t;           // free_*: 1 where the segment parameter is not clamped
  Vec<G::V::size * G::V::size> slide;  // projection onto B's free directions (point against segment or box)
  T turns;                          // 1 where the normal turns as A moves
  T linear, held, leans, back;      // of hulls (hull_sides.hpp): 1 where slide and the rise, in axisA, say all; where n or `beside` turns with A
  T bends;                          // 1 where slide and the axes say how a touch of round shapes moves (bends.hpp)
};

// A frame on B as that of A's body sees it: coordinate k of a point x of A is base[k] + up[k] x. axis: in the world.
template <class G>
struct FrameInA {
  typename G::V axis[G::D], up[G::D];
  T base[G::D];
  T along(int k, const typename G::V& x) const { return base[k] + dot(up[k], x); }
};
// Of two boxes, the side of B that A's corners are over (corner.hpp): that along the axis that is chosen.
template <class G>
struct SideUnderCorners {
  int pair, A;
  FrameInA<G> frame;
  const double* half;
  T side[G::D];
  Mask chosen[G::D];
  typename G::V normal;
};

// What is found of a contact before any solve; a lane takes all of it from one candidate. Here and in Contact, what a contact of one
// row needs in a solve stands together: many contacts then take few pages of memory.
template <class G>
struct Found {
  T P[kContactFields];               // its part of the physical vector
  T radiusA;
  Feature<G> at;
  T arm[3];                          // [m] of rows that turn (turning.hpp), about the normal and the tangents
  typename G::V p, d[1 + G::NT];     // point and directions (normal, tangents); of an edge: its own, and its tangent
  T dc_dphi, dRn_dphi, dRt_dphi;     // of the law, at fixed impulses
  T phi, mu, Rn, Rt, carry, cn0;
  T root, full_mu;                   // root of inverse weight and compliance; mu itself may be a share of the full one
  Vec<G::N> Wr[1 + G::MT];           // wrench of a unit impulse along each of its directions, then of the rows that turn
};

// All that is known of a contact before any solve. Lanes may have different candidates, of one kin: those that differ only in what
// Found holds (candidates.hpp).
template <class G>
struct Known : Found<G> {
  Mask on, wide, rub;                // lanes in which the contact takes part; in the derivative's solve; in which it has friction
  int of[W], index, rows;            // candidate numbers by lane, and the first of them; 1, or 1 + NT to 1 + MT
  bool segments, hulls;              // in some lane
  bool skewed;                       // friction differs by direction (edges.hpp)
  Mask convex;                       // lanes in which the convex law of sliding holds (newton.hpp); none unless the options say so
  int edge;                          // of MuJoCo's pyramid (edges.hpp), from 1; 0: the whole contact
};

// One contact of a pack in the interior point and in the derivative.
template <class G>
struct Contact : Known<G> {
  T kappa, own_kappa, raised_kappa;  // the ladder may raise kappa above what the model asks for
  T slope, slope_R;                  // d kappa by the free closing coordinate z and by Rn
  T gam, s, r1, dgam, ds;            // r: linear residuals at the start; they shrink by exactly (1 - alpha)
  T ipn, t50, eta0, deta0;
  T w[1 + G::MT], Th[1 + G::MT][1 + G::MT];  // dx = w - Th J dv
  T b[G::MT], eta[G::MT], r2[G::MT], db[G::MT], deta[G::MT], ct0[G::MT];
  T Ai[G::MT][G::MT], ta[G::MT], gA[G::MT];  // parts of Th, as ipn, for sensitivities to kappa and mu; gA under the convex law
  Mask bounce;                       // lanes in which it bounces in this step
  T time, speed;                     // from here to its impact [s], approach speed
  T by_free, by_start, by_gap, by_flight, by_e;  // d cn0 of a bounce by J vf, J v, gap, time of flight and restitution
};

// One that an actuator pulls at (adhesion.hpp), and which share of its force.
template <class G>
struct Grip { Contact<G> contact; int actuator; T share; };

struct Direction {  // of a limit: along a line, in one sense; round: by the angle of a ball joint, whose last dof the line is
  int line;
  bool round;
  T sign, axis[3];
};

struct Limit : Direction {  // of a joint or a tendon: a normal law along one line
  Mask on, wide;
  int index;
  T root, phi, R, carry, c0, dc_dphi, dR_dphi, kappa, own_kappa, raised_kappa, slope, slope_R, gam, s, r1, w, Th, dgam, ds;
};

struct DryFriction {  // friction loss of a joint or a tendon: a cone of fixed head along one line
  Mask on;
  int line;
  T root, R, carry, c0, b0, ib0, kappa, b, eta0, eta, r2, t50, w, Th, db, deta0, deta;
};

// An equality constraint (ties.hpp).
template <class G>
struct Tie {
  static constexpr int kRows = G::D + G::A;  // at most
  int rows;
  T r[kRows], dsize[kRows], inv[kRows];      // residual, how its size grows with it, 1 / R
  T stiff, dstiff, dR, carry;                // h K d, its derivative by that size; R's, relative
  T sway[kRows];                             // h dJ/dt v: what bodies that do not accelerate change of J v in the step
  T slope, bend;                             // of the polynomial
  typename G::V a, b;                        // points that the bodies hold
  typename G::Rot turned;                    // frame of B
  T w; typename G::Ang v;                    // half the turn of A against it
};

// A row that is left out: in which lanes, its slack without the part of the next velocity, and the speed that it had to have.
template <class G>
struct LeftOut { Mask lanes; int A, B; Vec<G::N> W; T base; double speed; };
constexpr int kGuesses = 5;  // the free velocity, and solves of a step with rows that were left out; then all of its rows are let in
struct LeftOutLimit { Mask lanes; Direction way; T base; double speed; };

struct Input { T value, by_command, by_activation, by_time; };  // of a gain, and its slope in what it follows from
struct Passed { int A, B; T slack; };         // a cluster that is not looked at; of its rows, under the velocity at the start
// A candidate, or an edge of it, that is a row in these lanes, whatever it is like; where its touch stands on the tape, of hulls.
struct Given { int index, edge; Mask on; const double* touch[W]; };
struct ActiveGroup { int group, begin, end; };  // contacts of one body pair stand together

}  // namespace cmbrl::CMBRL_ISA
