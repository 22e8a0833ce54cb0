#include "scene/scene_data.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "base/fill.hpp"

namespace cmbrl {

const int* SceneData::i(const std::string& name, size_t size) {
  auto it = ints_.find(name);
  if (it == ints_.end() || it->second.size() != size)
    throw std::invalid_argument("scene array '" + name + "' is missing or has the wrong size, expected " + std::to_string(size));
  return it->second.data();
}
const double* SceneData::d(const std::string& name, size_t size) {
  auto it = doubles_.find(name);
  if (it == doubles_.end() || it->second.size() != size)
    throw std::invalid_argument("scene array '" + name + "' is missing or has the wrong size, expected " + std::to_string(size));
  return it->second.data();
}

const int* SceneData::keep_ints(const std::string& name, std::vector<int> x) { return (ints_[name] = std::move(x)).data(); }
const double* SceneData::keep_doubles(const std::string& name, std::vector<double> x) { return (doubles_[name] = std::move(x)).data(); }

SceneData::SceneData(std::map<std::string, std::vector<int>> ints, std::map<std::string, std::vector<double>> doubles,
                     const std::map<std::string, int>& sizes)
    : ints_(std::move(ints)), doubles_(std::move(doubles)) {
  Model& m = model;
  auto size = [&](const char* name) { return sizes.at(name); };
  m.planar = size("planar");
  m.implicit_damping = size("implicit_damping"); m.implicit_gains = size("implicit_gains"); m.refsafe = size("refsafe"); m.ngyro = size("ngyro");
  m.D = m.planar ? 2 : 3;
  m.nq = size("nq"); m.nv = size("nv"); m.nu = size("nu");
  m.nbody = size("nbody"); m.njoint = size("njoint"); m.ncontact = size("ncontact");
  m.nplane = size("nplane"); m.nlimit = size("nlimit"); m.nact = size("nact"); m.nforcerange = size("nforcerange"); m.nlift = size("nlift");
  m.nstate = size("nstate");
  m.nwide = size("nwide"); m.nlink = size("nlink"); m.nbox = size("nbox"); m.nellipsoid = size("nellipsoid"); m.nballspring = size("nballspring"); m.npower = size("npower");
  m.ntendon = size("ntendon"); m.nseg = size("nseg"); m.nwrap = size("nwrap"); m.ntie = size("ntie");
  m.nline = m.nv + m.ntendon;
  m.body_fields = m.planar ? 4 : 10;
  m.oDof = m.nbody * m.body_fields;
  m.oPlane = m.oDof + m.nline * kDofFields;
  m.oAct = m.oPlane + m.nplane;
  m.oGravity = m.oAct + m.nact * kActuatorFields;
  m.oContact = m.oGravity + m.D;
  m.nP = m.oContact + m.ncontact * kContactFields;
  size_t nb = m.nbody, nj = m.njoint, nc = m.ncontact, nl = m.nlimit, na = m.nact, ne = m.ntie, D = m.D;
  m.body_parent = i("body_parent", nb); m.body_jadr = i("body_jadr", nb); m.body_jnum = i("body_jnum", nb);
  m.body_pos = d("body_pos", nb * D); m.body_rot = d("body_rot", nb * (m.planar ? 2 : 9));
  m.jnt_type = i("jnt_type", nj); m.jnt_qadr = i("jnt_qadr", nj); m.jnt_vadr = i("jnt_vadr", nj);
  m.jnt_axis = d("jnt_axis", nj * D); m.jnt_pos = d("jnt_pos", nj * D); m.jnt_q0 = d("jnt_q0", nj);
  m.con_type = i("con_type", nc); m.con_bodyA = i("con_bodyA", nc); m.con_bodyB = i("con_bodyB", nc);
  m.con_plane = i("con_plane", nc); m.con_pair = i("con_pair", nc); m.con_dim = i("con_dim", nc); m.con_law = i("con_law", nc); m.logistic = nc > 0 && m.con_law[0] == kLogistic; m.con_pyramid = i("con_pyramid", nc);
  m.con_along = d("con_along", nc * 3); m.con_ratio = d("con_ratio", nc * 2);
  m.con_glide = i("con_glide", nc); m.glide_twist = d("glide_twist", size_t(size("nglide")) * 12);
  size_t hulls = size("nhull"), faces = size("nface");
  m.con_when = i("con_when", nc); m.con_hullB = i("con_hullB", nc); m.con_first = i("con_first", nc); m.con_many = i("con_many", nc);
  m.con_hull = i("con_hull", nc); m.hull_ptr = i("hull_ptr", hulls + 1); m.face_ptr = i("face_ptr", faces + 1);
  m.face_vertex = i("face_vertex", m.face_ptr[faces]); m.vertex_ptr = i("vertex_ptr", size_t(m.hull_ptr[hulls]) + 1);
  m.vertex_face = i("vertex_face", m.vertex_ptr[m.hull_ptr[hulls]]);
  m.hull_kind = i("hull_kind", hulls);
  m.next_ptr = i("next_ptr", size_t(m.hull_ptr[hulls]) + 1); m.vertex_next = i("vertex_next", m.next_ptr[m.hull_ptr[hulls]]);
  m.hull_graph = i("hull_graph", hulls); m.climb_start = i("climb_start", size_t(Model::climb_cells) * std::count_if(m.hull_graph, m.hull_graph + hulls, [](int k) { return k >= 0; }));
  size_t fields = size("nfield");
  m.prism = size("prism"); m.hull_field = i("hull_field", hulls); m.field_size = i("field_size", 2 * fields);
  m.field_ptr = i("field_ptr", fields + 1); m.field_height = d("field_height", m.field_ptr[fields]);
  m.hull_point = d("hull_point", size_t(m.hull_ptr[hulls]) * 3); m.face_normal = d("face_normal", faces * 3);
  m.con_posA = d("con_posA", nc * D); m.con_axisA = d("con_axisA", nc * D); m.con_posB = d("con_posB", nc * D);
  m.con_axisB = d("con_axisB", nc * D); m.con_rotB = d("con_rotB", nc * D * D); m.con_halfB = d("con_halfB", nc * D);
  m.con_rotA = d("con_rotA", nc * D * D);
  m.con_radiusB = d("con_radiusB", nc);
  m.con_impratio = d("con_impratio", nc); m.con_invweight = d("con_invweight", nc); m.con_margin = d("con_margin", nc);
  m.con_reach = d("con_reach", nc); m.con_points = d("con_points", nc);
  m.con_mid = d("con_mid", nc); m.con_power = d("con_power", nc); m.plane_normal = d("plane_normal", size_t(m.nplane) * D);
  m.lim_line = i("lim_line", nl); m.lim_ball = i("lim_ball", nl); m.lim_lo = d("lim_lo", nl); m.lim_hi = d("lim_hi", nl);
  m.lim_margin = d("lim_margin", nl); m.lim_soft = d("lim_soft", nl * 7); m.lim_invweight = d("lim_invweight", nl);
  m.gyro_dof = i("gyro_dof", m.nv);
  m.frc_dof = i("frc_dof", m.nforcerange); m.frc_range = d("frc_range", size_t(m.nforcerange) * 2);
  if (m.nlift > 0) {
    m.dof_lift = i("dof_lift", m.nv); m.body_lift = d("body_lift", nb); m.body_lift_pos = d("body_lift_pos", nb * D);
  }
  size_t nw = m.nwide, nf = m.nbox, N = m.planar ? 3 : 6;
  m.wide_act = i("wide_act", nw); m.wide_body = i("wide_body", nw); m.wide_ptr = i("wide_ptr", nw + 1);
  m.wide_dof = i("wide_dof", m.wide_ptr[nw]); m.wide_coef = d("wide_coef", m.wide_ptr[nw]); m.wide_local = d("wide_local", nw * N);
  m.grip_ptr = i("grip_ptr", nw + 1); i("grip_con", m.grip_ptr[nw]);
  m.box_body = i("box_body", nf); m.box_pos = d("box_pos", nf * D); m.box_rot = d("box_rot", nf * (m.planar ? 2 : 9));
  m.box_linear = d("box_linear", nf * N); m.box_quadratic = d("box_quadratic", nf * N); m.wind = d("wind", D);
  size_t nE = m.nellipsoid;
  m.ellipsoid_body = i("ellipsoid_body", nE); m.ellipsoid_pos = d("ellipsoid_pos", nE * 3); m.ellipsoid_rot = d("ellipsoid_rot", nE * 9);
  m.ellipsoid_coef = d("ellipsoid_coef", nE * 19);
  m.spring_dof = i("spring_dof", m.nballspring); m.spring_qadr = i("spring_qadr", m.nballspring);
  m.spring_ref = d("spring_ref", size_t(m.nballspring) * 4);
  m.power_dof = i("power_dof", m.npower); m.power_coef = d("power_coef", size_t(m.npower) * 4);
  m.line_soft = d("line_soft", size_t(m.nline) * 7); m.line_invweight = d("line_invweight", m.nline); m.line_slack = d("line_slack", m.nline);
  m.tie_type = i("tie_type", ne); m.tie_A = i("tie_A", ne); m.tie_B = i("tie_B", ne);
  m.tie_posA = d("tie_posA", ne * D); m.tie_posB = d("tie_posB", ne * D);
  m.tie_rotA = d("tie_rotA", ne * (m.planar ? 2 : 9)); m.tie_rotB = d("tie_rotB", ne * (m.planar ? 2 : 9));
  m.tie_scale = d("tie_scale", ne); m.tie_poly = d("tie_poly", ne * 5); m.tie_ref = d("tie_ref", ne * 2);
  m.tie_soft = d("tie_soft", ne * 7); m.tie_invweight = d("tie_invweight", ne * 2);
  m.act_line = i("act_line", na); m.act_ctrl = d("act_ctrl", na * 2); m.act_force = d("act_force", na * 2); m.act_gain = d("act_gain", na * 2);
  m.act_period = d("act_period", na);
  m.act_ripple = d("act_ripple", na * 3);
  for (size_t k = 0; k < na; ++k) m.nripple += m.act_ripple[3 * k] != 0;
  m.feed_ptr = i("feed_ptr", na + 1); m.nfeed = m.feed_ptr[na]; m.feed_act = i("feed_act", m.nfeed);
  m.nperiod = int(std::count_if(m.act_period, m.act_period + na, [](double x) { return x > 0; }));
  size_t nx = m.nstate;
  m.act_state = i("act_state", na); m.state_act = i("state_act", nx); m.state_kind = i("state_kind", nx); m.state_early = i("state_early", nx);
  m.state_range = d("state_range", nx * 2);
  m.P = d("P", m.nP);
  m.ntheta = int(doubles_.at("par_nominal").size());
  m.par_nominal = d("par_nominal", m.ntheta);
  m.par_ptr = i("par_ptr", m.ntheta + 1);
  m.par_idx = i("par_idx", m.par_ptr[m.ntheta]); m.par_coef = d("par_coef", m.par_ptr[m.ntheta]);
  m.nshape = size("nshape"); m.nmass = size("nmass"); m.nweight = size("nweight");
  size_t ns = m.nshape, kinds = m.planar ? 1 : 6;
  m.shape_body = i("shape_body", ns); m.shape_mass = i("shape_mass", ns); m.shape_par = i("shape_par", ns * kinds);
  m.shape_root = d("shape_root", ns * D * D);
  m.weight_ptr = i("weight_ptr", m.nweight + 1); m.weight_mass = i("weight_mass", m.weight_ptr[m.nweight]);
  m.mass_par = i("mass_par", m.nmass); m.weight_coef = d("weight_coef", m.weight_ptr[m.nweight]);
  m.con_weight = i("con_weight", nc * 2); m.con_share = d("con_share", nc * 2); m.lim_weight = i("lim_weight", nl); m.line_weight = i("line_weight", m.nline);
  derive_parameters();
  m.most_rows = m.planar ? 2 : 3;
  for (size_t k = 0; k < nc; ++k) m.most_rows = std::max(m.most_rows, rows_of_contact(m.planar, m.con_dim[k]));
  for (size_t k = 0; k < nc; ++k) m.largest_invweight = std::max(m.largest_invweight, m.con_invweight[k]);
  derive_chains();
  derive_lines();
  derive_segments();
  derive_linkages();
  derive_ties();
  derive_mass_pattern();
  derive_groups();
  derive_pairs();
  derive_hulls(int(hulls));
  derive_spheres();
  order_groups();
  derive_clusters();
  derive_bundles();
  derive_kins();
  derive_grips();
}

// Parameters that move contacts are listed by contact, the others by parameter.
void SceneData::derive_parameters() {
  Model& m = model;
  std::vector<int> ptr{0}, idx, con_ptr(m.ncontact + 1, 0), radii(m.ncontact, 0);
  std::vector<double> coef, par_radius(m.ntheta, 0.0);
  auto contact = [&](int e) { return m.par_idx[e] >= m.oContact ? (m.par_idx[e] - m.oContact) / kContactFields : -1; };
  for (int e = 0; e < m.par_ptr[m.ntheta]; ++e)
    if (contact(e) >= 0) ++con_ptr[contact(e) + 1];
  for (int c = 0; c < m.ncontact; ++c) con_ptr[c + 1] += con_ptr[c];
  std::vector<int> next = con_ptr, par(con_ptr.back()), field(con_ptr.back());
  std::vector<double> con_coef(con_ptr.back());
  for (int k = 0; k < m.ntheta; ++k) {
    for (int e = m.par_ptr[k]; e < m.par_ptr[k + 1]; ++e) {
      int c = contact(e);
      if (c < 0) {
        idx.push_back(m.par_idx[e]);
        coef.push_back(m.par_coef[e]);
        continue;
      }
      int at = next[c]++;
      par[at] = k;
      field[at] = (m.par_idx[e] - m.oContact) % kContactFields;
      con_coef[at] = m.par_coef[e];
      if (field[at] != kRadius) continue;
      par_radius[k] = std::max(par_radius[k], std::abs(m.par_coef[e]));
      m.radius_moves = std::max(m.radius_moves, ++radii[c]);
    }
    ptr.push_back(int(idx.size()));
  }
  m.par_ptr = keep_ints("par_ptr", std::move(ptr)); m.par_idx = keep_ints("par_idx", std::move(idx));
  m.par_coef = keep_doubles("par_coef", std::move(coef)); m.par_radius = keep_doubles("par_radius", std::move(par_radius));
  m.con_par_ptr = keep_ints("con_par_ptr", std::move(con_ptr)); m.con_par = keep_ints("con_par", std::move(par));
  m.con_par_field = keep_ints("con_par_field", std::move(field)); m.con_par_coef = keep_doubles("con_par_coef", std::move(con_coef));
  std::vector<int> shape(m.ntheta, -1);
  int kinds = m.planar ? 1 : 6;
  for (int s = 0; s < m.nshape; ++s) {
    shape[m.shape_mass[s]] = s;
    for (int j = 0; j < kinds; ++j)
      if (int k = m.shape_par[s * kinds + j]; k >= 0) shape[k] = s;
  }
  std::vector<int> of_contacts(m.ntheta);
  for (int k = 0; k < m.ntheta; ++k) of_contacts[k] = m.par_ptr[k] == m.par_ptr[k + 1] && shape[k] < 0;
  m.par_of_contacts = keep_ints("par_of_contacts", std::move(of_contacts));
  m.par_shape = keep_ints("par_shape", std::move(shape));
}

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

void SceneData::derive_groups() {
  Model& m = model;
  std::map<std::pair<int, int>, int> number;
  std::vector<int> A, B, group_of(m.ncontact);
  std::vector<std::vector<int>> members;
  for (int c = 0; c < m.ncontact; ++c) {
    auto key = std::make_pair(m.con_bodyA[c], m.con_bodyB[c]);
    auto [it, fresh] = number.emplace(key, int(A.size()));
    if (fresh) { A.push_back(key.first); B.push_back(key.second); members.emplace_back(); }
    members[it->second].push_back(c);
    group_of[c] = it->second;
  }
  std::vector<int> cptr{0}, con, dptr{0}, dof, sign;
  for (size_t g = 0; g < A.size(); ++g) {
    con.insert(con.end(), members[g].begin(), members[g].end());
    cptr.push_back(int(con.size()));
    std::vector<int> a = chain(A[g]), b = chain(B[g]);
    for (size_t x = 0, y = 0; x < a.size() || y < b.size();) {  // both rise; what carries both does not count
      if (x < a.size() && y < b.size() && a[x] == b[y]) { ++x; ++y; continue; }
      bool of_a = y == b.size() || (x < a.size() && a[x] < b[y]);
      dof.push_back(of_a ? a[x++] : b[y++]);
      sign.push_back(of_a ? 1 : -1);
    }
    dptr.push_back(int(dof.size()));
    m.max_group_dofs = std::max(m.max_group_dofs, dptr[g + 1] - dptr[g]);
  }
  m.ngroup = int(A.size());
  auto keep = [&](const char* name, std::vector<int>& x) { return keep_ints(name, std::move(x)); };
  m.grp_A = keep("grp_A", A); m.grp_B = keep("grp_B", B); m.grp_cptr = keep("grp_cptr", cptr); m.grp_con = keep("grp_con", con);
  m.grp_dptr = keep("grp_dptr", dptr); m.grp_dof = keep("grp_dof", dof); m.grp_sign = keep("grp_sign", sign);
  m.con_group = keep("con_group", group_of);
}

// Groups of two moving bodies by those bodies, and the bits of the others.
void SceneData::derive_pairs() {
  Model& m = model;
  std::vector<int> ptr(m.nbody + 1, 0), groups, other;
  world_.assign((m.ngroup + 63) / 64, 0);
  for (int g = 0; g < m.ngroup; ++g) {
    if (m.grp_A[g] < 0 || m.grp_B[g] < 0) world_[g / 64] |= uint64_t(1) << g % 64;
    else groups.push_back(g);
  }
  auto bodies = [&](int g) { return std::minmax(m.grp_A[g], m.grp_B[g]); };
  std::stable_sort(groups.begin(), groups.end(), [&](int x, int y) { return bodies(x) < bodies(y); });
  for (int g : groups) {
    other.push_back(bodies(g).second);
    ++ptr[bodies(g).first + 1];
  }
  for (int b = 0; b < m.nbody; ++b) ptr[b + 1] += ptr[b];
  m.grp_world = world_.data();
  m.pair_ptr = keep_ints("pair_ptr", std::move(ptr)); m.pair_other = keep_ints("pair_other", std::move(other));
  m.pair_group = keep_ints("pair_group", std::move(groups));
}

}  // namespace cmbrl
