// What the core needs to know of a scene, as plain arrays (built once by scene_data.cpp from Scene.core).
// No templates and no standard containers here: these structs cross the border between instruction sets.
#pragma once
#include <cstdint>

namespace cmbrl {

enum JointType { kSlide = 0, kHinge = 1, kBall = 2 };
enum ContactType { kPointPlane = 0, kPointBox = 1, kSegmentSegment = 2, kRimPlane = 3, kCornerBox = 4, kHulls = 5, kOvalPlane = 6, kDiscPlane = 7 };
enum When { kAlways = 0, kAhead = 1, kClosed = 2 };  // a candidate acts where rows look ahead, or where they do not
enum TieType { kConnect = 0, kWeld = 1, kPolynomial = 2 };  // equality constraints
enum Dynamics { kIntegrator = 0, kFilter = 1, kFilterExact = 2, kFilterRk4 = 3 };  // of actuators with a state; the last: exact but in RK4 steps
enum LinkageKind { kBetweenSites = 0, kOnSite = 1, kSliderCrank = 2, kOfBall = 3, kConstantRate = 4 };  // of what actuators act along (linkages.hpp)
enum Side { kCarriesA = 1, kCarriesB = 2, kCarriesObstacle = 4 };
enum ContactLaw { kRigid = 0, kMujoco = 1, kSpringDamper = 2, kLogistic = 3 };  // one for all contacts of a scene

// Offsets of one field inside the block of a contact, a line (a dof or a tendon), an actuator in the physical vector P.
enum ContactField { kMu, kRestitution, kRadius, kSolref0, kSolref1, kD0, kDmax, kWidth, kRscale, kSpin, kRoll, kContactFields };
enum DofField { kArmature, kDamping, kStiffness, kSpringref, kFrictionloss, kFrictionSlope, kStribeck, kStribeckSpeed, kWider, kStopTime, kStopDamping, kStopSoftness, kDofFields };
enum ActuatorField { kGear, kGain, kBias0, kBias1, kBias2, kTime, kLimit, kLimitSlope, kGap, kActuatorFields };

// Which dofs couple: all that a contact solve knows of the robot. Columns of row k: idx[ptr[k]] to idx[ptr[k + 1]], all below
// k, rising. A matrix is packed along its pattern: row k is its diagonal, its columns before k, and their mirror images.
struct Pattern {
  const int *ptr, *idx;
  const int* columns(int k) const { return idx + ptr[k]; }
  int count(int k) const { return ptr[k + 1] - ptr[k]; }
  int row(int k) const { return 2 * ptr[k] + k; }  // where it begins; that of row nv: the size of the matrix
};

struct Structure {
  int nv;
  Pattern mass;                    // of the mass matrix, with the fill-in of what it holds of tendons and equality constraints
  Pattern fill;                    // of a contact problem, with the fill-in of its rows; a scene finds it step by step
  const int *grp_dptr, *grp_dof, *grp_sign;  // dofs of J's columns, by group of contacts
  const int *line_ptr, *line_dof;  // lines (lines.hpp): first the dofs, then the tendons
};

// Rows of a contact of this condim under a round cone: the normal, those of sliding, and those that turn (turning.hpp).
static inline int rows_of_contact(bool planar, int condim) { return !planar ? condim : condim == 1 ? 1 : condim == 6 ? 3 : 2; }

struct Model : Structure {
  int planar, implicit_damping, implicit_gains;  // damping of joints, and velocity gains of actuators, act at the next velocity
  int ngyro;                       // dofs whose Coriolis and gyroscopic forces are implicit (gyro.hpp), under split damping
  const int* gyro_dof;             // 1: of these
  int refsafe;                     // time constants of rows stay above two steps
  double least_time(double h) const { return refsafe ? 2 * h : 0; }
  int D, nq, nu, nbody, njoint, ncontact, nplane, nlimit, nact, ntendon, nline, nseg, nwrap, ntie;
  int nforcerange, nlift, nwide, nlink, nbox, nellipsoid, nballspring, npower, nP, ntheta, ngroup;
  int body_fields, oDof, oPlane, oAct, oFluid, oGravity, oContact;  // layout of P; bodies start at 0, contacts end it

  const int *body_parent, *body_jadr, *body_jnum;
  const double *body_pos, *body_rot;
  const int *jnt_type, *jnt_qadr, *jnt_vadr;
  const double *jnt_axis, *jnt_pos, *jnt_q0;

  const int *con_type, *con_bodyA, *con_bodyB, *con_plane, *con_pair, *con_dim, *con_law, *con_pyramid;
  const double *con_posA, *con_axisA, *con_posB, *con_axisB, *con_rotB, *con_halfB, *con_rotA;  // rotA: of a box with a corner, which axisA leads to from its centre; of an ellipsoid or the end of a cylinder over a plane: see oval.hpp and rim.hpp
  const double* con_along;   // (ncontact, 3) of a capsule over a plane: where a tangent of its pyramid points (edges.hpp); of a disc see rim.hpp; or 0
  const int *con_hull, *con_corner;  // of a mesh over a plane, or of hulls: that of A, or -1; its place among the candidates of its pair of geoms
  const int* con_when;       // see When: of two geoms that touch in another way where rows look ahead
  const int *con_hullB, *con_first, *con_many;  // of hulls (hull_contact.hpp): that of B; whether A is MuJoCo's first; more than one point
  const int *hull_ptr, *vertex_ptr, *vertex_face, *face_ptr, *face_vertex;  // side.hpp: vertices of hulls, faces around each; vertices of faces
  const int *next_ptr, *vertex_next, *hull_graph, *climb_start;  // climb.hpp: neighbours of each vertex; of each hull its graph, or -1; where to begin
  const int* hull_block;         // where the columns of each hull begin: x, y and z of its vertices, each as many as hull_width rounds up to
  const double* hull_column;
  const double* hull_bound;      // of each hull, the box around it along the axes of its body's frame: centre, half sizes
  const double* hull_box;        // of each hull that is or fills a box: its centre, three axes, three half sizes
  const double *hull_point, *face_normal;                                   // in the frame of the mesh's body
  const int* hull_kind;                                                     // a HullKind (hull_depth.hpp)
  int prism;                     // the hull that says which corners each side of a field's prisms has, or -1 (field.hpp)
  const int *hull_field, *field_size, *field_ptr;  // the field of each hull, or -1; rows and columns of each; where its heights begin
  const double* field_height;    // [m] above its base
  const int *con_kin, *grp_kin, *kin_ptr;        // candidates that may share a row of a pack: of one group, with laws that differ in lane numbers only
  int nkin;                  // those of group g are numbers grp_kin[g] to grp_kin[g + 1] - 1; kin_ptr: how many candidates those before have
  static constexpr int climb_side = 8, climb_cells = 6 * climb_side * climb_side;  // of directions, along each side of a cube
  static constexpr int hull_width = 16;  // a multiple of any pack's; the last vertex fills up
  int hull_count(int hull) const { return (hull_ptr[hull + 1] - hull_ptr[hull] + hull_width - 1) / hull_width * hull_width; }
  double largest_invweight;  // of a contact
  int logistic;              // contacts act at a distance
  const int* con_glide;      // (ncontact) which surfaces move (glide.hpp), or -1
  const double* glide_twist; // of each, (angular, linear) of A's and of B's about its body's origin, in its frame
  const double* con_ratio;   // (ncontact, 2) of sliding and of rolling friction: the second tangent's by the first's
  const double *con_radiusB, *con_impratio, *con_invweight, *con_margin, *con_mid, *con_power, *plane_normal;
  const double *con_reach, *con_points;  // the gap below which actuators pull at it; how many of MuJoCo's points it stands for

  const double* line_coef;      // of coordinates
  const int *seg_ptr, *seg_A, *seg_B, *seg_wrap;         // segments of each tendon, between two bodies; what each goes around, -1: nothing
  const double *seg_posA, *seg_posB, *seg_scale;
  const int *wrap_body, *wrap_kind, *wrap_site_body;     // wrap.hpp; kinds: whether it is a cylinder, whether it has a site
  const double *wrap_pos, *wrap_rot, *wrap_radius, *wrap_site;
  const int *line_link, *link_line, *link_kind, *link_A, *link_B, *link_turns, *link_side;  // linkages.hpp: of each line after the dofs, or -1; of each linkage: its line, a body or a place in q, ...; by entry of line_dof: 1 if the dof carries A, -1 if B
  const double *link_posA, *link_posB, *link_rotA, *link_rotB, *link_force, *link_torque, *link_rod;
  const int *lim_line, *lim_ball;  // of a ball joint's angle: its last dof, and where its quaternion stands in q; otherwise -1
  const double *lim_lo, *lim_hi, *lim_margin, *lim_soft, *lim_invweight;
  const double *line_soft, *line_invweight, *line_slack;  // of dry friction; width of a spring's slack
  const int* act_line;  // -1: see wide.hpp
  const double *act_ctrl, *act_force, *act_gain;  // act_gain: how the gain on the input changes with length and with velocity
  const double* act_period;  // by which inputs wrap to the nearest to the length; 0: they do not
  const double* act_ripple;  // amplitude, count and phase of a force by length, which limits do not clamp
  const int *feed_ptr, *feed_act;  // further controls that add to the force of each actuator
  int nperiod, nripple, nfeed;
  int nstate;               // activation.hpp; u (nu = nact + nstate): commands, then activations
  const int *act_state, *state_act, *state_kind, *state_early;
  const double* state_range;
  const int* frc_dof;       // joints that clamp the sum of their actuators
  const double* frc_range;
  const int* dof_lift;      // gravcomp.hpp; nothing unless nlift > 0
  const double *body_lift, *body_lift_pos;
  const int *wide_act, *wide_body, *wide_ptr, *wide_dof;  // wide.hpp
  const double *wide_local, *wide_coef;
  const int *grip_ptr, *grip_cluster;  // adhesion.hpp: clusters of candidates at which each of these actuators pulls
  const int* box_body;                                    // fluid.hpp
  const double *box_pos, *box_rot, *box_linear, *box_quadratic, *wind;
  const int* ellipsoid_body;
  const double *ellipsoid_pos, *ellipsoid_rot, *ellipsoid_coef;
  bool in_fluid() const { return nbox > 0 || nellipsoid > 0; }
  const int *spring_dof, *spring_qadr, *power_dof;        // springs.hpp
  const double *spring_ref, *power_coef;

  const int *tie_type, *tie_A, *tie_B;  // bodies, or lines; -1: the world, or none
  const double *tie_posA, *tie_posB, *tie_rotA, *tie_rotB, *tie_scale, *tie_poly, *tie_ref, *tie_soft, *tie_invweight;

  const double *P;
  const int *par_ptr, *par_idx;  // parameters that move the rest of P, by parameter
  const double *par_coef, *par_nominal;
  int nshape, ninertial, nweight;
  const int *shape_body, *shape_mass, *shape_par;  // inertia_shape.hpp: bodies, the parameters of their mass and of their shape
  const double* shape_root;
  const int *inertial_par;                                    // load_weights.hpp: parameters that inverse weights depend on;
  const int *weight_span, *weight_slopes;                     // each on some of these, and where its slopes begin;
  const int *weight_body, *weight_carried;                    // a body, and whether its point goes with the centre of mass;
  const int *weight_ptr, *weight_row_ptr, *weight_dof;        // or rows J
  const double *weight_point, *weight_coef, *weight_nominal;
  const int *con_weight, *lim_weight, *line_weight;           // inverse_weight.hpp
  const double *con_share, *q0;                               // con_weight, con_share: of both bodies of a contact; qpos0

  // derived
  const int *anc_ptr, *anc_idx;  // ancestors of a dof on its own chain
  Pattern tree() const { return {anc_ptr, anc_idx}; }
  int above(int dof) const { return anc_ptr[dof] < anc_ptr[dof + 1] ? anc_idx[anc_ptr[dof + 1] - 1] : -1; }  // next towards the root
  const int *seg_sides, *seg_side;          // of each segment: which ends the dofs of its tendon carry, without those that carry both
  const int *tie_ptr, *tie_dof, *tie_side;  // dofs that a tie couples; which of its bodies each carries: kCarriesA, kCarriesB
  const int *tie_entryA, *tie_entryB;       // its places in the covectors of the tie's lines; -1: none
  const int *dof_body, *dof_jnt, *dof_qadr, *body_lastdof;
  const int *grp_A, *grp_B, *grp_cptr, *grp_con;  // contacts by body pair
  const int *con_group;
  int max_group_dofs;
  int most_rows;             // of a contact; as many as sliding needs, at least
  const uint64_t* grp_world;                        // bits of the groups whose second body is the world
  const int *pair_ptr, *pair_other, *pair_group;    // the other groups by the lower of their bodies, then by the other one
  const double *sphere_pos, *sphere_radius;         // of each body, around what may touch anything; radius < 0: nothing
  const int *grp_clusters, *cluster_begin;          // candidates of one pair of geoms, by group; where they begin in grp_con
  const double *cluster_boxA, *cluster_boxB;        // boxes around them: centre, axes, half sizes
  const int* con_touches;        // of each candidate, how many its pair of geoms has
  int most_touches;              // of hulls with each other
  const int* cluster_frame;      // the first of those with that box on B; < 0: of few candidates, which share it with none
  const double* con_extentB;     // of each candidate, the box around its shape on B along those axes: from their centre on, and half sizes
  const double* cluster_round;                      // their largest sum of radii and margin; < 0: so few that a test would not pay
  const double* cluster_invweight;                  // the largest
  int sifted;                                       // some clusters have spheres
  const int *grp_bundles, *bundle_begin, *bundle_end, *bundle_next;  // bundles.hpp: by group; clusters of each; what follows its parts
  const double *bundle_box, *bundle_round, *bundle_invweight;  // around them in the world: centre, half sizes; as of clusters
  const int *con_par_ptr, *con_par, *con_par_field; // parameters that move a contact's block of P, by contact
  const double* con_par_coef;
  const double* par_radius;                         // most that one unit of each parameter adds to a radius
  int radius_moves;                                 // most parameters that move one radius
  const int* par_of_contacts;                       // 1: the parameter acts through contacts alone
  const int* par_shape;                             // the shape that each parameter, or mass, belongs to; -1: none
};

}  // namespace cmbrl
