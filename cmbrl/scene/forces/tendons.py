"""Tendons: sums of joint positions, or of distances of sites, along which springs, limits and actuators act."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.records import WORLD, Array, Obstacle, Segment, Tendon, Tree
from cmbrl.scene.reduction import PlaneOfMotion
from cmbrl.scene.source.mjcf import ignores, name_of
from cmbrl.scene.source.support import Gate

FLAT = 1e-9  #: [m] across the plane of motion that does not count
_TENDON = mujoco.mjtTrn.mjTRN_TENDON


def read_tendons(model: mujoco.MjModel, tree: Tree, gate: Gate) -> list[Tendon]:
    """The tendons that do something; the gate is told of the others and of what is not modelled."""
    found: list[Tendon] = []
    for k in range(model.ntendon):
        name, forces, used = name_of(model, "tendon", k), _forces(model, k), _is_used(model, k)
        if not (forces or used):
            gate.note("tendon", name, "it exerts no force: no stiffness, damping, friction loss, limit or actuator")
        else:
            segments = [] if is_fixed(model, k) else _segments(model, tree, k)
            path = _path(model, k) if is_fixed(model, k) else dict.fromkeys(_carriers(tree, segments), 0.0)
            if not path:
                gate.note("tendon", name, "no joint changes its length")
                continue
            _check(model, k, name, gate)
            found.append(Tendon(name, k, tuple(path), tuple(path.values()), tuple(segments)))
    return found


def lines_of(model: mujoco.MjModel, tendons: list[Tendon]) -> Mapping[int, int]:
    """Line of the core by number of the tendon in the file."""
    return {tendon.source: int(model.nv) + k for k, tendon in enumerate(tendons)}


def segment_arrays(tree: Tree, tendons: list[Tendon], more: int, plane: PlaneOfMotion | None) -> dict[str, Any]:
    """The segments of tendons, in the plane of motion if there is one, and what they go around.

    After the tendons come ``more`` lines without any.
    """
    segments = [segment for tendon in tendons for segment in tendon.segments]
    dimension = 2 if plane else 3

    def points(ends: list[tuple[int, Array]]) -> Array:
        return doubles([plane.local(tree, *end) if plane else end[1] for end in ends], (-1, dimension))

    return {
        "seg_ptr": integers(np.cumsum([0, *(len(tendon.segments) for tendon in tendons), *[0] * more])),
        "seg_A": integers([s.body_a for s in segments]),
        "seg_B": integers([s.body_b for s in segments]),
        "seg_posA": points([(s.body_a, s.pos_a) for s in segments]),
        "seg_posB": points([(s.body_b, s.pos_b) for s in segments]),
        "seg_scale": doubles([s.scale for s in segments], (-1,)),
        **_obstacle_arrays(segments),
    }


def _obstacle_arrays(segments: list[Segment]) -> dict[str, Any]:
    """What segments go around, one for each that goes around something."""
    found, which = [s.around for s in segments if s.around], -np.ones(len(segments), dtype=int)
    which[[s.around is not None for s in segments]] = np.arange(len(found))
    sites = [o.site or (WORLD, np.zeros(3)) for o in found]
    return {
        "seg_wrap": integers(which),
        "wrap_body": integers([o.body for o in found]),
        "wrap_kind": integers([(o.cylinder, o.site is not None) for o in found]),
        "wrap_pos": doubles([o.pos for o in found], (-1, 3)),
        "wrap_rot": doubles([o.rot for o in found], (-1, 9)),
        "wrap_radius": doubles([o.radius for o in found], (-1,)),
        "wrap_site_body": integers([body for body, _ in sites]),
        "wrap_site": doubles([pos for _, pos in sites], (-1, 3)),
    }


def is_fixed(model: mujoco.MjModel, k: int) -> bool:
    """Whether a tendon's length is a sum of joint positions."""
    return bool(model.wrap_type[model.tendon_adr[k]] == mujoco.mjtWrap.mjWRAP_JOINT)


def obstacle_of_tendons(tree: Tree, plane: PlaneOfMotion, tendons: list[Tendon]) -> str | None:
    """Why a tendon has no planar image, naming it; None if all have one."""
    for tendon in tendons:
        for segment in tendon.segments:
            if segment.around:
                return f"{tendon.name} goes around something"
            apart = tree.place(segment.body_a, segment.pos_a) - tree.place(segment.body_b, segment.pos_b)
            if abs(apart @ plane.axis) > FLAT:
                return f"{tendon.name} leaves the plane of motion"
    return None


def _segments(model: mujoco.MjModel, tree: Tree, k: int) -> list[Segment]:
    """The pieces of a tendon between its sites whose ends, or what they go around, move against each other."""
    first, scale, found = int(model.tendon_adr[k]), 1.0, []
    last: tuple[int, Array] | None = None
    around: Obstacle | None = None
    for at in range(first, first + int(model.tendon_num[k])):
        if model.wrap_type[at] == mujoco.mjtWrap.mjWRAP_PULLEY:
            scale, last = 1.0 / float(model.wrap_prm[at]), None
        elif model.wrap_type[at] == mujoco.mjtWrap.mjWRAP_SITE:
            here = _place(model, tree, int(model.wrap_objid[at]))
            if last:
                found.append(Segment(*last, *here, scale, around))
            last, around = here, None
        else:
            around = _obstacle(model, tree, at)
    return found


def _place(model: mujoco.MjModel, tree: Tree, site: int) -> tuple[int, Array]:
    """The body of a site, and its place in that body's frame."""
    frame = tree.frames[model.site_bodyid[site]]
    return frame.body, frame.pos + frame.rot @ model.site_pos[site]


def _obstacle(model: mujoco.MjModel, tree: Tree, at: int) -> Obstacle:
    """What entry ``at`` of a tendon's path goes around."""
    geom, sidesite = int(model.wrap_objid[at]), round(float(model.wrap_prm[at]))
    frame = tree.frames[model.geom_bodyid[geom]]
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    return Obstacle(
        body=frame.body,
        pos=frame.pos + frame.rot @ model.geom_pos[geom],
        rot=frame.rot @ rotation.reshape(3, 3),
        radius=float(model.geom_size[geom, 0]),
        cylinder=bool(model.wrap_type[at] == mujoco.mjtWrap.mjWRAP_CYLINDER),
        site=_place(model, tree, sidesite) if sidesite >= 0 else None,
    )


def _carriers(tree: Tree, segments: list[Segment]) -> list[int]:
    """Degrees of freedom that move the bodies of a segment against each other, rising."""
    dofs: set[int] = set()
    for segment in segments:
        chains = [set(tree.chain(body)) for body in segment.bodies]
        moving = chains[0].union(*chains) - chains[0].intersection(*chains)
        dofs.update(dof for body in moving for joint in tree.bodies[body].joints for dof in joint.dofs)
    return sorted(dofs)


def _path(model: mujoco.MjModel, k: int) -> dict[int, float]:
    """Coefficients by degree of freedom, rising."""
    first = int(model.tendon_adr[k])
    coefs: dict[int, float] = {}
    for at in range(first, first + int(model.tendon_num[k])):
        dof = int(model.jnt_dofadr[model.wrap_objid[at]])
        coefs[dof] = coefs.get(dof, 0.0) + float(model.wrap_prm[at])
    return {dof: coefs[dof] for dof in sorted(coefs) if coefs[dof]}


def _forces(model: mujoco.MjModel, k: int) -> list[str]:
    """The forces that a tendon exerts by itself."""
    constrained = not ignores(model, "CONSTRAINT")
    there = {
        "stiffness": bool(model.tendon_stiffness[k]) or _any(model, "tendon_stiffnesspoly", k),
        "damping": bool(model.tendon_damping[k]) or _any(model, "tendon_dampingpoly", k),
        "friction loss": constrained and bool(model.tendon_frictionloss[k]),
        "limits": constrained and bool(model.tendon_limited[k]),
        "armature": bool(armature_of(model, k)),
    }
    return [word for word, true in there.items() if true]


def _is_used(model: mujoco.MjModel, k: int) -> bool:
    """Whether an actuator or an active equality constraint acts along a tendon."""
    return bool(np.any(_drivers(model, k))) or _is_tied(model, k)


def _is_tied(model: mujoco.MjModel, k: int) -> bool:
    ties = (model.eq_type == mujoco.mjtEq.mjEQ_TENDON) & (model.eq_active0 != 0)
    return bool(np.any(ties & ((model.eq_obj1id == k) | (model.eq_obj2id == k))))


def _is_constrained(model: mujoco.MjModel, k: int) -> bool:
    """Whether a tendon has limits, dry friction or an active equality constraint."""
    return _is_tied(model, k) or not {"limits", "friction loss"}.isdisjoint(_forces(model, k))


def _joint_that_repeats(model: mujoco.MjModel, k: int) -> str | None:
    """A joint that a sum of joint positions has more than once."""
    first = int(model.tendon_adr[k])
    joints = model.wrap_objid[first : first + int(model.tendon_num[k])].tolist()
    return next((name_of(model, "joint", joint) for joint in joints if joints.count(joint) > 1), None)


def _check(model: mujoco.MjModel, k: int, name: str, gate: Gate) -> None:
    if is_fixed(model, k) and _is_constrained(model, k) and (joint := _joint_that_repeats(model, k)):
        # MuJoCo takes the inverse weight of such a tendon for 0, and makes no row for it.
        why = f"joint {joint} comes more than once in its sum, and MuJoCo drops its constraints: give the sum once"
        gate.refuse("tendon", name, why, "the sum acts, and is hard")
    if not is_fixed(model, k) and (armature := armature_of(model, k)):
        gate.refuse("tendon", name, f"armature {armature:g} of a tendon through sites", "left out")
    for field in ("stiffness", "damping"):
        if _any(model, f"tendon_{field}poly", k):
            gate.refuse("tendon", name, f"nonzero {field} polynomial", "reduced to the linear term")
    if _any(model, "tendon_actfrclimited", k) and np.count_nonzero(_drivers(model, k)) > 1:
        low, high = model.tendon_actfrcrange[k]
        why = f"actuatorfrcrange {low:g} {high:g} of several actuators together"
        gate.refuse("tendon", name, why, "forces are not clamped")


def _drivers(model: mujoco.MjModel, k: int) -> NDArray[np.bool_]:
    return np.asarray((model.actuator_trntype == _TENDON) & (model.actuator_trnid[:, 0] == k))


def force_range(model: mujoco.MjModel, k: int) -> tuple[float, float]:
    """Of the actuator that drives a tendon alone; infinite where the tendon has none."""
    if not _any(model, "tendon_actfrclimited", k) or np.count_nonzero(_drivers(model, k)) > 1:
        return -np.inf, np.inf
    low, high = model.tendon_actfrcrange[k].tolist()
    return low, high


def armature_of(model: mujoco.MjModel, k: int) -> float:
    """That of a tendon and of its actuators; in recent versions of MuJoCo."""
    of_actuators = getattr(model, "actuator_armature", np.zeros(len(model.actuator_trntype)))
    driven = _drivers(model, k)
    gear = model.actuator_gear[driven, 0]
    own = getattr(model, "tendon_armature", np.zeros(model.ntendon))[k]
    return float(own + np.sum(of_actuators[driven] * gear**2))


def _any(model: mujoco.MjModel, field: str, k: int) -> bool:
    values = getattr(model, field, None)
    return values is not None and bool(np.any(values[k]))
