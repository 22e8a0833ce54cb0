// Which candidates become rows in this step: what is near enough to close within it.
#pragma once
#include "collision/contact_rows.hpp"
#include "collision/hull_contact.hpp"
#include "collision/side.hpp"
#include "collision/sieve.hpp"

namespace cmbrl::CMBRL_ISA {

// Of A against B under their twists, where they are closest.
template <class G>
static typename G::V relative_velocity(const Vec<G::N>* twist, int A, int B, const Feature<G>& F) {
  typename G::V u = A >= 0 ? point_velocity<G>(twist[A], F.a) : zero<G::D>();
  if (B >= 0) u -= point_velocity<G>(twist[B], F.a - F.dist * F.n);
  return u;
}

// [m] in which height fields are looked at where it is not known from which gap on they are far.
constexpr double kFarSight = 0.05;

// What a cluster's candidates that are too far to look at have in common: from which gap on they are, and the smallest of theirs.
struct Far { T from, lowest = splat(1e300); };
// A law with a margin takes candidates for touching that much before they do.
static inline double margin_of(const Model& m, int i) { return __builtin_fmax(m.con_margin[i], 0); }
// Lanes in which hulls whose boxes are `gap` apart, less their margin, may touch, or are where adhesion pulls.
static inline Mask within_reach(const Model& m, int i, T gap) { return gap <= __builtin_fmax(m.con_reach[i], 0) - margin_of(m, i); }

// Nothing is known yet of what touches in this state.
template <class G>
static void look_afresh(const Options& o, Work<G>& w) {
  w.by_sides = !o.look_ahead;
  w.prisms = w.by_sides || o.both_ways;
  w.side_of = w.touch_of = w.under.pair = w.frame_of = -1;
  w.sight = T{};
}

// The closest features of a candidate, and the lanes in which it has any.
template <class G>
static Mask look_at(const Model& m, const Options& o, Work<G>& w, int i, Feature<G>& F, const Given* given = nullptr) {
  bool hulls = m.con_type[i] == kHulls, corner = w.by_sides && !hulls && m.con_hull[i] >= 0;
  bool field = hulls && of_field(m, i);
  if (hulls && !field && o.both_ways) return none();  // they only know of closed gaps
  if (field && given && o.look_ahead) w.sight = splat(kFarSight);
  if (corner) find_side(m, w, i);
  bool recalled = hulls && given && recall_touch(*given, F);
  if (hulls && !recalled) find_touches(m, w, i);
  if (hulls && !recalled && !any(w.touch_there[m.con_corner[i]])) {
    if (!given) return none();
    std::memset(&w.touch[m.con_corner[i]], 0, sizeof *w.touch);
  }
  if (!recalled) F = find_feature(m, w, i);
  Mask on = given ? given->on : hulls ? w.touch_there[m.con_corner[i]] : corner ? w.side_there[m.con_corner[i]] : all();
  bool of_points = m.con_plane[i] < 0 && m.con_type[i] != kCornerBox && !hulls;  // whose distance gives the direction
  if (of_points) on &= vabs(F.dist) > 1e-9;  // crossing segments: none parts them
  if (!given && w.by_sides && m.con_type[i] == kPointPlane)  // MuJoCo's boxes touch a plane with corners below their centre alone
    on &= ~(dot(F.n, G::rotate(w.R[m.con_bodyA[i]], load<G::D>(m.con_axisA + i * G::D))) > 0.0);
  return on;
}

// One candidate: becomes a row of w.con if it may close within the step, or several, else of w.left, or of `far`; given: it, or
// an edge of it, is a row in these lanes.
template <class G>
static void find_contact(const Model& m, const Options& o, Work<G>& w, int i, Far* far, const Given* given = nullptr) {
  int A = m.con_bodyA[i], B = m.con_bodyB[i];
  Feature<G> F;
  Mask on = look_at(m, o, w, i, F, given);
  if (!given && m.con_type[i] == kHulls && !any(on)) return;  // others have a gap wherever they are
  if (far) {
    T gap = F.dist - m.P[m.oContact + i * kContactFields + kRadius] - w.radius_slack - margin_of(m, i);
    if (!any(gap < far->from)) { far->lowest = vmin(far->lowest, gap); return; }
  }
  T p[kContactFields], phi = F.dist - load_radius(m, w, i);
  if (!o.look_ahead && !given) {
    Mask apart = on & ~(phi < m.con_margin[i]);
    w.left_out_gap = select(apart, vmin(w.left_out_gap, vabs(phi)), w.left_out_gap);
    on &= ~apart;
    if (!any(on)) return;
  }
  if (!(o.prune < 1e300) || given) {
    load_block(m, w, i, p);
    Contact<G>& c = w.add_contact();
    make_contact(m, o, w, i, F, phi, p, c);
    c.on = c.wide = on;
    w.coupled |= A >= 0 && B >= 0;
    if (!given) split_into_edges(m, o, w, p);
    else if (given->edge) make_edge(m, o, w, given->edge, p, c);
    else if (!c.skewed) join_kin(m, w);
    return;
  }
  double enough = speed_that_matters(o, o.forward, m.con_invweight[i]), wide = speed_that_matters(o, o.backward, m.con_invweight[i]);
  T speed = dot(F.n, relative_velocity<G>(w.vel, A, B, F)), slack = (phi - margin_of(m, i)) * (1 / o.h) - vabs(speed);  // at least, whatever the law is
  T closing = speed;
  for (int k = 0; k < w.nguess; ++k) closing = vmin(closing, dot(F.n, relative_velocity<G>(w.guess_twist + k * m.nbody, A, B, F)));
  Mask near = on & (slack + vmin(closing, -vabs(speed)) < __builtin_fmax(enough, wide)), takes_part = none();
  if (m.logistic) {
    load_block(m, w, i, p);
    near |= on & (p[kSolref0] * phi < kFaint);
  }
  if (any(near)) {
    load_block(m, w, i, p);
    Contact<G>& c = w.add_contact();
    make_contact(m, o, w, i, F, phi, p, c);
    slack = select(near, c.cn0 - c.carry * speed, slack);
    Mask held = near & c.convex;  // slides, perhaps, and is lifted, however fast it separates
    takes_part = c.on = held | (near & (slack + closing < enough));
    c.wide = held | (near & (slack + closing < wide));
    if (any(c.on | c.wide)) w.coupled |= A >= 0 && B >= 0;
    settle_contact(m, o, w, p);
  }
  Mask left = on & ~takes_part;
  if (!any(left)) return;
  w.leave_out({left, A, B, join<G>(G::moment(F.a, F.n), F.n), slack, enough});
  w.left_out_gap = select(left, vmin(w.left_out_gap, vabs(phi)), w.left_out_gap);
}

// Candidates of a cluster over a plane: of points that are too far up the height alone is found.
template <class G>
static void find_on_plane(const Model& m, const Options& o, Work<G>& w, int A, int cluster, Far& far) {
  int begin = m.cluster_begin[cluster], plane = m.con_plane[m.grp_con[begin]];
  typename G::V n = plane_normal<G>(m, plane), up = G::unrotate(w.R[A], n);
  T base = dot(n, w.pos[A] + w.O) - w.P[m.oPlane + plane] - w.radius_slack;
  for (int k = begin; k < m.cluster_begin[cluster + 1]; ++k) {
    int i = m.grp_con[k];
    T gap = base + dot(up, load<G::D>(m.con_posA + i * G::D)) - m.P[m.oContact + i * kContactFields + kRadius] - margin_of(m, i);
    if (m.con_type[i] != kPointPlane || any(gap < far.from)) find_contact(m, o, w, i, &far);
    else far.lowest = vmin(far.lowest, gap);
  }
}

// Of two geoms that are both no planes. Those that their box keeps away are not looked at.
template <class G>
static void find_between(const Model& m, const Options& o, Work<G>& w, int cluster, Far& far) {
  const int *begin = m.grp_con + m.cluster_begin[cluster], *end = m.grp_con + m.cluster_begin[cluster + 1];
  if (of_field(m, *begin)) {
    for (; begin < end && any(w.may_touch); ++begin) {
      find_contact(m, o, w, *begin, &far);
      if (!any(w.touch_there[m.con_corner[*begin]])) break;  // nor any more of them
    }
    far.lowest = vmin(far.lowest, far.from);  // of what is not in sight
    return;
  }
  for (; begin < end && m.con_type[*begin] == kHulls; ++begin) if (any(w.may_touch)) find_contact(m, o, w, *begin, &far);
  if (m.cluster_frame[cluster] < 0) {  // few, and nobody else's
    for (; begin < end; ++begin) find_contact(m, o, w, *begin, &far);
    return;
  }
  if (begin < end) for_distances(m, w, cluster, begin, end, [&](int i, T distance) {
    T gap = distance - m.P[m.oContact + i * kContactFields + kRadius] - w.radius_slack - margin_of(m, i);
    if (any(gap < far.from)) find_contact(m, o, w, i, &far);
    else far.lowest = vmin(far.lowest, gap);
  });
}

// Whether a cluster belongs to the other way in which its geoms touch.
static inline bool idle(const Model& m, const Options& o, int cluster) {
  return !o.both_ways && m.con_when[m.grp_con[m.cluster_begin[cluster]]] == (o.look_ahead ? kClosed : kAhead);
}
// From which gap on those of a cluster are far, of bodies that are so fast against each other.
static inline T far_from(const Model& m, const Options& o, int cluster, T fast) {
  return o.h * (speed_of_far(o, m.cluster_invweight[cluster]) + 2.0 * fast);
}

// Whether a cluster with candidate i is a mesh that touches a plane with corners of a side, its first candidates.
template <class G>
static bool corners_on_plane(const Model& m, const Work<G>& w, int i) { return w.by_sides && m.con_plane[i] >= 0 && m.con_hull[i] >= 0; }

// Those of a cluster, of bodies that are so fast against each other. Nothing is known to be far where pruning does not sift.
template <class G>
static void find_in_cluster(const Model& m, const Options& o, Work<G>& w, int g, int cluster, T fast) {
  int A = m.grp_A[g], B = m.grp_B[g], begin = m.cluster_begin[cluster], end = m.cluster_begin[cluster + 1];
  if (idle(m, o, cluster)) return;
  bool side = corners_on_plane(m, w, m.grp_con[begin]);
  if (side) end = begin + kCorners;
  bool field = o.look_ahead && of_field(m, m.grp_con[begin]);
  w.may_touch = all();
  if (!w.sift) {
    w.sight = splat(field ? kFarSight : 0);
    for (int k = begin; k < end; ++k) find_contact(m, o, w, m.grp_con[k], nullptr);
    return;
  }
  Far far{far_from(m, o, cluster, fast)};
  w.sight = field ? far.from : T{};
  if (m.cluster_round[cluster] >= 0) {
    T gap = least_gap(m, w, A, B, cluster);
    if (!any(gap < far.from)) { w.pass_over({A, B, gap * (1 / o.h) - fast}); return; }
    w.may_touch = within_reach(m, m.grp_con[begin], gap) | (gap < w.sight);
  }
  if (m.con_plane[m.grp_con[begin]] >= 0 && !side) find_on_plane(m, o, w, A, cluster, far);
  else if (side) for (int k = begin; k < end; ++k) find_contact(m, o, w, m.grp_con[k], &far);
  else find_between(m, o, w, cluster, far);
  if (any(far.lowest < 1e300)) w.pass_over({A, B, far.lowest * (1 / o.h) - fast});
}

// Lanes in which the pair of geoms of the k-th given row, or of further ones, has rows.
template <class G>
static Mask lanes_of_pair(const Model& m, const Work<G>& w, int k) {
  Mask lanes = none();
  for (int i = k; i < w.ngiven && m.con_group[w.given[i].index] == m.con_group[w.given[k].index]; ++i)
    if (m.con_pair[w.given[i].index] == m.con_pair[w.given[k].index]) lanes |= w.given[i].on;
  return lanes;
}

// Rows that may close within the step, ordered by body pair. given: those of w.given instead (a step read back from its tape).
template <class G>
static void find_contacts(const Model& m, const Options& o, Work<G>& w, bool given) {
  w.ncon = w.ngroups = w.nleft = 0;
  w.left_out_gap = splat(__builtin_inf());
  w.coupled = false;
  look_afresh(o, w);
  for (int k = 0; given && k < w.ngiven;) {
    int g = m.con_group[w.given[k].index], first = w.ncon;
    open_group(m, w, g);
    for (; k < w.ngiven && m.con_group[w.given[k].index] == g; ++k) {
      w.may_touch = lanes_of_pair(m, w, k);
      find_contact(m, o, w, w.given[k].index, nullptr, &w.given[k]);
    }
    w.add_group({g, first, w.ncon});
  }
  if (!given) {
    find_near(m, o, w);
    for_near(m, w, [&](int g) {
      int first = w.ncon;
      open_group(m, w, g);
      T fast = w.sift ? fastest_of_pair(m, o, w, m.grp_A[g], m.grp_B[g]) : T{};
      for_clusters(m, o, w, g, fast, [&](int c) { find_in_cluster(m, o, w, g, c, fast); },
                   [&](T gap) { w.pass_over({m.grp_A[g], m.grp_B[g], gap * (1 / o.h) - fast}); });
      if (w.ncon > first) w.add_group({g, first, w.ncon});
    });
  }
  if (w.coupled) find_fill(m, w);
  else w.make_factor(m.nv, m.mass.ptr[m.nv]);
}

}  // namespace cmbrl::CMBRL_ISA
