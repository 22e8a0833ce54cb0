// Smooth dynamics of a tree: kinematics, bias forces, mass matrix, and the derivatives of inverse dynamics.
// Featherstone 2008 (RNEA, CRBA); derivatives after Carpentier & Mansard, RSS 2018 and Singh, Russell & Wensing, RA-L 2022.
#pragma once
#include "scene/workspace.hpp"

namespace cmbrl::CMBRL_ISA {

static inline Planar::Rot hinge_rotation(const Planar&, const double* axis, T angle) {
  Planar::Rot r;
  sincos(axis[0] * angle, r.s, r.c);
  return r;
}
static inline Spatial::Rot hinge_rotation(const Spatial&, const double* axis, T angle) {
  T s, c;
  sincos(angle, s, c);
  T k = 1.0 - c;
  Spatial::Rot r;
  double x = axis[0], y = axis[1], z = axis[2];
  r.m[0] = c + k * (x * x); r.m[1] = k * (x * y) - s * z; r.m[2] = k * (x * z) + s * y;
  r.m[3] = k * (x * y) + s * z; r.m[4] = c + k * (y * y); r.m[5] = k * (y * z) - s * x;
  r.m[6] = k * (x * z) - s * y; r.m[7] = k * (y * z) + s * x; r.m[8] = c + k * (z * z);
  return r;
}
static inline Spatial::Rot quaternion_rotation(const T* q) {
  T n = 1.0 / (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  T w = q[0], x = q[1], y = q[2], z = q[3], t = 2.0 * n;
  return {{1.0 - t * (y * y + z * z), t * (x * y - w * z), t * (x * z + w * y),
           t * (x * y + w * z), 1.0 - t * (x * x + z * z), t * (y * z - w * x),
           t * (x * z - w * y), t * (y * z + w * x), 1.0 - t * (x * x + y * y)}};
}

// Body poses and the columns S of the dofs. Positions are relative to O = the position of the first body.
template <class G>
static void kinematics(const Model& m, Work<G>& w, const T* q) {
  using V = typename G::V;
  V O = zero<G::D>();
  for (int b = 0; b < m.nbody; ++b) {
    int parent = m.body_parent[b];
    V x = load<G::D>(m.body_pos + b * G::D);
    typename G::Rot R = G::load_rot(m.body_rot + b * (G::D == 2 ? 2 : 9));
    if (parent >= 0) {
      x = w.pos[parent] + G::rotate(w.R[parent], x);
      R = G::compose(w.R[parent], R);
    } else {
      x = x - O;
    }
    for (int j = m.body_jadr[b]; j < m.body_jadr[b] + m.body_jnum[b]; ++j) {
      int d = m.jnt_vadr[j];
      const double* axis = m.jnt_axis + j * G::D;
      if (m.jnt_type[j] == kSlide) {
        V dir = G::rotate(R, load<G::D>(axis));
        x += (q[m.jnt_qadr[j]] - m.jnt_q0[j]) * dir;
        w.S[d] = join<G>(zero<G::A>(), dir);
        continue;
      }
      V local = load<G::D>(m.jnt_pos + j * G::D);
      V anchor = x + G::rotate(R, local);
      if constexpr (G::D == 3) {
        if (m.jnt_type[j] == kBall) {
          R = G::compose(R, quaternion_rotation(q + m.jnt_qadr[j]));
          x = anchor - G::rotate(R, local);
          CMBRL_FOR(k, 3) {
            V e = {{R.m[k], R.m[3 + k], R.m[6 + k]}};
            w.S[d + k] = join<G>(e, cross(anchor, e));
          }
          continue;
        }
      }
      typename G::Ang a;
      if constexpr (G::D == 3) a = G::rotate(R, load<3>(axis));
      else a = {{splat(axis[0])}};
      R = G::compose(R, hinge_rotation(G{}, axis, q[m.jnt_qadr[j]] - m.jnt_q0[j]));
      x = anchor - G::rotate(R, local);
      w.S[d] = join<G>(a, zero<G::D>() - G::turn(a, anchor));
    }
    if (b == 0) {  // move the origin to the first body, now that it is known
      O = x;
      for (int j = m.body_jadr[b]; j < m.body_jadr[b] + m.body_jnum[b]; ++j)
        for (int d = m.jnt_vadr[j]; d < m.jnt_vadr[j] + (m.jnt_type[j] == kBall ? 3 : 1); ++d) {
          typename G::Ang a = ang<G>(w.S[d]);
          w.S[d] = join<G>(a, lin<G>(w.S[d]) + G::turn(a, O));
        }
      x = zero<G::D>();
      w.O = O;
    }
    w.pos[b] = x;
    w.R[b] = R;
  }
}

template <class G>
static void inertias(const Model& m, Work<G>& w) {
  for (int b = 0; b < m.nbody; ++b) {
    const T* p = w.P + b * m.body_fields;
    typename G::V c;
    CMBRL_FOR(i, G::D) c[i] = p[1 + i];
    c = w.pos[b] + G::rotate(w.R[b], c);
    Inertia<G>& I = w.I[b];
    I.m = p[0];
    I.h = p[0] * c;
    G::sym_rotate(w.R[b], p + 1 + G::D, I.I);
    G::add_steiner(I.I, p[0], c);
  }
}

// Twists, accelerations and forces for velocities v and accelerations a (null: zero); gravity enters as -g at the root.
// Generalised forces go to out. vlam keeps the twist before each dof's joint.
template <class G>
static void inverse_dynamics(const Model& m, Work<G>& w, const T* v, const T* a, T* out) {
  using Motion = Vec<G::N>;
  Motion root = zero<G::N>();
  CMBRL_FOR(i, G::D) root[G::A + i] = -w.P[m.oGravity + i];
  for (int b = 0; b < m.nbody; ++b) {
    int parent = m.body_parent[b];
    Motion vb = parent >= 0 ? w.vel[parent] : zero<G::N>();
    Motion ab = parent >= 0 ? w.acc[parent] : root;
    for (int j = m.body_jadr[b]; j < m.body_jadr[b] + m.body_jnum[b]; ++j) {
      int d = m.jnt_vadr[j], n = m.jnt_type[j] == kBall ? 3 : 1;
      Motion own = zero<G::N>(), alam = ab;
      for (int k = d; k < d + n; ++k) {
        w.vlam[k] = vb;
        own += v[k] * w.S[k];
        if (a) ab += a[k] * w.S[k];
        w.psidd[k] = alam;  // completed by derivative_terms
      }
      ab += cross_motion<G>(vb, own);
      vb += own;
    }
    w.vel[b] = vb;
    w.acc[b] = ab;
    w.fc[b] = w.I[b] * ab + cross_force<G>(vb, w.I[b] * vb);
  }
  for (int b = m.nbody - 1; b >= 0; --b) {
    for (int j = m.body_jadr[b]; j < m.body_jadr[b] + m.body_jnum[b]; ++j)
      for (int d = m.jnt_vadr[j]; d < m.jnt_vadr[j] + (m.jnt_type[j] == kBall ? 3 : 1); ++d) out[d] = dot(w.S[d], w.fc[b]);
    if (m.body_parent[b] >= 0) w.fc[m.body_parent[b]] += w.fc[b];
  }
}

// Joint-space mass matrix into w.M, without armature. CRBA.
template <class G>
static void mass_matrix(const Model& m, Work<G>& w) {
  for (int b = 0; b < m.nbody; ++b) w.Ic[b] = w.I[b];
  for (int b = m.nbody - 1; b >= 0; --b)
    if (m.body_parent[b] >= 0) w.Ic[m.body_parent[b]] += w.Ic[b];
  for (int i = 0; i < m.nv; ++i) {
    Vec<G::N> F = w.Ic[m.dof_body[i]] * w.S[i];
    Row<T> row(w.M, m.mass, i);
    const int *columns = m.mass.columns(i), *above = m.tree().columns(i);
    *row.diagonal = dot(w.S[i], F);
    for (int k = 0, x = 0; k < row.n; ++k) {
      bool carries = x < m.tree().count(i) && above[x] == columns[k];
      row.before[k] = row.mirror[k] = carries ? dot(w.S[columns[k]], F) : T{};
      x += carries;
    }
  }
}

// d ID/dq (scaled by h) added into dq, d ID/dv (scaled by h) into dv, at the (v, a) of the last inverse_dynamics call.
// Composite velocity matrix 2B = [[X, 0], [-2 p x, 0]]: its linear columns vanish, so X and the momentum p suffice.
template <class G>
static void inverse_dynamics_derivatives(const Model& m, Work<G>& w, double h, T* dq, T* dv) {
  using Motion = Vec<G::N>;
  int nv = m.nv;
  for (int b = 0; b < m.nbody; ++b) {
    typename G::Ang om = ang<G>(w.vel[b]);
    typename G::V vl = lin<G>(w.vel[b]);
    w.momc[b] = w.I[b].m * vl + G::turn(om, w.I[b].h);
    G::coriolis(w.Xc + b * G::NX, w.I[b].I, w.I[b].h, om, vl);
  }
  for (int b = m.nbody - 1; b >= 0; --b)
    if (int p = m.body_parent[b]; p >= 0) {
      w.momc[p] += w.momc[b];
      CMBRL_FOR(k, G::NX) w.Xc[p * G::NX + k] += w.Xc[b * G::NX + k];
    }
  for (int j = 0; j < m.njoint; ++j) {  // S-dot uses the twist after the joint, psi-dot the one before it
    int d0 = m.jnt_vadr[j], n = m.jnt_type[j] == kBall ? 3 : 1;
    Motion after = w.vlam[d0];
    if (n == 3) for (int d = d0; d < d0 + n; ++d) after += w.v[d] * w.S[d];
    for (int d = d0; d < d0 + n; ++d) {
      w.psid[d] = cross_motion<G>(w.vlam[d], w.S[d]);
      w.psidd[d] = cross_motion<G>(w.psidd[d], w.S[d]) + cross_motion<G>(w.vlam[d], w.psid[d]);
      w.sdot[d] = w.psid[d] + (n == 3 ? cross_motion<G>(after, w.S[d]) : w.psid[d]);
    }
  }
  for (int i = 0; i < nv; ++i) {
    int b = m.dof_body[i];
    const T* X = w.Xc + b * G::NX;
    typename G::V p2 = 2.0 * w.momc[b];
    auto velocity_force = [&](const Motion& s) {
      typename G::Ang al = ang<G>(s);
      return join<G>(G::X_mul(X, al), G::turn(al, p2));
    };
    Motion Fq = velocity_force(w.psid[i]) + w.Ic[b] * w.psidd[i];
    Motion Fv = velocity_force(w.S[i]) + w.Ic[b] * w.sdot[i];
    Motion Fq_anc = Fq + cross_force<G>(w.S[i], w.fc[b]);
    Motion IS = w.Ic[b] * w.S[i];
    typename G::Ang BtS = G::Xt_mul(X, ang<G>(w.S[i])) + G::moment(p2, lin<G>(w.S[i]));
    dq[i * nv + i] += h * dot(w.S[i], Fq);
    dv[i * nv + i] += h * dot(w.S[i], Fv);
    for (int k = m.anc_ptr[i]; k < m.anc_ptr[i + 1]; ++k) {
      int j = m.anc_idx[k];
      bool same = m.dof_jnt[j] == m.dof_jnt[i];  // dofs of one ball joint turn together
      dq[j * nv + i] += h * dot(w.S[j], same ? Fq : Fq_anc);
      dv[j * nv + i] += h * dot(w.S[j], Fv);
      dq[i * nv + j] += h * (dot(BtS, ang<G>(w.psid[j])) + dot(IS, w.psidd[j]));
      dv[i * nv + j] += h * (dot(BtS, ang<G>(w.S[j])) + dot(IS, w.sdot[j]));
    }
  }
}

// h d(M a)/dq added into dq: inverse dynamics at rest and without gravity. Leaves its twists and accelerations.
template <class G>
static void inertia_derivatives(const Model& m, Work<G>& w, const T* a, double h, T* dq) {
  using Motion = Vec<G::N>;
  for (int b = 0; b < m.nbody; ++b) {
    Motion acc = m.body_parent[b] >= 0 ? w.acc[m.body_parent[b]] : zero<G::N>();
    for (int j = m.body_jadr[b]; j < m.body_jadr[b] + m.body_jnum[b]; ++j) {
      int d = m.jnt_vadr[j], end = d + (m.jnt_type[j] == kBall ? 3 : 1);
      for (int k = d; k < end; ++k) w.psidd[k] = cross_motion<G>(acc, w.S[k]);
      for (int k = d; k < end; ++k) acc += a[k] * w.S[k];
    }
    w.vel[b] = zero<G::N>();
    w.acc[b] = acc;
    w.fc[b] = w.I[b] * acc;
  }
  for (int b = m.nbody - 1; b >= 0; --b)
    if (m.body_parent[b] >= 0) w.fc[m.body_parent[b]] += w.fc[b];
  for (int i = 0; i < m.nv; ++i) {
    int b = m.dof_body[i];
    Motion own = w.Ic[b] * w.psidd[i], turned = own + cross_force<G>(w.S[i], w.fc[b]), IS = w.Ic[b] * w.S[i];
    dq[i * m.nv + i] += h * dot(w.S[i], own);
    for (int k = m.anc_ptr[i]; k < m.anc_ptr[i + 1]; ++k) {
      int j = m.anc_idx[k];
      bool same = m.dof_jnt[j] == m.dof_jnt[i];  // dofs of one ball joint turn together
      dq[j * m.nv + i] += h * dot(w.S[j], same ? own : turned);
      dq[i * m.nv + j] += h * dot(IS, w.psidd[j]);
    }
  }
}

// Twists of the bodies under velocities x.
template <class G>
static void twists_under(const Model& m, const Work<G>& w, const T* x, Vec<G::N>* twist) {
  for (int b = 0; b < m.nbody; ++b) {
    Vec<G::N> t = m.body_parent[b] >= 0 ? twist[m.body_parent[b]] : zero<G::N>();
    for (int j = m.body_jadr[b]; j < m.body_jadr[b] + m.body_jnum[b]; ++j)
      for (int d = m.jnt_vadr[j]; d < m.jnt_vadr[j] + (m.jnt_type[j] == kBall ? 3 : 1); ++d) t += x[d] * w.S[d];
    twist[b] = t;
  }
}

}  // namespace cmbrl::CMBRL_ISA
