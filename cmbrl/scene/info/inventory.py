"""What a scene has, as JSON types: the output of ``cmbrl info --json``."""

from __future__ import annotations

from typing import Any

import numpy as np

from cmbrl.scene.forces.activation import Dynamics
from cmbrl.scene.forces.linkages import LinkageKind
from cmbrl.scene.records import WORLD, TieKind
from cmbrl.scene.scene import Scene
from cmbrl.scene.source import angles

TIES = ("connect", "weld", "polynomial")
TYPES = (
    "point against plane",
    "point against shape",
    "segment against segment",
    "rim against plane",
    "corner against box",
    "hull against hull",
    "ellipsoid against plane",
    "point of a cylinder's end against plane",
)


def to_dict(scene: Scene) -> dict[str, Any]:
    """Sizes, coordinates, contacts, limits, actuators, parameters and left-out elements as JSON types."""
    core, segments = scene.core, np.diff(scene.core.seg_ptr)
    return {
        "name": scene.name,
        "path": scene.path,
        "ignore": list(scene.ignore),
        "algebra": "planar" if scene.planar else "spatial",
        "algebra_why": scene.planar_why,
        "plane_basis": core.plane_basis.tolist() if scene.planar else None,
        "nq": scene.nq,
        "nv": scene.nv,
        "nu": scene.nu,
        "timestep_s": scene.timestep,
        "integrator": scene.integrator,
        "total_mass_kg": scene.total_mass,
        "gravity_m_s2": scene.gravity.tolist(),
        "bodies": list(scene.body_names),
        "joints": list(scene.joint_names),
        "coordinates": [
            {"name": name, "kind": kind}
            for name, kind in zip(scene.coordinate_names, scene.coordinate_kinds, strict=True)
        ],
        "contact_law": scene.contact_law,
        "contacts": [
            {"pair": name, "type": TYPES[core.con_type[k]], "condim": int(core.con_dim[k])}
            for k, name in enumerate(scene.contact_names)
        ],
        "contacts_merged": scene.merged_points,
        "contacts_dropped": [{"pair": drop.name, "why": drop.why} for drop in scene.dropped_contacts],
        "limits": [
            {"coordinate": name, "low": float(low), "high": float(high)}
            for name, low, high in zip(limited(scene), core.lim_lo, core.lim_hi, strict=True)
        ],
        "tendons": [
            {"name": name, "coordinates": path(scene, k), "segments": int(segments[k])}
            for k, name in enumerate(scene.tendon_names)
        ],
        "equalities": [
            {"name": name, "type": TIES[core.tie_type[k]], "between": ends(scene, k)}
            for k, name in enumerate(scene.tie_names)
        ],
        "joint_force_ranges": [
            {"coordinate": scene.coordinate_names[dof], "low": float(low), "high": float(high)}
            for dof, (low, high) in zip(core.frc_dof, core.frc_range, strict=True)
        ],
        "gravity_compensation": [
            {"body": name, "share": float(share)}
            for name, share in zip(scene.body_names, core.body_lift, strict=True)
            if share
        ],
        "boxes_in_fluid": core.nbox,
        "ellipsoids_in_fluid": core.nellipsoid,
        "actuators": [
            {
                "name": name,
                "coordinate": driven(scene, k),
                "control": bounds(core.act_ctrl[k]),
                "force": bounds(core.act_force[k]),
                "activation": activation(scene, k),
            }
            for k, name in enumerate(scene.actuator_names)
        ],
        "parameters": [
            {key: getattr(p, key) for key in ("name", "nominal", "low", "high", "transform", "unit", "default")}
            for p in scene.parameters
        ],
        "compiler_warnings": list(scene.compiler_warnings),
        "urdf_changes": list(scene.urdf_changes),
        "doubts": doubts(scene),
        "differences": [{"kind": x.kind, "name": x.name, "why": x.why} for x in scene.differences],
        "left_out": [{"kind": x.kind, "name": x.name, "why": x.why} for x in scene.left_out],
    }


def moving_pairs(scene: Scene) -> list[str]:
    """The pairs of geoms on two moving bodies, ``ball-box``: their contacts share parameters called ``pairs``."""
    core = scene.core
    names = zip(scene.contact_names, core.con_bodyA, core.con_bodyB, strict=True)
    return sorted({"-".join(sorted(name.split(" - "))) for name, a, b in names if WORLD not in (a, b)})


def doubts(scene: Scene) -> list[str]:
    """What the file probably does not mean: ranges of hinges in the wrong unit (``angles``)."""
    core, kinds = scene.core, scene.coordinate_kinds
    hinges = [k for k, line in enumerate(core.lim_line) if line < scene.nv and core.lim_ball[k] < 0]
    hinges = [k for k in hinges if kinds[core.lim_line[k]] == "angle"]
    names = limited(scene)
    return angles.doubts([names[k] for k in hinges], core.lim_lo[hinges], core.lim_hi[hinges])


def bounds(pair: np.ndarray) -> list[float] | None:
    """None if unlimited: JSON has no infinity."""
    return pair.tolist() if np.all(np.isfinite(pair)) else None


def limited(scene: Scene) -> list[str]:
    """What each limit is on: a coordinate, a tendon, or the angle of a ball joint."""
    names = [scene.line_names[line] for line in scene.core.lim_line]
    balls = scene.core.lim_ball
    return [name.removesuffix(".rz") if ball >= 0 else name for name, ball in zip(names, balls, strict=True)]


def driven(scene: Scene, k: int) -> str:
    """What an actuator drives: a coordinate, a tendon, a body at a site or its contacts, or a joint's coordinates."""
    core, line = scene.core, int(scene.core.act_line[k])
    if line >= len(scene.line_names):
        return _linkage(scene, core.link_line.tolist().index(line))
    if line >= 0:
        return scene.line_names[core.act_line[k]]
    if k in core.feed_act:
        main = int(np.searchsorted(core.feed_ptr, core.feed_act.tolist().index(k), side="right")) - 1
        return driven(scene, main)
    wide = core.wide_act.tolist().index(k)
    if core.grip_ptr[wide] < core.grip_ptr[wide + 1]:
        return f"contacts of {scene.body_names[core.wide_body[wide]] if core.wide_body[wide] >= 0 else 'the world'}"
    if core.wide_body[wide] >= 0:
        return f"body {scene.body_names[core.wide_body[wide]]}"
    dofs = core.wide_dof[core.wide_ptr[wide] : core.wide_ptr[wide + 1]]
    return f"{scene.coordinate_names[dofs[0]]} to {scene.coordinate_names[dofs[-1]]}" if len(dofs) else "the world"


def _linkage(scene: Scene, k: int) -> str:
    """What moves along a line that is neither a coordinate nor a tendon."""
    core, kind = scene.core, LinkageKind(int(scene.core.link_kind[k]))
    if kind in (LinkageKind.BALL, LinkageKind.CONSTANT):
        tendon = int(core.link_line[k]) - scene.nv
        dofs = core.tendon_dof[core.tendon_ptr[tendon] : core.tendon_ptr[tendon + 1]]
        return f"{scene.coordinate_names[dofs[0]]} to {scene.coordinate_names[dofs[-1]]}"
    a, b = (scene.body_names[x] if x >= 0 else "the world" for x in (core.link_A[k], core.link_B[k]))
    word = "a slider-crank of" if kind == LinkageKind.SLIDER_CRANK else "sites of"
    return f"{word} {a} and {b}" if kind != LinkageKind.ON_SITE else f"body {a}"


def activation(scene: Scene, k: int) -> dict[str, Any] | None:
    """The state of an actuator, if it has one."""
    core, number = scene.core, int(scene.core.act_state[k])
    if number < 0:
        return None
    return {
        "dynamics": Dynamics(int(core.state_kind[number])).name.lower().removesuffix("_rk4"),
        "time_constant": float(core.P[scene.layout.actuator(k, "time")]),
        "limits": bounds(core.state_range.reshape(-1, 2)[number]),
        "early": bool(core.state_early[number]),
    }


def path(scene: Scene, tendon: int) -> dict[str, float]:
    """Coefficients of a tendon by coordinate; zeros if it goes through sites."""
    core = scene.core
    entries = range(core.tendon_ptr[tendon], core.tendon_ptr[tendon + 1])
    return {scene.coordinate_names[core.tendon_dof[e]]: float(core.tendon_coef[e]) for e in entries}


def ends(scene: Scene, tie: int) -> list[str]:
    """What an equality constraint ties: bodies, or coordinates and tendons."""
    core = scene.core
    lines = core.tie_type[tie] == TieKind.POLYNOMIAL
    names, nothing = (scene.line_names, []) if lines else (scene.body_names, ["world"])
    return [end for k in (core.tie_A[tie], core.tie_B[tie]) for end in ([names[k]] if k != WORLD else nothing)]
