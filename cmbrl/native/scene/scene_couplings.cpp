// Which dofs of a scene move together: along chains of bodies, by tendons, linkages and ties; the pattern of its mass matrix.
#include "scene/scene_data.hpp"

#include <algorithm>
#include <cstdint>

#include "base/fill.hpp"

namespace cmbrl {

void SceneData::derive_chains() {
  Model& m = model;
  std::vector<int> body(m.nv), joint(m.nv), qadr(m.nv), last(m.nbody, -1), ptr{0}, idx;
  std::vector<std::vector<int>> chain(m.nbody);
  for (int b = 0; b < m.nbody; ++b) {
    std::vector<int> above = m.body_parent[b] >= 0 ? chain[m.body_parent[b]] : std::vector<int>{};
    for (int j = m.body_jadr[b]; j < m.body_jadr[b] + m.body_jnum[b]; ++j)
      for (int k = 0; k < (m.jnt_type[j] == kBall ? 3 : 1); ++k) {
        int dof = m.jnt_vadr[j] + k;
        if (dof != int(ptr.size()) - 1) throw std::invalid_argument("scene dofs are not in depth-first order");
        body[dof] = b; joint[dof] = j; qadr[dof] = m.jnt_type[j] == kBall ? -1 : m.jnt_qadr[j];
        idx.insert(idx.end(), above.begin(), above.end());
        ptr.push_back(int(idx.size()));
        above.push_back(dof);
        last[b] = dof;
      }
    if (last[b] < 0) throw std::invalid_argument("scene body " + std::to_string(b) + " has no joint");
    chain[b] = above;
  }
  ints_["dof_body"] = body; ints_["dof_jnt"] = joint; ints_["dof_qadr"] = qadr; ints_["body_lastdof"] = last;
  ints_["anc_ptr"] = ptr; ints_["anc_idx"] = idx;
  m.dof_body = ints_["dof_body"].data(); m.dof_jnt = ints_["dof_jnt"].data(); m.dof_qadr = ints_["dof_qadr"].data();
  m.body_lastdof = ints_["body_lastdof"].data(); m.anc_ptr = ints_["anc_ptr"].data(); m.anc_idx = ints_["anc_idx"].data();
}

// Dofs that carry a body, rising.
std::vector<int> SceneData::chain(int body) const {
  const Model& m = model;
  if (body < 0) return {};
  int d = m.body_lastdof[body];
  std::vector<int> dofs(m.anc_idx + m.anc_ptr[d], m.anc_idx + m.anc_ptr[d + 1]);
  dofs.push_back(d);
  return dofs;
}

// The dofs themselves, then the tendons.
void SceneData::derive_lines() {
  Model& m = model;
  const int* ptr = i("tendon_ptr", m.ntendon + 1);
  const int* tendon_dof = i("tendon_dof", ptr[m.ntendon]);
  const double* tendon_coef = d("tendon_coef", ptr[m.ntendon]);
  std::vector<int> at, dof;
  for (int k = 0; k < m.nv; ++k) { at.push_back(k); dof.push_back(k); }
  for (int k = 0; k <= m.ntendon; ++k) at.push_back(m.nv + ptr[k]);
  std::vector<double> coef(m.nv, 1.0);
  dof.insert(dof.end(), tendon_dof, tendon_dof + ptr[m.ntendon]);
  coef.insert(coef.end(), tendon_coef, tendon_coef + ptr[m.ntendon]);
  for (int k = 0; k < m.ntendon; ++k)
    for (int e = ptr[k]; e < ptr[k + 1]; ++e)
      if (tendon_dof[e] < 0 || tendon_dof[e] >= m.nv || (e > ptr[k] && tendon_dof[e] <= tendon_dof[e - 1]))
        throw std::invalid_argument("the dofs of scene tendon " + std::to_string(k) + " do not rise");
  m.line_ptr = keep_ints("line_ptr", std::move(at)); m.line_dof = keep_ints("line_dof", std::move(dof));
  m.line_coef = keep_doubles("line_coef", std::move(coef));
}

// Segments of tendons: which of their ends, and of what they go around, the dofs of the tendon carry.
void SceneData::derive_segments() {
  Model& m = model;
  size_t n = m.nseg, D = m.D;
  m.seg_ptr = i("seg_ptr", m.ntendon + 1);
  m.seg_A = i("seg_A", n); m.seg_B = i("seg_B", n);
  m.seg_posA = d("seg_posA", n * D); m.seg_posB = d("seg_posB", n * D); m.seg_scale = d("seg_scale", n);
  size_t around = m.nwrap;
  m.seg_wrap = i("seg_wrap", n); m.wrap_body = i("wrap_body", around); m.wrap_kind = i("wrap_kind", around * 2); m.wrap_site_body = i("wrap_site_body", around);
  m.wrap_pos = d("wrap_pos", around * 3); m.wrap_rot = d("wrap_rot", around * 9); m.wrap_radius = d("wrap_radius", around);
  m.wrap_site = d("wrap_site", around * 3);
  std::vector<int> ptr, side;
  for (int t = 0; t < m.ntendon; ++t)
    for (int s = m.seg_ptr[t]; s < m.seg_ptr[t + 1]; ++s) {
      bool turns = m.seg_wrap[s] >= 0;
      std::vector<int> a = chain(m.seg_A[s]), b = chain(m.seg_B[s]), c = turns ? chain(m.wrap_body[m.seg_wrap[s]]) : a;
      ptr.push_back(int(side.size()));
      for (int e = m.line_ptr[m.nv + t]; e < m.line_ptr[m.nv + t + 1]; ++e) {
        auto carries = [&](const std::vector<int>& dofs) { return std::binary_search(dofs.begin(), dofs.end(), m.line_dof[e]); };
        int all = kCarriesA | kCarriesB | (turns ? kCarriesObstacle : 0);
        int which = (carries(a) ? kCarriesA : 0) | (carries(b) ? kCarriesB : 0) | (turns && carries(c) ? kCarriesObstacle : 0);
        side.push_back(which == all ? 0 : which);
      }
    }
  m.seg_sides = keep_ints("seg_sides", std::move(ptr)); m.seg_side = keep_ints("seg_side", std::move(side));
}

// Linkages: which of their ends the dofs of their lines carry.
void SceneData::derive_linkages() {
  Model& m = model;
  size_t n = m.nlink;
  m.link_line = i("link_line", n); m.link_kind = i("link_kind", n); m.link_A = i("link_A", n); m.link_B = i("link_B", n);
  m.link_turns = i("link_turns", n); m.link_posA = d("link_posA", n * 3); m.link_posB = d("link_posB", n * 3);
  m.link_rotA = d("link_rotA", n * 9); m.link_rotB = d("link_rotB", n * 9); m.link_force = d("link_force", n * 3);
  m.link_torque = d("link_torque", n * 3); m.link_rod = d("link_rod", n);
  std::vector<int> link(m.ntendon, -1), side(m.line_ptr[m.nline], 0);
  for (size_t k = 0; k < n; ++k) {
    link.at(m.link_line[k] - m.nv) = int(k);
    if (m.link_kind[k] >= kOfBall) continue;
    std::vector<int> a = chain(m.link_A[k]);
    for (int e = m.line_ptr[m.link_line[k]]; e < m.line_ptr[m.link_line[k] + 1]; ++e)
      side[e] = std::binary_search(a.begin(), a.end(), m.line_dof[e]) ? 1 : -1;
  }
  m.line_link = keep_ints("line_link", std::move(link));
  m.link_side = keep_ints("link_side", std::move(side));
}

// The dofs that each tie couples: those of two lines, or those that carry two bodies.
void SceneData::derive_ties() {
  Model& m = model;
  std::vector<int> ptr{0}, dof, side, entry_a, entry_b;
  for (int k = 0; k < m.ntie; ++k) {
    struct End { int side = 0, a = -1, b = -1; };
    std::map<int, End> ends;
    auto add_line = [&](int line, int End::*entry) {
      if (line < 0) return;
      for (int e = m.line_ptr[line]; e < m.line_ptr[line + 1]; ++e) ends[m.line_dof[e]].*entry = e;
    };
    if (m.tie_type[k] == kPolynomial) {
      add_line(m.tie_A[k], &End::a);
      add_line(m.tie_B[k], &End::b);
    } else {
      for (int x : chain(m.tie_A[k])) ends[x].side |= kCarriesA;
      for (int x : chain(m.tie_B[k])) ends[x].side |= kCarriesB;
    }
    for (auto [x, end] : ends) { dof.push_back(x); side.push_back(end.side); entry_a.push_back(end.a); entry_b.push_back(end.b); }
    ptr.push_back(int(dof.size()));
  }
  m.tie_ptr = keep_ints("tie_ptr", std::move(ptr)); m.tie_dof = keep_ints("tie_dof", std::move(dof));
  m.tie_side = keep_ints("tie_side", std::move(side));
  m.tie_entryA = keep_ints("tie_entryA", std::move(entry_a)); m.tie_entryB = keep_ints("tie_entryB", std::move(entry_b));
}

// The tree's, and what tendons and ties couple, with its fill-in.
void SceneData::derive_mass_pattern() {
  Model& m = model;
  m.mass = m.tree();
  if (m.ntendon == 0 && m.ntie == 0) return;
  std::vector<uint64_t> bits(size_t(m.nv) * FillPattern::words(m.nv), 0), columns(FillPattern::words(m.nv));
  FillPattern pattern{bits.data(), m.nv};
  for (int k = 0; k < m.nv; ++k)
    for (int a = 0; a < m.mass.count(k); ++a) pattern.couple(k, m.mass.columns(k)[a]);
  auto couple = [&](const int* dof, int begin, int end) {
    std::fill(columns.begin(), columns.end(), 0);
    for (int e = begin; e < end; ++e) columns[dof[e] / 64] |= uint64_t(1) << dof[e] % 64;
    pattern.couple_all(columns.data());
  };
  for (int k = m.nv; k < m.nline; ++k) couple(m.line_dof, m.line_ptr[k], m.line_ptr[k + 1]);
  for (int k = 0; k < m.ntie; ++k) couple(m.tie_dof, m.tie_ptr[k], m.tie_ptr[k + 1]);
  pattern.fill_in();
  std::vector<int> ptr(m.nv + 1), idx(pattern.count());
  pattern.list(ptr.data(), idx.data());
  m.mass.ptr = keep_ints("mass_ptr", std::move(ptr));
  m.mass.idx = keep_ints("mass_idx", std::move(idx));
}

}  // namespace cmbrl
