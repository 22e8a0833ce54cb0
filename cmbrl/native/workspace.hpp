// Scratch memory of one thread: every array of one step of one pack, carved from one arena. Sized by the scene, allocated once.
#pragma once
#include "algebra.hpp"
#include "fill.hpp"
#include "model.hpp"

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

// One contact of a pack in the interior point and in the derivative.
template <class G>
struct Contact {
  Mask on, rub;                      // lanes in which the contact takes part; in which it has friction
  int index, rows;                   // candidate number; 1 or 1 + NT
  typename G::V p, d[1 + G::NT];     // point and directions (normal, tangents)
  Vec<G::N> Wr[1 + G::NT];           // wrench of a unit impulse along each row
  T root, full_mu;                   // of the inverse weight of its rows; mu itself may be a share of the full one
  T phi, mu, Rn, Rt, carry, cn0, ct0[G::NT];
  T dc_dphi, dRn_dphi, dRt_dphi;     // of the law, at fixed impulses
  T bounce, time, speed;             // restitution applied in this step (0: none), time of impact in it [s], approach speed
  T by_free, by_start, by_gap, by_e; // d cn0 of a bounce by J vf, J v, gap and restitution
  T kappa, slope;                    // slope: d kappa / d z
  T gam, s, b[G::NT], eta0, eta[G::NT];
  T r1, r2[G::NT];                   // linear residuals at the start; they shrink by exactly (1 - alpha)
  T w[1 + G::NT], Th[1 + G::NT][1 + G::NT];  // dx = w - Th J dv
  T ipn, Ai[G::NT][G::NT], ta[G::NT];        // parts of Th, for sensitivities to kappa and mu
  T t50, dgam, ds, db[G::NT], deta0, deta[G::NT];
};

struct Limit {  // joint limit: a normal law on one coordinate
  Mask on;
  int index, dof;
  T root, sign, phi, R, carry, c0, dc_dphi, dR_dphi, kappa, slope, gam, s, r1, w, Th, dgam, ds;
};

struct DryFriction {  // joint friction loss: a cone of fixed head on one coordinate
  Mask on;
  int dof;
  T root, R, carry, c0, b0, kappa, b, eta0, eta, r2, t50, w, Th, db, deta0, deta;
};

struct ActiveGroup { int group, begin, end; };  // contacts of one body pair stand together

// What the contact solve works on.
template <class G>
struct SolverWork {
  T *vf, *vn, *delta, *rhs, *rv;           // free and next velocity, their difference, direction, momentum residual
  T *M, *H, *H0;                           // nv x nv row-major, pattern entries only
  Vec<G::N>* S;                            // unit twists of the dofs
  uint8_t *dynamic; int *dyn_list; int ndyn;
  Contact<G>* con; int ncon;
  Limit* lim; int nlim;
  DryFriction* dry; int ndry;
  ActiveGroup* groups; int ngroups;
  bool coupled; Pattern fill;              // a contact between two moving bodies is active; pattern of the factor then
  T *save, *path;                          // solver state of lanes that are done while others are retried; of a continuation

  void take(Arena& A, int64_t nv, int64_t columns, int64_t contacts, int64_t limits, int64_t dry_rows, int64_t group_count) {
    vf = A.take<T>(nv); vn = A.take<T>(nv);
    delta = A.take<T>(nv); rhs = A.take<T>(nv); rv = A.take<T>(nv);
    M = A.take<T>(nv * nv); H = A.take<T>(nv * nv); H0 = A.take<T>(nv * nv);
    S = A.take<Vec<G::N>>(columns);
    dynamic = A.take<uint8_t>(nv); dyn_list = A.take<int>(nv);
    con = A.take<Contact<G>>(contacts);
    lim = A.take<Limit>(limits); dry = A.take<DryFriction>(dry_rows);
    groups = A.take<ActiveGroup>(group_count);
    int64_t state = nv + 3 * dry_rows + contacts * (3 + 2 * G::NT) + limits * 2;
    save = A.take<T>(state); path = A.take<T>(3 * state);
  }
};

template <class G>
struct Work : SolverWork<G> {
  using V = typename G::V;
  using Motion = Vec<G::N>;
  T *P, *q, *v, *u, *vstep;                // parameters, state, control, next velocity
  typename G::Rot* R; V* pos;              // bodies, relative to O
  Inertia<G> *I, *Ic;
  Motion *vel, *acc, *f, *fc, *psid, *psidd, *sdot, *vlam, *tn, *tnlam;  // tn: twists under the next velocity
  T* Xc; V* momc;
  T *bias, *tau, *a, *kd, *kp, *open, *tmp;
  T* all_phi; Mask *con_on, *lim_on;
  uint64_t* bits; int *fill_ptr, *fill_idx;  // the pattern as bits, and as lists
  T* vb; Motion *bvel, *bacc;          // where the bias is taken in a midpoint step: velocity, its twists and accelerations
  T *C, *Bq, *Bv, *Bu, *Bp;            // -h dbias/dv there; dvb = Bq dq + Bv dv + Bu du + Bp dtheta
  bool ahead;                          // smooth terms and parameters take the bias at vb
  T *Gq, *Gv, *Gu, *Gp;                // right-hand sides of the implicit derivative
  T *Fq, *Fv, *Fu, *Fp;                    // the same for the free velocity: M~ dvf = Fq dq + ...
  T *Sq, *Sv, *Su, *Sp, *Sn;               // M~ dshift = Sq dq + ... + Sn dv' (impacts at their time)
  T *Z, *HF;                               // rows' free closing speeds by (q, v, u, theta); factor of M~
  bool early, late;                        // the step has rows that look at vf; impulses that act late in it
  T *qtan, *shift;                         // position correction of impacts at their time, integration scratch
  T *tq, *tv, *rhs_all;                    // tangents carried through substeps (nv x ncol)
  T *lq, *lv, *lu, *lp, *pvec;             // cotangents
  Vec<G::N>* Y;
  V O;

  // Swaps what belongs to v with what belongs to vb, for inverse dynamics there.
  void swap_velocity() {
    T* x = v; v = vb; vb = x;
    Motion* y = vel; vel = bvel; bvel = y;
    y = acc; acc = bacc; bacc = y;
  }

  Work(Arena& A, const Model& m) {
    int64_t nv = m.nv, nb = m.nbody, ncol = 2 * nv + m.nu + m.ntheta;  // sizes may pass the range of an int
    P = A.take<T>(m.nP); q = A.take<T>(m.nq); v = A.take<T>(nv); u = A.take<T>(m.nu + 1);
    vstep = A.take<T>(nv);
    this->take(A, nv, nv, m.ncontact, m.nlimit, nv, m.ngroup);
    R = A.take<typename G::Rot>(nb); pos = A.take<V>(nb);
    I = A.take<Inertia<G>>(nb); Ic = A.take<Inertia<G>>(nb);
    vel = A.take<Motion>(nb); acc = A.take<Motion>(nb); f = A.take<Motion>(nb); fc = A.take<Motion>(nb); tn = A.take<Motion>(nb);
    psid = A.take<Motion>(nv); psidd = A.take<Motion>(nv); sdot = A.take<Motion>(nv);
    vlam = A.take<Motion>(nv); tnlam = A.take<Motion>(nv);
    Xc = A.take<T>(nb * G::NX); momc = A.take<V>(nb);
    bias = A.take<T>(nv); tau = A.take<T>(nv); a = A.take<T>(nv); kd = A.take<T>(nv); kp = A.take<T>(nv); open = A.take<T>(m.nact + 1);
    tmp = A.take<T>(nv);
    all_phi = A.take<T>(m.ncontact); con_on = A.take<Mask>(m.ncontact); lim_on = A.take<Mask>(m.nlimit);
    bits = A.take<uint64_t>(nv * FillPattern::words(m.nv)); fill_ptr = A.take<int>(nv + 1); fill_idx = A.take<int>(nv * (nv - 1) / 2);
    Gq = A.take<T>(nv * nv); Gv = A.take<T>(nv * nv); Gu = A.take<T>(nv * (m.nu + 1)); Gp = A.take<T>(nv * (m.ntheta + 1));
    auto block = [&](T*& q_, T*& v_, T*& u_, T*& p_, int64_t rows) {
      q_ = A.take<T>(rows * nv); v_ = A.take<T>(rows * nv); u_ = A.take<T>(rows * (m.nu + 1)); p_ = A.take<T>(rows * (m.ntheta + 1));
    };
    vb = A.take<T>(nv); bvel = A.take<Motion>(nb); bacc = A.take<Motion>(nb); C = A.take<T>(nv * nv);
    block(Bq, Bv, Bu, Bp, nv);
    block(Fq, Fv, Fu, Fp, nv);
    block(Sq, Sv, Su, Sp, nv);
    Z = A.take<T>((2 * m.ncontact + m.nlimit + nv) * ncol); HF = A.take<T>(nv * nv);
    Sn = A.take<T>(nv * nv);
    qtan = A.take<T>(nv); shift = A.take<T>(nv);
    tq = A.take<T>(nv * ncol); tv = A.take<T>(nv * ncol); rhs_all = A.take<T>(nv * ncol);
    lq = A.take<T>(nv); lv = A.take<T>(nv); lu = A.take<T>(m.nu + 1); lp = A.take<T>(m.ntheta + 1); pvec = A.take<T>(nv);
    Y = A.take<Vec<G::N>>(m.max_group_dofs + 1);
  }
};

}  // namespace cmbrl::CMBRL_ISA
