// MuJoCo's pyramidal cone, under the convex law of sliding: a contact that touches is rows without friction, one along each edge
// n + mu t of the pyramid, as MuJoCo has it: t = +-t1, +-t2, with torsional friction also the moments +-n, with rolling friction also
// +-t1, +-t2, and the coefficient of each. In the plane some of them do nothing.
#pragma once
#include "collision/law.hpp"
#include "collision/turning.hpp"

namespace cmbrl::CMBRL_ISA {

// Tangents of a contact with a round cone, which may be any.
static inline void tangents(const Planar&, const Vec<2>& n, Vec<2>* d) { d[0] = {{n[1], -n[0]}}; }
static inline void tangents(const Spatial&, const Vec<3>& n, Vec<3>* d) {
  Mask flat = vabs(n[0]) < 0.7;
  Vec<3> e = {{select(flat, splat(1), T{}), select(flat, T{}, splat(1)), T{}}};
  e = e - dot(e, n) * n;
  d[0] = (1.0 / vsqrt(dot(e, e))) * e;
  d[1] = cross(n, d[0]);
}
static inline bool along_capsule(const Model& m, int i) {
  const double* a = m.con_along + 3 * i;
  if (m.con_type[i] == kDiscPlane) return false;
  return a[0] != 0 || a[1] != 0 || a[2] != 0;
}
// What MuJoCo's first tangent is made of: an axis of the world, or the capsule; and how that turns with A. A capsule that stands on
// its end (to MuJoCo's 1e-15) says nothing of directions along the surface: then the world's x, as there. Nearly upright ones turn the
// tangent by any amount as they tilt; below 1e-6 rad that is no derivative that anyone can follow, and is left out.
constexpr double kUpright = 1e-15, kNearlyUpright = 1e-6;
static inline T off_normal(const Vec<3>& e, const Vec<3>& n) {
  Vec<3> y = e - dot(e, n) * n;
  return dot(y, y);
}
static inline Vec<2> tangent_axis(const Model&, const Work<Planar>&, int, const Vec<2>&) { return zero<2>(); }
static inline Vec<3> tangent_axis(const Model& m, const Work<Spatial>& w, int i, const Vec<3>& n) {
  if (along_capsule(m, i)) {
    Vec<3> e = Spatial::rotate(w.R[m.con_bodyA[i]], load<3>(m.con_along + 3 * i));
    Mask stands = off_normal(e, n) < kUpright * kUpright, flat = vabs(n[0]) < 0.7;
    Vec<3> x{{select(flat, splat(1), T{}), select(flat, T{}, splat(1)), T{}}};
    CMBRL_FOR(k, 3) e[k] = select(stands, x[k], e[k]);
    return e;
  }
  Mask flat = vabs(n[1]) < 0.5;
  return {{T{}, select(flat, splat(1), T{}), select(flat, T{}, splat(1))}};
}
static inline Vec<2> axis_turn(const Model&, const Work<Planar>&, int, const Vec<2>&, const Vec<3>&) { return zero<2>(); }
static inline Vec<3> axis_turn(const Model& m, const Work<Spatial>& w, int i, const Vec<3>& n, const Vec<6>& S) {
  if (!along_capsule(m, i)) return zero<3>();
  Vec<3> e = Spatial::rotate(w.R[m.con_bodyA[i]], load<3>(m.con_along + 3 * i)), de = Spatial::turn(ang<Spatial>(S), e);
  Mask tilted = off_normal(e, n) > kNearlyUpright * kNearlyUpright;
  CMBRL_FOR(k, 3) de[k] = keep(tilted, de[k]);
  return de;
}
// What an edge has beside the normal: of a slide (kind 0, 1: along the first or second tangent), a direction; of a spin (2) and a roll
// (3, 4: about a tangent), an axis. From the axis e that makes the first tangent; and its change with those of the normal and of e.
template <class G> struct Beside { typename G::V along; typename G::Ang about; };
static inline Beside<Planar> beside(const Planar&, const Vec<2>& n, const Vec<2>&, int kind) {
  return {kind == 0 ? Vec<2>{{n[1], -n[0]}} : zero<2>(), {{kind == 4 ? splat(1) : T{}}}};  // the second tangent points out of the plane
}
static inline Beside<Planar> beside_turn(const Planar&, const Vec<2>&, const Vec<2>&, int kind, const Vec<2>& dn, const Vec<2>&) {
  return {kind == 0 ? Vec<2>{{dn[1], -dn[0]}} : zero<2>(), {{T{}}}};
}
static inline Beside<Spatial> slide_or_turn(int kind, const Vec<3>& x) {
  return kind < 2 ? Beside<Spatial>{x, zero<3>()} : Beside<Spatial>{zero<3>(), x};
}
static inline Beside<Spatial> beside(const Spatial&, const Vec<3>& n, const Vec<3>& e, int kind) {
  if (kind == 2) return slide_or_turn(kind, n);
  Vec<3> y = e - dot(e, n) * n, first = (1.0 / vsqrt(vmax(dot(y, y), splat(1e-30)))) * y;
  return slide_or_turn(kind, kind % 3 == 0 ? first : cross(n, first));
}
static inline Beside<Spatial> beside_turn(const Spatial&, const Vec<3>& n, const Vec<3>& e, int kind, const Vec<3>& dn, const Vec<3>& de) {
  if (kind == 2) return slide_or_turn(kind, dn);
  Vec<3> y = e - dot(e, n) * n, dy = de - (dot(de, n) + dot(e, dn)) * n - dot(e, n) * dn;
  T inv = 1.0 / vsqrt(vmax(dot(y, y), splat(1e-30)));
  Vec<3> first = inv * y, turned = inv * (dy - dot(first, dy) * first);
  return slide_or_turn(kind, kind % 3 == 0 ? turned : cross(dn, first) + cross(n, turned));
}
static inline int kind_of_edge(int edge) { return (edge - 1) / 2; }
static inline double sign_of_edge(int edge) { return edge % 2 ? 1 : -1; }
// Friction along the second tangent may differ from that along the first, in sliding and in rolling: how much it counts there.
static inline double ratio_of_edge(const Model& m, int i, int edge) {
  int kind = kind_of_edge(edge);
  return kind == 1 ? m.con_ratio[2 * i] : kind == 4 ? m.con_ratio[2 * i + 1] : 1;
}
static inline bool is_skewed(const Model& m, int i) { return m.con_ratio[2 * i] != 1 || m.con_ratio[2 * i + 1] != 1; }
static inline int field_of_edge(int edge) { return kind_of_edge(edge) < 2 ? kMu : field_of_turning(kind_of_edge(edge) > 2); }

template <class G>
static inline typename G::V normal_of(const Contact<G>& c) { return c.edge ? c.d[0] - c.mu * c.d[1] : c.d[0]; }

// A whole contact becomes one of its edges.
template <class G>
static void make_edge(const Model& m, const Options& o, const Work<G>& w, int edge, const T* p, Contact<G>& c) {
  c.edge = edge;
  c.skewed = false;
  c.rows = 1;
  c.mu = c.full_mu = select(c.rub, p[field_of_edge(edge)] * ratio_of_edge(m, c.index, edge), splat(1));
  Beside<G> x = beside(G{}, c.d[0], tangent_axis(m, w, c.index, c.d[0]), kind_of_edge(edge));
  double sign = sign_of_edge(edge);
  c.d[1] = sign * x.along;
  c.d[0] = c.d[0] + c.mu * c.d[1];
  c.Wr[0] = join<G>(G::moment(c.p, c.d[0]) + (sign * c.mu) * x.about, c.d[0]);
  c.Wr[1] = join<G>(G::moment(c.p, c.d[1]) + sign * x.about, c.d[1]);
  contact_law(m, o, c, p);
  c.root = vsqrt(m.con_invweight[c.index] + c.Rn);
}

// The last contact, in the lanes where the convex law holds, becomes its edges.
template <class G>
static void split_into_edges(const Model& m, const Options& o, Work<G>& w, const T* p) {
  Known<G> whole = w.con[w.ncon - 1];
  Mask lanes = whole.convex & (whole.on | whole.wide);
  if (!o.convex || !m.con_pyramid[whole.index] || !any(lanes)) return;
  Contact<G>& rest = w.con[w.ncon - 1];
  rest.on &= ~lanes;
  rest.wide &= ~lanes;
  if (!any(rest.on | rest.wide)) --w.ncon;
  whole.on &= lanes;
  whole.wide &= lanes;
  for (int edge = 1; edge <= m.con_pyramid[whole.index]; ++edge) {
    Contact<G>& c = w.add_contact();
    static_cast<Known<G>&>(c) = whole;
    make_edge(m, o, w, edge, p, c);
  }
}

// Tangents of a contact with a round cone whose friction has directions: MuJoCo's, the second one as long as its ratio, so that one
// circle bounds all of friction again, with MuJoCo's softness. And how they turn.
template <class G>
static void skewed_tangents(const Model& m, const Work<G>& w, int i, const typename G::V& n, typename G::V* d) {
  typename G::V e = tangent_axis(m, w, i, n);
  CMBRL_FOR(k, G::NT) d[k] = (k == 1 ? m.con_ratio[2 * i] : 1.0) * beside(G{}, n, e, k).along;
}
template <class G>
static void skewed_shift(const Model& m, const Work<G>& w, int i, const typename G::V& n, const typename G::V& dn, const Vec<G::N>& S,
                         typename G::V* dd) {
  typename G::V e = tangent_axis(m, w, i, n), de = axis_turn(m, w, i, n, S);
  CMBRL_FOR(k, G::NT) dd[k] = (k == 1 ? m.con_ratio[2 * i] : 1.0) * beside_turn(G{}, n, e, k, dn, de).along;
}

// How what an edge has beside the normal n, times its coefficient, changes with the normal, as a dof with column S moves A; or B,
// which is no plane then.
template <class G>
static inline Beside<G> edge_shift(const Model& m, const Work<G>& w, const Contact<G>& c, const typename G::V& n,
                                   const typename G::V& dn, const Vec<G::N>& S) {
  typename G::V e = tangent_axis(m, w, c.index, n), de = axis_turn(m, w, c.index, n, S);
  Beside<G> x = beside_turn(G{}, n, e, kind_of_edge(c.edge), dn, de);
  T scale = c.mu * sign_of_edge(c.edge);
  return {scale * x.along, scale * x.about};
}

// What a contact with a round cone pushes along its tangent of this row.
template <class G>
static T tangential_impulse(const Contact<G>& c, int row) {
  if (!c.skewed) return c.b[row - 1];
  typename G::V t[G::NT];
  tangents(G{}, c.d[0], t);
  T sum = T{};
  CMBRL_FOR(k, G::NT) sum += c.b[k] * dot(t[row - 1], c.d[1 + k]);
  return sum;
}

// What an edge pushes along the normal (row 0) and the tangents of its contact.
template <class G>
static T edge_impulse(const Contact<G>& c, int row) {
  if (row == 0) return c.gam;
  typename G::V t[G::NT];
  tangents(G{}, normal_of(c), t);
  return c.mu * c.gam * dot(t[row - 1], c.d[1]);
}

}  // namespace cmbrl::CMBRL_ISA
