"""From the parts of a robot to the fields of a scene: what it is called, what the core gets, what a fit may change."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.collision.candidate_table import CandidateTable
from cmbrl.scene.collision.glide import glide_arrays
from cmbrl.scene.collision.hulls import hull_arrays
from cmbrl.scene.core.assemble import contact_arrays, line_arrays, tree_arrays
from cmbrl.scene.core.core_arrays import CoreArrays
from cmbrl.scene.core.inverse_weights import weight_arrays
from cmbrl.scene.core.physical_vector import physical_vector
from cmbrl.scene.differences import differences
from cmbrl.scene.fittable.parameters import offer_parameters
from cmbrl.scene.forces.activation import activation_arrays
from cmbrl.scene.forces.actuators import feed_arrays
from cmbrl.scene.forces.fluid import box_arrays
from cmbrl.scene.forces.fluid_ellipsoids import ellipsoid_arrays
from cmbrl.scene.forces.gyro import gyro_arrays
from cmbrl.scene.forces.springs import spring_arrays
from cmbrl.scene.forces.ties import tie_arrays
from cmbrl.scene.forces.wide import reach_arrays
from cmbrl.scene.laws import LawChoice
from cmbrl.scene.layout import Layout
from cmbrl.scene.parts import Parts
from cmbrl.scene.records import JointKind, Parameter, Tree
from cmbrl.scene.source.mjcf import ignores, name_of, read_places
from cmbrl.scene.source.robot_source import Compiled
from cmbrl.scene.source.support import Gate

_INTEGRATORS = {
    "mjINT_EULER": "euler",
    "mjINT_RK4": "rk4",
    "mjINT_IMPLICIT": "implicit",
    "mjINT_IMPLICITFAST": "implicit",
}


def scene_fields(compiled: Compiled, gate: Gate, parts: Parts, law: LawChoice) -> dict[str, Any]:
    """The fields of a :class:`~cmbrl.scene.scene.Scene` that follow from the file and the contact law."""
    model, tree, plane, candidates = compiled.model, parts.tree, parts.plane, parts.candidates
    integrator = _INTEGRATORS.get(mujoco.mjtIntegrator(model.opt.integrator).name, "euler")
    core, parameters = _core(model, parts, law, integrator)
    coordinates, kinds = _coordinates(tree)
    geoms = [name_of(model, "geom", k) for k in range(model.ngeom)]
    stand_ins, boxes = parts.contacts.stand_ins, len(parts.boxes)
    return {
        "name": compiled.name,
        "path": str(compiled.file or ""),
        "ignore": gate.ignore,
        "nq": int(model.nq),
        "nv": int(model.nv),
        "nu": len(parts.actuators),
        "planar": plane is not None,
        "planar_why": parts.why,
        "timestep": float(model.opt.timestep),
        "integrator": integrator,
        "q0": np.array(model.qpos0),
        "total_mass": float(sum(body.mass for body in tree.bodies)),
        "body_names": tuple(body.name for body in tree.bodies),
        "places": read_places(model, tree),
        "joint_names": tuple(name_of(model, "joint", k) for k in range(model.njnt)),
        "coordinate_names": coordinates,
        "coordinate_kinds": kinds,
        "actuator_names": tuple(actuator.name for actuator in parts.actuators),
        "tendon_names": tuple(tendon.name for tendon in parts.tendons),
        "tie_names": tuple(tie.name for tie in parts.ties),
        "contact_names": _pair_names(candidates, geoms),
        "parameters": parameters,
        "left_out": tuple(gate.left_out),
        "dropped_contacts": tuple(parts.contacts.dropped),
        "differences": differences(model, candidates, stand_ins, parts.tendons, law.name, integrator, boxes),
        "merged_points": parts.merged,
        "compiler_warnings": compiled.warnings,
        "urdf_changes": compiled.notes,
        "joints": tuple(tree.joints),
        "core": core,
    }


def _core(
    model: mujoco.MjModel, parts: Parts, law: LawChoice, integrator: str
) -> tuple[CoreArrays, tuple[Parameter, ...]]:
    """The input of the native core, and the parameters that a fit may change."""
    tree, plane, candidates, grounds = parts.tree, parts.plane, parts.candidates, parts.grounds
    tendons, linkages, actuators, nv = parts.tendons, parts.linkages, parts.actuators, int(model.nv)
    ntendon = len(tendons) + len(linkages)
    dimension, letters = (2, plane.letters) if plane else (3, ("x", "y", "z"))
    layout = Layout(dimension, len(tree.bodies), nv, len(candidates), len(grounds), len(actuators), ntendon)
    P = physical_vector(model, parts, layout, law)
    moves, shapes = offer_parameters(model, parts, layout, letters, P, law.name)
    lines = line_arrays(model, tree, tendons, linkages, plane)
    core = CoreArrays(
        planar=plane is not None,
        implicit_damping=integrator != "euler" or not ignores(model, "EULERDAMP"),
        implicit_gains=integrator != "euler",
        refsafe=not ignores(model, "REFSAFE"),
        nq=int(model.nq),
        nv=nv,
        nu=len(actuators) + sum(a.activation is not None for a in actuators),
        nbody=len(tree.bodies),
        njoint=len(tree.joints),
        ncontact=len(candidates),
        nplane=len(grounds),
        nlimit=len(lines["lim_line"]),
        nact=len(actuators),
        ntendon=ntendon,
        nseg=len(lines["seg_A"]),
        nwrap=len(lines["wrap_body"]),
        ntie=len(parts.ties),
        plane_basis=plane.basis if plane else np.zeros((2, 3)),
        **tree_arrays(tree, plane),
        **lines,
        **tie_arrays(tree, parts.ties, plane),
        **contact_arrays(model, candidates, grounds, plane, law.name),
        **glide_arrays(model, tree, candidates, parts.still),
        **hull_arrays(model, tree, CandidateTable([]) if plane else candidates, len(candidates)),
        act_line=integers([a.line for a in actuators]),
        act_ctrl=doubles([a.control for a in actuators], (-1, 2)),
        act_force=doubles([a.force for a in actuators], (-1, 2)),
        act_gain=doubles([a.gain_slope for a in actuators], (-1, 2)),
        act_period=doubles([a.period for a in actuators], (-1,)),
        act_ripple=doubles([a.ripple for a in actuators], (-1, 3)),
        **feed_arrays(actuators),
        **gyro_arrays(model),
        **parts.ranges,
        **parts.compensation.arrays(tree, plane),
        **activation_arrays(actuators),
        **reach_arrays(model, tree, [a.reach for a in actuators], candidates, plane),
        **box_arrays(model, tree, parts.boxes, plane),
        **ellipsoid_arrays(parts.ellipsoids),
        **spring_arrays(model, tree),
        P=P,
        par_ptr=moves.ptr,
        par_idx=moves.idx,
        par_coef=moves.coef,
        par_nominal=np.array([p.nominal for p in moves.parameters], dtype=np.float64),
        **shapes,
        **weight_arrays(
            model,
            tree,
            plane,
            candidates,
            lines,
            P,
            moves.ptr,
            moves.idx,
            shapes,
            layout,
            law.name,
            [x.source for x in tendons],
        ),
    )
    return core, moves.parameters


def _pair_names(candidates: CandidateTable, geoms: list[str]) -> tuple[str, ...]:
    pairs, which = candidates.pairs
    names = [f"{geoms[a]} - {geoms[b]}" for a, b in pairs.tolist()]
    return tuple(np.array(names, dtype=object)[which].tolist())


def _coordinates(tree: Tree) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and kinds of the nv velocity coordinates, in order."""
    names, kinds = [], []
    for joint in tree.joints:
        parts = [other for other in tree.bodies[joint.body].joints if other.source == joint.source]
        prefix = f"{joint.name}." if len(parts) > 1 or joint.kind == JointKind.BALL else joint.name
        if joint.kind == JointKind.BALL:
            names += [f"{prefix}r{letter}" for letter in "xyz"]
            kinds += ["rotation"] * 3
        else:
            names.append(prefix + "xyz"[parts.index(joint)] if len(parts) > 1 else prefix)
            kinds.append("position" if joint.kind == JointKind.SLIDE else "angle")
    return tuple(names), tuple(kinds)
