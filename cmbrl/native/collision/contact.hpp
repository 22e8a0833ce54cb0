// Contact geometry: closest features of a candidate, and how its gap, contact point and directions move with a dof.
#pragma once
#include "collision/bends.hpp"
#include "collision/corner.hpp"
#include "dynamics/dynamics.hpp"
#include "collision/edges.hpp"
#include "dynamics/inverse_weight.hpp"
#include "collision/oval.hpp"
#include "collision/rim.hpp"

namespace cmbrl::CMBRL_ISA {

template <class G>
static inline typename G::V plane_normal(const Model& m, int plane) { return load<G::D>(m.plane_normal + plane * G::D); }

template <class G>
static Feature<G> find_feature(const Model& m, Work<G>& w, int i) {
  using V = typename G::V;
  if (m.con_type[i] == kHulls) return w.touch[m.con_corner[i]];
  Feature<G> F;
  int A = m.con_bodyA[i], B = m.con_bodyB[i], D = G::D;
  F.axisA = F.axisB = F.beside = zero<G::D>();
  F.slide = zero<G::D * G::D>();
  F.free_s = F.free_t = F.turns = F.linear = F.held = F.leans = F.back = F.bends = T{};
  auto place = [&](int body, const double* local) -> V {
    V x = load<G::D>(local);
    return body >= 0 ? w.pos[body] + G::rotate(w.R[body], x) : x - w.O;
  };
  auto turn = [&](int body, const double* local) -> V {
    V x = load<G::D>(local);
    return body >= 0 ? G::rotate(w.R[body], x) : x;
  };
  bool corner = w.by_sides && m.con_hull[i] >= 0;
  F.a = corner ? w.pos[A] + G::rotate(w.R[A], w.side[m.con_corner[i]]) : place(A, m.con_posA + i * D);
  if (m.con_plane[i] >= 0) {
    F.n = plane_normal<G>(m, m.con_plane[i]);
    if (m.con_type[i] == kRimPlane) {
      F.axisA = turn(A, m.con_axisA + i * D);
      F.a = F.a - Rim(F.axisA, F.n).arm();
    } else if (m.con_type[i] == kDiscPlane) {
      F.axisA = turn(A, m.con_axisA + i * D);
      Disc<G> disc(m, w, i, F.axisA, F.n);
      F.a = F.a - disc.arm();
      F.dist = dot(F.n, F.a + w.O) - w.P[m.oPlane + m.con_plane[i]] + disc.missing();
      return F;
    } else if (m.con_type[i] == kOvalPlane) {
      oval_matrix(m, w, i, F.slide.x);
      F.a = F.a - Oval<G>(F.slide.x, F.n).arm();
    }
    F.dist = dot(F.n, F.a + w.O) - w.P[m.oPlane + m.con_plane[i]];
    return F;
  }
  if (m.con_type[i] == kCornerBox) {  // a side does not turn while B stays
    over_side(m, w, i, F);
    return F;
  }
  V b = place(B, m.con_posB + i * D), rel = F.a - b;
  F.turns = splat(1);
  F.axisB = turn(B, m.con_axisB + i * D);
  T bb = dot(F.axisB, F.axisB);
  T bb_safe = select(bb > 0.0, bb, splat(1));
  if (m.con_type[i] == kSegmentSegment) {
    F.axisA = turn(A, m.con_axisA + i * D);
    T aa = dot(F.axisA, F.axisA), ab = dot(F.axisA, F.axisB), ar = dot(F.axisA, rel), br = dot(F.axisB, rel);
    T det = aa * bb - ab * ab, one = splat(1);
    auto clip = [&](T x) { return vmin(vmax(x, -one), one); };
    T s = select(det > 1e-12 * aa * bb, clip((ab * br - bb * ar) / select(det > 0.0, det, one)), T{});
    T t = clip((ab * s + br) / bb_safe);
    s = clip((ab * t - ar) / select(aa > 0.0, aa, one));
    F.free_s = select((vabs(s) < 1.0) & (aa > 0.0), one, T{});
    F.free_t = select((vabs(t) < 1.0) & (bb > 0.0), one, T{});  // an edge across the plane of motion is a point in it
    F.a = F.a + s * F.axisA;
    rel = rel + s * F.axisA - t * F.axisB;
  } else if (m.con_halfB[i * D] > 0) {
    typename G::Rot R = B >= 0 ? w.R[B] : G::identity();
    T local_free[G::D];
    V near;
    V axis[G::D];
    CMBRL_FOR(k, G::D) {
      double e[G::D];
      CMBRL_FOR(r, G::D) e[r] = m.con_rotB[i * D * D + r * D + k];
      axis[k] = G::rotate(R, load<G::D>(e));
    }
    V coordinate, gap;
    Mask inside = all();
    CMBRL_FOR(k, G::D) {
      double half = m.con_halfB[i * D + k];
      coordinate[k] = dot(axis[k], rel);
      inside &= vabs(coordinate[k]) < half;
      near[k] = vmin(vmax(coordinate[k], splat(-half)), splat(half));
      local_free[k] = select(vabs(coordinate[k]) < half, splat(1), T{});
      gap[k] = vabs(coordinate[k]) - half;
    }
    if (any(inside)) {  // leave through the nearest face: mirror the point so that the distance is negative
      Mask rest = inside;
      T best = gap[0];
      for (int k = 1; k < G::D; ++k) best = vmax(best, gap[k]);
      CMBRL_FOR(k, G::D) {
        Mask face = rest & (gap[k] == best);
        T side = select(coordinate[k] < 0.0, splat(-1), splat(1));
        near[k] = select(face, side * m.con_halfB[i * D + k], select(inside, coordinate[k], near[k]));
        local_free[k] = select(face, T{}, local_free[k]);
        rest &= ~face;
      }
    }
    rel = zero<G::D>();
    CMBRL_FOR(k, G::D) rel += (coordinate[k] - near[k]) * axis[k];
    CMBRL_FOR(r, D) CMBRL_FOR(c, D) {
      T x = T{};
      CMBRL_FOR(k, D) x += local_free[k] * axis[k][r] * axis[k][c];
      F.slide[r * D + c] = x;
    }
    T len = vsqrt(dot(rel, rel));
    T sign = select(inside, splat(-1), splat(1));
    F.dist = sign * len;
    F.n = (sign / vmax(len, splat(1e-12))) * rel;
    return F;
  } else {
    T t = vmin(vmax(dot(F.axisB, rel) / bb_safe, splat(-1)), splat(1));
    T free = select(vabs(t) < 1.0, 1.0 / bb_safe, T{});
    rel = rel - t * F.axisB;
    CMBRL_FOR(r, D) CMBRL_FOR(c, D) F.slide[r * D + c] = free * F.axisB[r] * F.axisB[c];
  }
  F.dist = vsqrt(dot(rel, rel));
  F.n = (1.0 / vmax(F.dist, splat(1e-12))) * rel;
  return F;
}

// What the block of P of one candidate says of its radii.
template <class G>
static inline T load_radius(const Model& m, const Work<G>& w, int i) {
  T radius = splat(m.P[m.oContact + i * kContactFields + kRadius]);
  for (int e = m.con_par_ptr[i]; e < m.con_par_ptr[i + 1]; ++e)
    if (m.con_par_field[e] == kRadius) radius += w.dtheta[m.con_par[e]] * m.con_par_coef[e];
  return radius;
}

// The block of P of one candidate; only those of active contacts are kept.
template <class G>
static inline void load_block(const Model& m, const Work<G>& w, int i, T* p) {
  CMBRL_FOR(k, kContactFields) p[k] = splat(m.P[m.oContact + i * kContactFields + k]);
  for (int e = m.con_par_ptr[i]; e < m.con_par_ptr[i + 1]; ++e) p[m.con_par_field[e]] += w.dtheta[m.con_par[e]] * m.con_par_coef[e];
  p[kRscale] *= contact_weight(m, w, i);
}

// How gap, contact point, normal and directions of a contact move when body A moves by the twist xi and B stays; about: the axis of an
// edge. The normal alone where it is of use: in shift_by_dof.
template <class G>
struct Shift { T dphi; typename G::V dp, dn, dd[1 + G::NT]; typename G::Ang about; };

template <class G>
static Shift<G> shift_of(const Model& m, const Work<G>& w, const Contact<G>& c, const Vec<G::N>& xi) {
  using V = typename G::V;
  const Feature<G>& F = c.at;
  Shift<G> s;
  V u = point_velocity<G>(xi, F.a);
  if (m.con_type[c.index] == kRimPlane) {
    Rim rim(F.axisA, F.n);
    u = u + G::turn(ang<G>(xi), rim.arm()) - rim.arm_shift(G::turn(ang<G>(xi), F.axisA));
  } else if (m.con_type[c.index] == kDiscPlane) {
    Disc<G> disc(m, w, c.index, F.axisA, F.n);
    u = u + G::turn(ang<G>(xi), disc.arm()) - disc.arm_shift(ang<G>(xi));
  } else if (m.con_type[c.index] == kOvalPlane) {
    Oval<G> oval(F.slide.x, F.n);
    u = u + G::turn(ang<G>(xi), oval.arm()) - oval.arm_shift(ang<G>(xi));
  }
  s.dphi = dot(F.n, u);
  V dn = zero<G::D>();
  if (m.con_plane[c.index] < 0) {
    V dd = u;
    if (c.segments) {
      V turned = G::turn(ang<G>(xi), F.axisA), d = F.dist * F.n;
      T aa = dot(F.axisA, F.axisA), bb = dot(F.axisB, F.axisB), ab = dot(F.axisA, F.axisB);
      T one = splat(1), fs = F.free_s, ft = F.free_t;
      T r1 = -fs * (dot(u, F.axisA) + dot(d, turned)), r2 = ft * dot(u, F.axisB);
      T k11 = fs * aa + (one - fs), k12 = -fs * ft * ab, k22 = ft * bb + (one - ft);
      T det = k11 * k22 - k12 * k12;
      det = select(vabs(det) > 1e-12, det, one);
      T ds = (k22 * r1 - k12 * r2) / det, dt = (k11 * r2 - k12 * r1) / det;
      u = u + ds * F.axisA;
      dd = u - dt * F.axisB;
    }
    V leaning = zero<G::D>(), slid = zero<G::D>();
    T up = T{};
    if (c.hulls) {
      leaning = G::turn(ang<G>(xi), F.beside);
      up = dot(F.n, leaning);
      V roll = keep((F.leans == kRolls) | (F.leans == kLifts), splat(1)) * rolled(F, ang<G>(xi));
      u += roll;
      leaning -= roll;
    }
    CMBRL_FOR(r, G::D) CMBRL_FOR(k, G::D) slid[r] += F.slide[r * G::D + k] * u[k];
    dd -= slid;
    if (c.hulls) {
      s.dphi = select(F.linear > 0.0, dot(F.axisA, u), s.dphi);
      u -= F.linear * slid;
    }
    T inv = F.turns / select(vabs(F.dist) > 1e-12, F.dist, splat(1e-12));
    dn = inv * (dd - dot(F.n, dd) * F.n);
    if (c.hulls) {
      V turned = G::turn(ang<G>(xi), F.n);
      dn += F.held * turned;
      if (any(F.bends > 0.0)) bend_shift(F, turned, u, dn);
      Mask rolls = F.leans == kRolls;
      u += keep((F.leans == kLeans) | rolls, splat(1)) * leaning + (keep(F.leans == kLifts, up) - keep(rolls, up)) * F.n;
    }
  }
  s.dp = u - (c.radiusA + 0.5 * c.phi) * dn - (0.5 * s.dphi) * F.n;
  s.dd[0] = dn;
  s.about = {};
  for (int r = 1; r < c.rows && r <= G::NT; ++r) s.dd[r] = -dot(c.d[r], dn) * F.n;  // isotropic friction: the frame may roll about n
  return s;
}

// The same as B moves by the twist S: A relative to B, then both together.
template <class G>
static Shift<G> shift_with_other(const Model& m, const Work<G>& w, const Contact<G>& c, const Vec<G::N>& S) {
  Shift<G> s = shift_of(m, w, c, zero<G::N>() - S);
  typename G::Ang a = ang<G>(S);
  s.dp += point_velocity<G>(S, c.p);
  s.dd[0] += G::turn(a, c.at.n);
  for (int r = 1; r < c.rows && r <= G::NT; ++r) s.dd[r] += G::turn(a, c.d[r]);
  return s;
}

// The same for a dof with column S, which moves A (sign +1) or B (sign -1). Edges turn as MuJoCo's tangents do.
template <class G>
static Shift<G> shift_by_dof(const Model& m, const Work<G>& w, const Contact<G>& c, const Vec<G::N>& S, int sign) {
  Shift<G> s = sign > 0 ? shift_of(m, w, c, S) : shift_with_other(m, w, c, S);
  s.dn = s.dd[0];
  if (c.skewed) skewed_shift(m, w, c.index, c.at.n, s.dd[0], S, s.dd + 1);
  if (!c.edge) return s;
  Beside<G> x = edge_shift(m, w, c, c.at.n, s.dd[0], S);
  s.dd[0] = s.dd[0] + x.along;
  s.about = x.about;
  return s;
}

// Whether the column of a group's dof at b turns with the one at a: it stands below it, on the same side.
static inline bool turns_with(const Model& m, int b, int a) {
  int i = m.grp_dof[b], j = m.grp_dof[a];
  return m.grp_sign[b] == m.grp_sign[a] && (i > j || m.dof_jnt[i] == m.dof_jnt[j]);
}

template <class G>
static Vec<G::N> wrench_shift(const Contact<G>& c, const Shift<G>& s, int row) {
  if (row > G::NT) return turning_shift(c, s.dd, row);
  Vec<G::N> dW = join<G>(G::moment(s.dp, c.d[row]) + G::moment(c.p, s.dd[row]), s.dd[row]);
  if (row == 0 && c.edge) dW += join<G>(s.about, zero<G::D>());
  if (row > 0) CMBRL_FOR(x, G::N) dW[x] = keep(c.rub, dW[x]);
  return dW;
}

}  // namespace cmbrl::CMBRL_ISA
