#include "scene/scene_data.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

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
  m.oFluid = m.oAct + m.nact * kActuatorFields;
  m.oGravity = m.oFluid + 2;
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
  m.nshape = size("nshape"); m.ninertial = size("ninertial"); m.nweight = size("nweight");
  size_t ns = m.nshape, kinds = m.planar ? 1 : 6;
  m.shape_body = i("shape_body", ns); m.shape_mass = i("shape_mass", ns); m.shape_par = i("shape_par", ns * kinds);
  m.shape_root = d("shape_root", ns * D * D);
  size_t nweight = m.nweight;
  m.inertial_par = i("inertial_par", m.ninertial); m.weight_span = i("weight_span", nweight * 2); m.weight_slopes = i("weight_slopes", nweight + 1);
  m.weight_body = i("weight_body", nweight); m.weight_carried = i("weight_carried", nweight); m.weight_point = d("weight_point", nweight * D);
  m.weight_ptr = i("weight_ptr", nweight + 1); m.weight_row_ptr = i("weight_row_ptr", m.weight_ptr[nweight] + 1);
  size_t entries = m.weight_row_ptr[m.weight_ptr[nweight]];
  m.weight_dof = i("weight_dof", entries); m.weight_coef = d("weight_coef", entries); m.weight_nominal = d("weight_nominal", nweight);
  m.q0 = d("q0", m.nq);
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
