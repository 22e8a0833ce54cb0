"""Input of the C++ core: sizes, tree, tendons, contact candidates, limits, actuators, equality constraints, parameters.

Shapes: nb moving bodies, nj joints, nc contacts, np planes, nl limits, na actuators, nt tendons, nm linkages,
ns segments of tendons, ne ties (equality constraints), nf joints that clamp their actuators, nw actuators on several
dofs, nx boxes and ny ellipsoids in a fluid, nk springs of ball joints, nh springs and dampers of higher powers,
D = 2 (planar) or 3. Arrays are C-contiguous, int32 or float64. Index -1 is the world.

A line is what limits, springs, dry friction and actuators act along: number k < nv is a degree of freedom, number
nv + k a tendon or, after them, a linkage.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmbrl.scene.layout import Layout
from cmbrl.scene.records import Array

Integers = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class CoreArrays:
    """The arrays of one scene; :mod:`cmbrl.scene.layout` gives the order of the physical vector ``P``."""

    planar: bool
    implicit_damping: bool  # damping of joints acts at the next velocity
    implicit_gains: bool  # velocity gains act at the next velocity; False: at the last one, as in MuJoCo's Euler
    refsafe: bool  # time constants of rows stay above two steps
    nq: int
    nv: int
    nu: int
    nbody: int
    njoint: int
    ncontact: int
    nplane: int
    nlimit: int
    nact: int
    nforcerange: int
    ngyro: int  # dofs whose Coriolis and gyroscopic forces are implicit
    nlift: int  # bodies with gravity compensation
    nstate: int
    nwide: int
    nlink: int
    nbox: int
    nellipsoid: int
    nballspring: int
    npower: int
    ntendon: int  # with the linkages, which come last
    nseg: int
    nwrap: int
    ntie: int
    nglide: int  # pairs of geoms with moving surfaces
    nhull: int  # meshes that may touch a plane
    nface: int  # sides of their hulls
    nfield: int  # height fields
    prism: int  # the hull that tells the sides of a field's prisms, or -1
    nshape: int  # bodies whose inertia can change its shape
    ninertial: int  # parameters of inertia and armatures, which inverse weights depend on
    nweight: int  # inverse weights that they change
    plane_basis: Array  # (2, 3) directions of the plane of motion; zeros for spatial scenes

    body_parent: Integers  # (nb,)
    body_pos: Array  # (nb, D) frame in the parent's frame, with the joints at qpos0
    body_rot: Array  # (nb, 2) cosine and sine, or (nb, 9) by rows
    body_jadr: Integers  # (nb,) first joint
    body_jnum: Integers  # (nb,)
    jnt_type: Integers  # (nj,) a JointKind
    jnt_body: Integers  # (nj,)
    jnt_qadr: Integers  # (nj,)
    jnt_vadr: Integers  # (nj,)
    jnt_axis: Array  # (nj, D)
    jnt_pos: Array  # (nj, D) anchor in the body frame
    jnt_q0: Array  # (nj,)
    tendon_ptr: Integers  # (nt + 1,) where the entries of each tendon begin
    tendon_dof: Integers  # the dofs that change its length, rising
    tendon_coef: Array  # of their coordinates; zeros in a tendon of segments
    seg_ptr: Integers  # (nt + 1,) where the segments of each tendon begin
    seg_A: Integers  # (ns,) a body
    seg_B: Integers  # (ns,)
    seg_posA: Array  # (ns, D)
    seg_posB: Array  # (ns, D)
    seg_scale: Array  # (ns,) what its length counts
    seg_wrap: Integers  # (ns,) what it goes around; -1: it is straight
    wrap_body: Integers  # (nw,)
    wrap_kind: Integers  # (nw * 2,) whether it is a cylinder, not a sphere; whether it has a site
    wrap_pos: Array  # (nw, 3)
    wrap_rot: Array  # (nw, 9)
    wrap_radius: Array  # (nw,)
    wrap_site_body: Integers  # (nw,)
    wrap_site: Array  # (nw, 3) the side to go on, or a place inside to go through
    link_line: Integers  # (nm,) its line
    link_kind: Integers  # (nm,) a LinkageKind
    link_A: Integers  # (nm,) a body; of a ball joint, where its quaternion stands in q
    link_B: Integers  # (nm,) a body, or -1: the world
    link_turns: Integers  # (nm,) whether its wrench has a torque; of a ball joint, whether its axis is the parent's
    link_posA: Array  # (nm, 3)
    link_posB: Array  # (nm, 3)
    link_rotA: Array  # (nm, 9)
    link_rotB: Array  # (nm, 9)
    link_force: Array  # (nm, 3) of a slider-crank: its axis
    link_torque: Array  # (nm, 3)
    link_rod: Array  # (nm,)
    line_soft: Array  # (nv + nt, 7) solref, solimp of dry friction
    line_invweight: Array  # (nv + nt,)
    line_slack: Array  # (nv + nt,) lengths over which the spring does not pull, from its reference on

    lim_line: Integers  # (nl,)
    lim_ball: (
        Integers  # (nl,) -1; or a limit on the angle of a ball joint: its place in q, and its last dof is the line
    )
    lim_lo: Array  # (nl,)
    lim_hi: Array  # (nl,)
    lim_margin: Array  # (nl,)
    lim_soft: Array  # (nl, 7)
    lim_invweight: Array  # (nl,)

    con_type: Integers  # (nc,) a ContactKind
    con_bodyA: Integers  # (nc,)
    con_bodyB: Integers  # (nc,)
    con_plane: Integers  # (nc,) -1 if not against a plane
    con_pair: Integers  # (nc,) number of the pair of geoms
    con_posA: Array  # (nc, D)
    con_axisA: Array  # (nc, D)
    con_posB: Array  # (nc, D)
    con_axisB: Array  # (nc, D)
    con_rotB: Array  # (nc, D * D)
    con_halfB: Array  # (nc, D)
    con_rotA: Array  # (nc, D * D)
    con_radiusB: Array  # (nc,)
    con_glide: Integers  # (nc,) number of the pair of moving surfaces, or -1
    glide_twist: Array  # (nglide, 12) of each, (angular, linear) of A's and B's about its body's origin, in its frame
    con_along: Array  # (nc, 3) in A's frame: direction of a capsule over a plane, otherwise 0
    con_hull: Integers  # (nc,) of a mesh over a plane, or of two hulls: that of A; otherwise -1
    con_when: Integers  # (nc,) a When
    con_hullB: Integers  # (nc,) of two hulls: that of B; otherwise -1
    con_first: Integers  # (nc,) of two hulls: whether A is the first of both geoms to MuJoCo
    con_many: Integers  # (nc,) of two hulls: whether sides that lie flat on each other touch in several points
    # (nhull,) 0: of a mesh; 1: a box; 2 to 6: a sphere, capsule, ellipsoid, cylinder or height field, whose vertices
    # are its box's
    hull_kind: Integers
    hull_field: Integers  # (nhull,) the field, or -1
    field_size: Integers  # (nfield * 2,) rows and columns
    field_ptr: Integers  # (nfield + 1,) where the heights of each field begin
    field_height: Array  # [m] above its base
    hull_ptr: Integers  # (nhull + 1,) where the vertices of each hull begin
    hull_point: Array  # (vertices, 3) in the body frame
    vertex_ptr: Integers  # (vertices + 1,) where the sides around each vertex begin
    vertex_face: Integers
    next_ptr: Integers  # (vertices + 1,) where the neighbours of each vertex begin, of hulls of many
    vertex_next: Integers  # along edges
    hull_graph: Integers  # (nhull,) number among those, or -1
    climb_start: Integers  # (graphs * 384,) the farthest vertex in the middle of each cell of directions
    face_ptr: Integers  # (nface + 1,) where the vertices of each side begin
    face_vertex: Integers  # in order around it
    face_normal: Array  # (nface, 3) outwards, in the body frame
    con_dim: Integers  # (nc,) 1, 3, 4 or 6
    con_law: Integers  # (nc,) a value of CONTACT_LAWS
    con_pyramid: Integers  # (nc,) number of edges; 0: a round cone
    con_ratio: Array  # (nc, 2) of sliding and of rolling friction: the second tangent's by the first's
    con_impratio: Array  # (nc,)
    con_invweight: Array  # (nc,)
    con_margin: Array  # (nc,)
    con_reach: Array  # (nc,) the gap below which actuators pull at it
    con_points: Array  # (nc,) how many of MuJoCo's points it stands for
    con_mid: Array  # (nc,)
    con_power: Array  # (nc,)
    plane_normal: Array  # (np, D)

    act_line: Integers  # (na,) -1: on several dofs, as told by wide_, or a further control
    act_ctrl: Array  # (na, 2)
    act_force: Array  # (na, 2)
    act_gain: Array  # (na, 2) how the gain on the control changes with length and with velocity
    act_period: Array  # (na,) by which a target wraps to what is nearest to the length; 0: it does not
    act_ripple: Array  # (na, 3) amplitude, count and phase of a force by length
    feed_ptr: Integers  # (na + 1,) where the further controls of each actuator begin
    feed_act: Integers  # they add to its force, and have no line

    act_state: Integers  # (na,) number of its activation, or -1
    state_act: Integers  # (nx,) actuators with an activation
    state_kind: Integers  # (nx,) a value of Dynamics
    state_range: Array  # (nx, 2)
    state_early: Integers  # (nx,) 1: the force follows the activation at the end of the step

    gyro_dof: Integers  # (nv,) 1: its Coriolis and gyroscopic forces are implicit
    frc_dof: Integers  # (nf,) dofs that clamp the sum of their actuators
    frc_range: Array  # (nf, 2)
    dof_lift: Integers  # (nv,) how gravity compensation acts: 0 passive, 1 as an actuator of the joint, 2 not
    body_lift: Array  # (nb,) share of its weight that a body carries itself
    body_lift_pos: Array  # (nb, D) where, from the centre of mass

    wide_act: Integers  # (nw,) actuators on several dofs
    wide_body: Integers  # (nw,) the body that one pushes, or -1
    wide_local: Array  # (nw, N) its moment about the body's origin and force, in body axes; N = 3 (planar) or 6
    wide_ptr: Integers  # (nw + 1,) where its dofs begin, if it drives those of one joint
    wide_dof: Integers
    wide_coef: Array  # its moment arms there
    grip_ptr: Integers  # (nw + 1,) where the candidates begin at which it pulls, if it pulls at contacts
    grip_con: Integers

    wind: Array  # (D,) [m/s] velocity of the fluid
    box_body: Integers  # (nx,) boxes that feel its drag
    box_pos: Array  # (nx, D) in the body frame
    box_rot: Array  # (nx, 2) or (nx, 9)
    box_linear: Array  # (nx, N) drag about and along its axes, by velocity and viscosity
    box_quadratic: Array  # (nx, N) by velocity, speed and density
    ellipsoid_body: Integers  # (ny,) ellipsoids that it drags and lifts; none in the plane
    ellipsoid_pos: Array  # (ny, 3) in the body frame
    ellipsoid_rot: Array  # (ny, 9)
    ellipsoid_coef: Array  # (ny, 19) as in the core's EllipsoidInFluid

    spring_dof: Integers  # (nk,) first dof of each ball joint with a spring
    spring_qadr: Integers  # (nk,)
    spring_ref: Array  # (nk, 4) quaternion at which it is at rest
    power_dof: Integers  # (nh,) dofs with a spring or a damper of higher powers
    power_coef: Array  # (nh, 4) k1, k2, b1, b2 of the force -(k1 x + k2 x^2) x - (b1 |v| + b2 v^2) v

    tie_type: Integers  # (ne,) a TieKind
    tie_A: Integers  # (ne,) a body, or a line
    tie_B: Integers  # (ne,) -1: the world, or no line
    tie_posA: Array  # (ne, D) the point that A holds
    tie_posB: Array  # (ne, D)
    tie_rotA: Array  # (ne, 2 or 9) the frame that A holds
    tie_rotB: Array  # (ne, 2 or 9)
    tie_scale: Array  # (ne,) weight of the rotation [m]
    tie_poly: Array  # (ne, 5) A's length as a polynomial of B's
    tie_ref: Array  # (ne, 2) lengths of A and B that count as 0
    tie_soft: Array  # (ne, 7)
    tie_invweight: Array  # (ne, 2) of the first D rows (or the only one), and of those of the rotation

    P: Array  # (nP,) nominal physical vector
    par_ptr: Integers  # (n + 1,) for n parameters: where the offsets of each begin in par_idx
    par_idx: Integers  # offsets into P
    par_coef: Array
    par_nominal: Array  # (n,)

    shape_body: Integers  # (nshape,)
    shape_mass: Integers  # (nshape,) the parameter of its mass
    shape_par: Integers  # (nshape * (1 or 6),) the parameters of its shape; -1: none
    shape_root: Array  # (nshape, D * D) B: see inertia_shapes.py
    inertial_par: Integers  # (ninertial,) by tree
    weight_body: Integers  # (nweight,) whose point it is of; -1: of rows
    weight_point: Array  # (nweight, D) in the frame of the body,
    weight_carried: Integers  # (nweight,) or, where this is 1, from its centre of mass
    weight_span: Integers  # (nweight * 2,) the first of the ninertial that change it, and where they end
    weight_slopes: Integers  # (nweight + 1,) where its slopes with them begin
    weight_nominal: Array  # (nweight,) the file's, times the number of rows
    weight_ptr: Integers  # (nweight + 1,) where the rows J of each begin
    weight_row_ptr: Integers  # where the entries of each row begin
    weight_dof: Integers
    weight_coef: Array
    q0: Array  # (nq,) the configuration that weights are taken in
    con_weight: Integers  # (nc * 2,) inverse weights of both bodies; -1: one that no parameter changes
    con_share: Array  # (nc, 2) of their sum
    lim_weight: Integers  # (nl,)
    line_weight: Integers  # (nv + nt,)

    @property
    def layout(self) -> Layout:
        """Offsets into ``P``."""
        dimension = 2 if self.planar else 3
        return Layout(dimension, self.nbody, self.nv, self.ncontact, self.nplane, self.nact, self.ntendon)

    def to_native(self) -> dict[str, Any]:
        """The arrays by name, as the core takes them."""
        return dict(vars(self))
