// Where bodies are and how they move, and what cotangents of that mean for the state: for rewards and observations.
#pragma once
#include "step/lanes.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G>
struct BodyFields {  // of one body: position, rotation (by rows; in the plane cosine and sine), linear and angular velocity
  static constexpr int rot = sizeof(typename G::Rot) / sizeof(T), at_rot = G::D, at_lin = at_rot + rot, at_ang = at_lin + G::D,
                       all = at_ang + G::A;
};

// Twists of all bodies about O at the velocities v.
template <class G>
static void twists(const Model& m, Work<G>& w) {
  for (int b = 0; b < m.nbody; ++b) {
    w.vel[b] = m.body_parent[b] >= 0 ? w.vel[m.body_parent[b]] : zero<G::N>();
    for (int j = m.body_jadr[b]; j < m.body_jadr[b] + m.body_jnum[b]; ++j) {
      int d = m.jnt_vadr[j], n = m.jnt_type[j] == kBall ? 3 : 1;
      Vec<G::N> before = w.vel[b];
      for (int k = d; k < d + n; ++k) {
        w.vlam[k] = before;
        w.vel[b] += w.v[k] * w.S[k];
      }
    }
  }
}

// f(lanes, which of them are finite, workspace) for every pack, with its bodies' places and twists.
template <class G, class F>
static void for_moving_bodies(const Model& m, const Batch& b, int64_t begin, int64_t end, StepMemory& memory, F f) {
  Work<G> w = open<G>(m, Purpose::step, memory);
  for (int64_t e = begin; e < end; e += W) {
    Lanes l = lanes_from(e, end);
    Mask finite = gather_states(m, b, l, w);
    kinematics(m, w, w.q);
    twists(m, w);
    f(l, finite, w);
  }
}

template <class G>
static void body_motions(const Model& m, const Batch& b, const BodyBatch& out, int64_t begin, int64_t end, StepMemory& memory) {
  using F = BodyFields<G>;
  for_moving_bodies<G>(m, b, begin, end, memory, [&](const Lanes& l, Mask finite, Work<G>& w) {
    for (int i = 0; i < out.count; ++i) {
      int body = out.bodies[i];
      T x[F::all];
      typename G::Ang turn = ang<G>(w.vel[body]);
      typename G::V at = w.pos[body], speed = lin<G>(w.vel[body]) + G::turn(turn, at), place = w.O + at;
      const T* rotation = reinterpret_cast<const T*>(&w.R[body]);
      CMBRL_FOR(k, G::D) { x[k] = place[k]; x[F::at_lin + k] = speed[k]; }
      CMBRL_FOR(k, F::rot) x[F::at_rot + k] = rotation[k];
      CMBRL_FOR(k, G::A) x[F::at_ang + k] = turn[k];
      scatter(x, int64_t(out.count) * F::all, F::all, l, out.motion + i * F::all);
    }
    spoil(~finite, int64_t(out.count) * F::all, l, out.motion);
  });
}

// The moment that turns a body as cotangents of its rotation ask for: dR = [dtheta]x R.
static inline Planar::Ang turning(const Planar::Rot& R, const T* g) { return {{R.c * g[1] - R.s * g[0]}}; }
static inline Spatial::Ang turning(const Spatial::Rot& R, const T* g) {
  Vec<3> sum = zero<3>();
  CMBRL_FOR(k, 3) sum += cross({{R.m[k], R.m[3 + k], R.m[6 + k]}}, {{g[k], g[3 + k], g[6 + k]}});
  return sum;
}

// Cotangents of the state (tangent space for q) from those of the motions. A dof moves all that it carries by its column S;
// it also turns their twists relative to its own: d V_b = S x (V_b - V).
template <class G>
static void body_motions_backward(const Model& m, const Batch& b, const BodyBatch& out, int64_t begin, int64_t end, StepMemory& memory) {
  using F = BodyFields<G>;
  for_moving_bodies<G>(m, b, begin, end, memory, [&](const Lanes& l, Mask finite, Work<G>& w) {
    Vec<G::N>*place = w.tn, *motion = w.fc;  // wrenches about O that cotangents of places and of twists amount to
    for (int k = 0; k < m.nbody; ++k) place[k] = motion[k] = zero<G::N>();
    T clean = T{};
    for (int i = 0; i < out.count; ++i) {
      int body = out.bodies[i];
      T g[F::all];
      gather(out.cotangent + i * F::all, int64_t(out.count) * F::all, F::all, l, g, clean);
      typename G::V at = w.pos[body], push, drag;
      typename G::Ang spin, turn = ang<G>(w.vel[body]);
      CMBRL_FOR(k, G::D) { push[k] = g[k]; drag[k] = g[F::at_lin + k]; }
      CMBRL_FOR(k, G::A) spin[k] = g[F::at_ang + k];
      push -= G::turn(turn, drag);  // the velocity of a point changes with its place
      Vec<G::N> of_twist = join<G>(spin + G::moment(at, drag), drag);
      motion[body] += of_twist;
      place[body] += join<G>(turning(w.R[body], g + F::at_rot) + G::moment(at, push), push);
      place[body] += cross_force<G>(w.vel[body], of_twist);
    }
    T gq[1], gv[1];
    for (int k = m.nbody - 1; k >= 0; --k) {
      for (int d = m.body_lastdof[k]; d >= 0 && m.dof_body[d] == k; --d) {
        gq[0] = dot(w.S[d], place[k] - cross_force<G>(w.vlam[d], motion[k]));
        gv[0] = dot(w.S[d], motion[k]);
        scatter(gq, m.nv, 1, l, b.gq + d);
        scatter(gv, m.nv, 1, l, b.gv + d);
      }
      if (int p = m.body_parent[k]; p >= 0) { place[p] += place[k]; motion[p] += motion[k]; }
    }
    Mask good = finite & (clean == 0.0);
    spoil(~good, m.nv, l, b.gq);
    spoil(~good, m.nv, l, b.gv);
  });
}

}  // namespace cmbrl::CMBRL_ISA
