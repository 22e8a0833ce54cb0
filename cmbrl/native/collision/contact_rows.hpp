// The row of a candidate that may close. A row of a pack costs as much for one lane as for all, so lanes that need different
// candidates of one kin share it: a corner of a box here, an edge of another there.
#pragma once
#include "collision/bundles.hpp"
#include "collision/contact.hpp"

namespace cmbrl::CMBRL_ISA {

// Pattern of the factor when bodies of different chains touch. Only the contacts of this step count: many bodies that might
// touch each other would fill the matrix.
template <class G>
static void find_fill(const Model& m, Work<G>& w) {
  FillPattern fill{w.bits, m.nv};
  fill.clear();
  for (int k = 0; k < m.nv; ++k)
    for (int a = m.mass.ptr[k]; a < m.mass.ptr[k + 1]; ++a) fill.couple(k, m.mass.idx[a]);
  for (int i = 0; i < w.ngroups; ++i) {
    int g = w.groups[i].group;
    if (m.grp_A[g] < 0 || m.grp_B[g] < 0) continue;
    for (int a = m.grp_dptr[g]; a < m.grp_dptr[g + 1]; ++a)
      for (int b = m.grp_dptr[g]; b < a; ++b) fill.couple(m.grp_dof[a], m.grp_dof[b]);
  }
  fill.fill_in();
  w.make_factor(m.nv, fill.count());
  fill.list(w.fill_ptr, w.fill_idx);
  w.fill = {w.fill_ptr, w.fill_idx};
}

// Where candidate i touches, with closest features F, gap phi and the sum of both radii; along its normal alone.
template <class G>
static void place_contact(const Model& m, int i, const Feature<G>& F, T phi, T radius, Contact<G>& c) {
  c.index = i;
  c.edge = 0;
  c.skewed = false;
  c.rows = 1;
  c.hulls = m.con_type[i] == kHulls;
  c.segments = c.hulls || m.con_type[i] == kSegmentSegment;
  c.at = F;
  c.radiusA = radius - m.con_radiusB[i] + F.back;
  c.phi = phi;
  c.p = F.a + F.beside - (c.radiusA + 0.5 * phi) * F.n;
  c.d[0] = F.n;
  c.Wr[0] = join<G>(G::moment(c.p, F.n), F.n);
}

// The row of candidate i with closest features F, gap phi and the block p of P.
template <class G>
static void make_contact(const Model& m, const Options& o, const Work<G>& w, int i, const Feature<G>& F, T phi, const T* p, Contact<G>& c) {
  place_contact(m, i, F, phi, p[kRadius], c);
  std::memcpy(c.P, p, sizeof c.P);
  for (int lane = 0; lane < W; ++lane) c.of[lane] = i;
  c.rows = rows_of_contact(G::D == 2, m.con_dim[i]);
  c.rub = c.rows > 1 ? p[kMu] > 1e-9 : none();
  c.mu = c.full_mu = select(c.rub, p[kMu], splat(1));
  c.skewed = c.rows > 1 && is_skewed(m, i);
  if (c.skewed) skewed_tangents(m, w, i, F.n, c.d + 1);
  else tangents(G{}, F.n, c.d + 1);
  for (int r = 1; r < c.rows && r <= G::NT; ++r) {
    c.Wr[r] = join<G>(G::moment(c.p, c.d[r]), c.d[r]);
    CMBRL_FOR(x, G::N) c.Wr[r][x] = keep(c.rub, c.Wr[r][x]);
  }
  if (c.rows > 1 + G::NT) turning_rows(m, c, p);
  contact_law(m, o, c, p);
  c.root = vsqrt(m.con_invweight[i] + c.Rn);
}

// No contact of group g has been found yet.
template <class G>
static void open_group(const Model& m, Work<G>& w, int g) {
  for (int k = W * m.grp_kin[g]; k < W * m.grp_kin[g + 1]; ++k) w.kin_count[k] = 0;
}

template <class G>
static void take_lanes(Contact<G>& to, const Contact<G>& from, Mask lanes) {
  static_assert(sizeof(Found<G>) % sizeof(T) == 0);
  T* x = reinterpret_cast<T*>(static_cast<Found<G>*>(&to));
  const T* y = reinterpret_cast<const T*>(static_cast<const Found<G>*>(&from));
  for (size_t k = 0; k < sizeof(Found<G>) / sizeof(T); ++k) x[k] = select(lanes, y[k], x[k]);
  auto take = [lanes](Mask& a, Mask b) { a = (a & ~lanes) | (b & lanes); };
  take(to.on, from.on);
  take(to.wide, from.wide);
  take(to.rub, from.rub);
  take(to.convex, from.convex);
  for (int lane = 0; lane < W; ++lane) if (lanes[lane]) to.of[lane] = from.of[lane];
  to.segments |= from.segments;
  to.hulls |= from.hulls;
}

// The n-th candidate of its kin that a lane needs stands in the n-th contact of that kin: lanes of the last contact join those
// that are there, and it stays for the rest.
template <class G>
static void join_kin(const Model& m, Work<G>& w) {
  int last = w.ncon - 1, most = 0, kin = m.con_kin[w.con[last].index];
  Contact<G>& c = w.con[last];
  int *count = w.kin_count + W * kin, *slots = w.kin_slots + m.kin_ptr[kin];
  Mask rest = c.on | c.wide;
  for (int lane = 0; lane < W; ++lane) most = count[lane] > most ? count[lane] : most;
  for (int lane = 0; lane < W; ++lane) {
    if (!rest[lane] || count[lane] == most) continue;
    int n = count[lane];
    Mask lanes = none();
    for (int k = lane; k < W; ++k)
      if (rest[k] && count[k] == n) { lanes[k] = -1; ++count[k]; }
    take_lanes(w.con[slots[n]], c, lanes);
    rest &= ~lanes;
  }
  if (!any(rest)) { --w.ncon; return; }
  for (int lane = 0; lane < W; ++lane) count[lane] += rest[lane] ? 1 : 0;
  slots[most] = last;
  c.on &= rest;
  c.wide &= rest;
}

// The last contact finds its place. One whose tangents are MuJoCo's, which differ by lane, shares no rows.
template <class G>
static void settle_contact(const Model& m, const Options& o, Work<G>& w, const T* p) {
  const Contact<G>& c = w.con[w.ncon - 1];
  if (any(c.convex & (c.on | c.wide)) && m.con_pyramid[c.index]) split_into_edges(m, o, w, p);
  else if (!c.skewed) join_kin(m, w);
}

}  // namespace cmbrl::CMBRL_ISA
