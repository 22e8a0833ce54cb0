"""Ties: equality constraints between joints, tendons or bodies, with what each asks of two lines or two bodies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.arrays import doubles, integers
from cmbrl.scene.forces.tendons import FLAT
from cmbrl.scene.manifold import quaternion_matrix
from cmbrl.scene.records import WORLD, Array, Tie, TieKind, Tree
from cmbrl.scene.reduction import PlaneOfMotion
from cmbrl.scene.source.mjcf import ignores, name_of
from cmbrl.scene.source.solref import acting
from cmbrl.scene.source.support import Gate

_KINDS = mujoco.mjtEq


def read_ties(model: mujoco.MjModel, tree: Tree, lines: Mapping[int, int], gate: Gate) -> list[Tie]:
    """The active equality constraints. ``lines``: of the tendons, by their numbers in the file."""
    found: list[Tie] = []
    for k in range(model.neq):
        name, kind = name_of(model, "equality", k), int(model.eq_type[k])
        if not model.eq_active0[k] or ignores(model, "EQUALITY") or ignores(model, "CONSTRAINT"):
            gate.note("equality", name, "not active")
        elif kind in (_KINDS.mjEQ_CONNECT, _KINDS.mjEQ_WELD):
            tie = _of_bodies(model, tree, k, name)
            if tie.a == tie.b and (tie.a == WORLD or np.allclose(tie.pos_a, tie.pos_b, rtol=0, atol=1e-12)):
                gate.note("equality", name, "it ties two parts of one body")
            else:
                found.append(tie)
        elif kind == _KINDS.mjEQ_JOINT:
            found.append(_of_joints(model, k, name))
        elif kind == _KINDS.mjEQ_TENDON:
            _of_tendons(model, k, name, lines, found, gate)
        else:
            word = _KINDS(kind).name.removeprefix("mjEQ_").lower()
            gate.refuse("equality", name, f"a {word} constraint")
    return found


def obstacle_of_ties(tree: Tree, plane: PlaneOfMotion, ties: list[Tie]) -> str | None:
    """Why a tie has no planar image, naming it; None if all have one."""
    for tie in ties:
        if tie.kind == TieKind.POLYNOMIAL:
            continue
        apart = tree.place(tie.a, tie.pos_a) - tree.place(tie.b, tie.pos_b)
        if abs(apart @ plane.axis) > FLAT:
            return f"{tie.name} ties points that lie in different planes"
        if tie.kind == TieKind.WELD:
            turn = tree.turn(tie.b, tie.rot_b).T @ tree.turn(tie.a, tie.rot_a)
            normal = tree.turn(tie.b, tie.rot_b).T @ plane.axis
            if np.linalg.norm(turn @ normal - normal) > FLAT:
                return f"{tie.name} turns a body out of the plane of motion"
    return None


def tie_arrays(tree: Tree, ties: list[Tie], plane: PlaneOfMotion | None) -> dict[str, Any]:
    """Equality constraints, in the plane of motion if there is one."""
    dimension = 2 if plane else 3

    def point(body: int, pos: Array) -> Array:
        return plane.local(tree, body, pos) if plane else pos

    def frames(tie: Tie) -> tuple[Array, Array]:
        if not plane:
            return tie.rot_a.ravel(), tie.rot_b.ravel()
        apart = tree.turn(tie.a, tie.rot_a) @ tree.turn(tie.b, tie.rot_b).T  # a turn about the plane's normal
        rot_a, rot_b = (np.eye(2) if body == WORLD else plane.rot[body].T for body in (tie.a, tie.b))
        return (rot_a @ plane.basis @ apart @ plane.basis.T)[:, 0], rot_b[:, 0]  # cosine, sine

    bodies = [tie if tie.kind != TieKind.POLYNOMIAL else replace(tie, a=WORLD, b=WORLD) for tie in ties]
    rots = [frames(tie) for tie in bodies]
    return {
        "tie_type": integers([tie.kind for tie in ties]),
        "tie_A": integers([tie.a for tie in ties]),
        "tie_B": integers([tie.b for tie in ties]),
        "tie_posA": doubles([point(tie.a, tie.pos_a) for tie in bodies], (-1, dimension)),
        "tie_posB": doubles([point(tie.b, tie.pos_b) for tie in bodies], (-1, dimension)),
        "tie_rotA": doubles([rot for rot, _ in rots], (-1, 2 if plane else 9)),
        "tie_rotB": doubles([rot for _, rot in rots], (-1, 2 if plane else 9)),
        "tie_scale": doubles([tie.scale for tie in ties], (-1,)),
        "tie_poly": doubles([tie.poly for tie in ties], (-1, 5)),
        "tie_ref": doubles([tie.ref for tie in ties], (-1, 2)),
        "tie_soft": doubles([[*tie.solref, *tie.solimp] for tie in ties], (-1, 7)),
        "tie_invweight": doubles([tie.inverse_weight for tie in ties], (-1, 2)),
    }


def _softness(model: mujoco.MjModel, k: int) -> tuple[Array, Array]:
    return acting(model.eq_solref[k]), model.eq_solimp[k].copy()


def _of_bodies(model: mujoco.MjModel, tree: Tree, k: int, name: str) -> Tie:
    """A connect or weld between bodies, or between sites of them."""
    weld, data = int(model.eq_type[k]) == _KINDS.mjEQ_WELD, model.eq_data[k]
    ends = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
    bodies, rots = ends, [np.eye(3), np.eye(3)]
    kinds = getattr(model, "eq_objtype", None)  # of recent MuJoCo versions
    if kinds is not None and kinds[k] == mujoco.mjtObj.mjOBJ_SITE:
        bodies = int(model.site_bodyid[ends[0]]), int(model.site_bodyid[ends[1]])
        points = [model.site_pos[end] for end in ends]
        rots = [quaternion_matrix(model.site_quat[end]) for end in ends]
    elif weld:  # the pose of body 2 in the frame of body 1; a point of body 2
        points = [data[3:6], data[0:3]]
        rots[0] = quaternion_matrix(data[6:10])
    else:
        points = [data[0:3], data[3:6]]
    (pos_a, rot_a), (pos_b, rot_b) = (
        (frame.pos + frame.rot @ point, frame.rot @ rot)
        for frame, point, rot in zip((tree.frames[body] for body in bodies), points, rots, strict=True)
    )
    moving = [tree.frames[body].body for body in bodies]
    moved, turned = (float(model.body_invweight0[list(bodies), field].sum()) for field in range(2))
    return Tie(
        name,
        TieKind.WELD if weld else TieKind.CONNECT,
        moving[0],
        moving[1],
        *_softness(model, k),
        (moved, turned),
        pos_a,
        pos_b,
        rot_a,
        rot_b,
        scale=float(data[10]) if weld else 0.0,
    )


def _of_joints(model: mujoco.MjModel, k: int, name: str) -> Tie:
    joints = [joint for joint in (int(model.eq_obj1id[k]), int(model.eq_obj2id[k])) if joint >= 0]
    dofs = [int(model.jnt_dofadr[joint]) for joint in joints]
    refs = [float(model.qpos0[model.jnt_qposadr[joint]]) for joint in joints]
    return _of_lines(model, k, name, dofs, refs, float(model.dof_invweight0[dofs].sum()))


def _of_tendons(
    model: mujoco.MjModel, k: int, name: str, lines: Mapping[int, int], found: list[Tie], gate: Gate
) -> None:
    first, second = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
    tendons = [tendon for tendon in (first, second) if tendon in lines]  # no joint moves another, whose change is 0
    if not tendons:
        gate.note("equality", name, "no joint moves what it ties")
        return
    if first not in lines:
        still, moving = (name_of(model, "tendon", tendon) for tendon in (first, second))
        gate.refuse("equality", name, f"it ties {still}, which no joint moves, to {moving}: tie {moving} alone")
        return
    refs = [float(model.tendon_length0[tendon]) for tendon in tendons]
    weight = float(model.tendon_invweight0[tendons].sum())
    found.append(_of_lines(model, k, name, [lines[tendon] for tendon in tendons], refs, weight))


def _of_lines(model: mujoco.MjModel, k: int, name: str, lines: list[int], refs: list[float], weight: float) -> Tie:
    """A polynomial; of one line alone, its constant term."""
    poly = model.eq_data[k][:5].copy()
    if len(lines) == 1:
        poly[1:] = 0.0
        lines, refs = [*lines, WORLD], [*refs, 0.0]
    ref = (refs[0], refs[1])
    return Tie(name, TieKind.POLYNOMIAL, lines[0], lines[1], *_softness(model, k), (weight, weight), poly=poly, ref=ref)
