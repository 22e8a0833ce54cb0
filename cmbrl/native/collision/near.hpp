// Broad phase: which pairs of bodies, and of geoms, may have an active contact in this step. A sphere around what each body
// touches with, grown by what it can travel in the step and by half of what pruning allows, must meet the other's; then so must
// those around the geoms, or a geom's the plane. What is far is not looked at, and no contact that pruning would keep is lost.
#pragma once
#include "dynamics/dynamics.hpp"
#include "collision/pruning.hpp"

namespace cmbrl::CMBRL_ISA {

// How fast any point of a body's sphere may move under a twist.
template <class G>
static T fastest(const Model& m, const Work<G>& w, const Vec<G::N>* twist, int b) {
  typename G::V u = point_velocity<G>(twist[b], w.centre[b]);
  typename G::Ang turn = ang<G>(twist[b]);
  return vsqrt(dot(u, u)) + m.sphere_radius[b] * vsqrt(dot(turn, turn));
}

// Grown spheres that hold all of a body where a row with slack [m/s] below `slack` may be, half of it a body's share; speed: of
// the body, before the step and, where that is known, after.
template <class G>
static void grow_sphere(const Model& m, const Options& o, Work<G>& w, int b, T speed, T slack) {
  double radius = m.sphere_radius[b] * (1 + 1e-9);  // round-off of the test itself
  w.reach[b] = radius + 0.5 * w.radius_slack + o.h * vmax(speed + 0.5 * slack, T{});
}

template <class G>
static Mask spheres_meet(const Work<G>& w, int a, int b) {
  typename G::V apart = w.centre[a] - w.centre[b];
  T reach = w.reach[a] + w.reach[b];
  return dot(apart, apart) <= (1 + 1e-9) * reach * reach;
}

// Sorts numbers by key: Shell's method, quick for the hundreds of bodies that it is for.
static inline void sort_by(const double* key, int* numbers, int n) {
  for (int gap = n / 2; gap > 0; gap = gap == 2 ? 1 : int(gap / 2.2))
    for (int i = gap; i < n; ++i) {
      int x = numbers[i], j = i;
      for (; j >= gap && key[numbers[j - gap]] > key[x]; j -= gap) numbers[j] = numbers[j - gap];
      numbers[j] = x;
    }
}

// Calls f(a, b) for bodies whose extents along the axis of the widest scene overlap in some lanes: sweep and prune.
template <class G, class F>
static void sweep(const Model& m, Work<G>& w, F f) {
  int n = 0, axis = 0;
  double widest = -1;
  for (int b = 0; b < m.nbody; ++b)
    if (m.sphere_radius[b] >= 0) w.order[n++] = b;
  CMBRL_FOR(k, G::D) {
    double low = 1e300, high = -1e300;
    for (int i = 0; i < n; ++i) {
      double x = w.centre[w.order[i]][k][0];
      low = x < low ? x : low;
      high = x > high ? x : high;
    }
    if (high - low > widest) { widest = high - low; axis = k; }
  }
  for (int i = 0; i < n; ++i) {
    int b = w.order[i];
    T low = w.centre[b][axis] - w.reach[b], high = w.centre[b][axis] + w.reach[b];
    w.low[b] = low[0];
    w.high[b] = high[0];
    for (int lane = 1; lane < W; ++lane) {
      if (low[lane] < w.low[b]) w.low[b] = low[lane];
      if (high[lane] > w.high[b]) w.high[b] = high[lane];
    }
  }
  sort_by(w.low, w.order, n);
  for (int i = 0; i < n; ++i)
    for (int j = i + 1; j < n && w.low[w.order[j]] <= w.high[w.order[i]]; ++j) f(w.order[i], w.order[j]);
}

// Calls f(group, lanes) for groups of two bodies whose spheres meet in these lanes.
template <class G, class F>
static void for_meeting(const Model& m, Work<G>& w, F f) {
  if (m.pair_ptr[m.nbody] <= 4 * m.nbody) {  // a robot's own: fewer than the neighbours along an axis would be
    for (int a = 0; a < m.nbody; ++a)
      for (int e = m.pair_ptr[a]; e < m.pair_ptr[a + 1]; ++e)
        if (Mask lanes = spheres_meet(w, a, m.pair_other[e]); any(lanes)) f(m.pair_group[e], lanes);
    return;
  }
  sweep(m, w, [&](int a, int b) {
    Mask lanes = spheres_meet(w, a, b);
    if (!any(lanes)) return;
    if (a > b) { int x = a; a = b; b = x; }
    int low = m.pair_ptr[a], high = m.pair_ptr[a + 1];
    while (low < high) {  // the first entry of body a that is not before b
      int middle = (low + high) / 2;
      if (m.pair_other[middle] < b) low = middle + 1;
      else high = middle;
    }
    for (; low < m.pair_ptr[a + 1] && m.pair_other[low] == b; ++low) f(m.pair_group[low], lanes);
  });
}

// A speed at which no row separates that matters, nor one whose gap does (the published rule for kappa).
static inline double speed_of_far(const Options& o, double weight) {
  auto of = [&](const Smoothing& s) {
    return __builtin_fmax(o.look_ahead ? speed_that_matters(o, s, weight) : 0, s.mode == kNearest ? 6 * s.length / o.h : 0);
  };
  return __builtin_fmax(of(o.forward), of(o.backward));
}

// Marks the groups of contacts to look at in w.near: those with the world, and those of two bodies that may touch. The law may
// make a row's slack less than phi / h by twice its speed.
template <class G>
static void find_near(const Model& m, const Options& o, Work<G>& w) {
  bool all_groups = !(o.prune < 1e300) || m.logistic;
  w.sift = m.sifted && !all_groups;
  w.npassed = 0;
  for (int i = 0; i < FillPattern::words(m.ngroup); ++i) w.near[i] = all_groups ? ~uint64_t(0) : m.grp_world[i];
  if (all_groups || (m.pair_ptr[m.nbody] == 0 && !w.sift)) return;
  T enough = splat(speed_of_far(o, m.largest_invweight));
  for (int b = 0; b < m.nbody; ++b) {
    if (m.sphere_radius[b] < 0) continue;  // touches nothing
    w.centre[b] = w.pos[b] + G::rotate(w.R[b], load<G::D>(m.sphere_pos + b * G::D));
    w.fast[b] = o.look_ahead ? fastest(m, w, w.vel, b) : T{};
    for (int k = 0; o.look_ahead && k < w.nguess; ++k) w.fast[b] = vmax(w.fast[b], fastest(m, w, w.guess_twist + k * m.nbody, b));
    grow_sphere(m, o, w, b, 2.0 * w.fast[b], enough);
  }
  for_meeting(m, w, [&](int g, Mask) { w.near[g / 64] |= uint64_t(1) << g % 64; });
}

// How fast A and B may approach or part, under their twists, where they are closest: along the normal, both ends of what lies between them
// move alike, and one of them is in the smaller of the bodies' spheres.
template <class G>
static T fastest_between(const Model& m, const Work<G>& w, const Vec<G::N>* twist, int A, int B) {
  int in = A < 0 ? B : B < 0 || m.sphere_radius[A] < m.sphere_radius[B] ? A : B;
  Vec<G::N> t = A < 0 ? twist[B] : twist[A];
  if (A >= 0 && B >= 0) t -= twist[B];
  typename G::V u = point_velocity<G>(t, w.centre[in]);
  typename G::Ang turn = ang<G>(t);
  return vsqrt(dot(u, u)) + m.sphere_radius[in] * vsqrt(dot(turn, turn));
}
// The same under all velocities that rows are left out by.
template <class G>
static T fastest_of_pair(const Model& m, const Options& o, const Work<G>& w, int A, int B) {
  if (!o.look_ahead) return T{};
  T fast = fastest_between(m, w, w.vel, A, B);
  for (int k = 0; k < w.nguess; ++k) fast = vmax(fast, fastest_between(m, w, w.guess_twist + k * m.nbody, A, B));
  return fast;
}

// A box around one side of a cluster, in the world.
template <class G> struct Hull { typename G::V centre, axis[G::D]; const double* half; };
template <class G>
static Hull<G> hull_of(const Work<G>& w, int body, const double* box) {
  Hull<G> hull;
  typename G::V x = load<G::D>(box);
  hull.centre = body >= 0 ? w.pos[body] + G::rotate(w.R[body], x) : x - w.O;
  CMBRL_FOR(k, G::D) {
    typename G::V axis = load<G::D>(box + (1 + k) * G::D);
    hull.axis[k] = body >= 0 ? G::rotate(w.R[body], axis) : axis;
  }
  hull.half = box + (1 + G::D) * G::D;
  return hull;
}
// Two boxes are apart by at least this: along the axes of either.
template <class G>
static T distance_of(const Hull<G>& a, const Hull<G>& b) {
  typename G::V apart = a.centre - b.centre;
  T of_a[G::D], of_b[G::D], most = splat(-1e300);
  CMBRL_FOR(k, G::D) {
    of_a[k] = vabs(dot(a.axis[k], apart)) - a.half[k];
    of_b[k] = vabs(dot(b.axis[k], apart)) - b.half[k];
  }
  CMBRL_FOR(i, G::D) CMBRL_FOR(k, G::D) {
    T along = vabs(dot(a.axis[i], b.axis[k]));
    of_a[i] -= along * b.half[k];
    of_b[k] -= along * a.half[i];
  }
  CMBRL_FOR(k, G::D) most = vmax(most, vmax(of_a[k], of_b[k]));
  return most;
}

// The gap of all candidates of cluster k is at least this.
template <class G>
static T least_gap(const Model& m, const Work<G>& w, int A, int B, int k) {
  constexpr int size = (2 + G::D) * G::D;
  Hull<G> a = hull_of(w, A, m.cluster_boxA + k * size);
  int plane = m.con_plane[m.grp_con[m.cluster_begin[k]]];
  T slack = w.radius_slack + m.cluster_round[k];
  if (plane < 0) return distance_of(a, hull_of(w, B, m.cluster_boxB + k * size)) - slack;
  typename G::V n = load<G::D>(m.plane_normal + plane * G::D);
  T height = dot(n, a.centre + w.O) - w.P[m.oPlane + plane];
  CMBRL_FOR(i, G::D) height -= a.half[i] * vabs(dot(n, a.axis[i]));
  return height - slack;
}

// Lanes in which the velocity of twists w.tn brings together a pair that was passed over.
template <class G>
static Mask passed_over(const Model& m, const Options& o, Work<G>& w) {
  Mask found = none(), faster = none();
  if (!o.look_ahead || (m.pair_ptr[m.nbody] == 0 && !w.sift)) return found;
  double spare = o.prune / 3;
  for (int b = 0; b < m.nbody; ++b) {
    if (m.sphere_radius[b] < 0) continue;
    w.after[b] = fastest(m, w, w.tn, b);
    faster |= w.after[b] > w.fast[b] + spare;
  }
  T speed = T{};
  for (int i = 0; i < w.npassed; ++i) {
    const Passed &p = w.passed[i], &before = w.passed[i - (i > 0)];
    if (i == 0 || p.A != before.A || p.B != before.B) speed = fastest_between(m, w, w.tn, p.A, p.B);
    found |= p.slack - speed < spare;
  }
  if (!any(faster)) return found;
  for (int b = 0; b < m.nbody; ++b)
    if (m.sphere_radius[b] >= 0) grow_sphere(m, o, w, b, w.fast[b] + w.after[b], splat(spare));
  for_meeting(m, w, [&](int g, Mask lanes) {
    if (!(w.near[g / 64] >> g % 64 & 1)) found |= lanes;
  });
  return found;
}

// Calls f(group) for those marked, in order.
template <class G, class F>
static void for_near(const Model& m, const Work<G>& w, F f) {
  for (int word = 0; word < FillPattern::words(m.ngroup); ++word)
    for (uint64_t left = w.near[word]; left; left &= left - 1)
      if (int g = 64 * word + __builtin_ctzll(left); g < m.ngroup) f(g);
}

}  // namespace cmbrl::CMBRL_ISA
