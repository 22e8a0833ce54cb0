"""A robot with some joints held: a gripper whose fingers no log tells, a waist that is bolted down.

What hangs on a held joint alone goes with it: its motor, its tendon, its sensors and couplings of what can no longer
move. What ties it to a joint that still moves is refused, since then the joint would have to be held as well.

MuJoCo lets a body and its parent pass through each other, unless the parent cannot move. A held root would push its
links away, where shapes overlap at the joints: such pairs are excluded, as they are while the root is free. It hangs
(:mod:`cmbrl.scene.writing.lifted`).
"""

from __future__ import annotations

import fnmatch
import itertools
import os
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile

import mujoco
import numpy as np

from cmbrl.errors import UserError
from cmbrl.scene.source.mjcf import controlled, name_of
from cmbrl.scene.source.robot_source import compile_robot, quiet
from cmbrl.scene.writing.fitted_file import fix_paths
from cmbrl.scene.writing.lifted import lifts
from cmbrl.text import did_you_mean

_JOINT, _TENDON, _ACTUATOR = (
    mujoco.mjtObj.mjOBJ_JOINT, mujoco.mjtObj.mjOBJ_TENDON, mujoco.mjtObj.mjOBJ_ACTUATOR,
)  # fmt: skip
_HINGED = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_KINDS = {  # of what an actuator drives; one of a site or a body stays
    int(mujoco.mjtTrn.mjTRN_JOINT): _JOINT, int(mujoco.mjtTrn.mjTRN_JOINTINPARENT): _JOINT,
    int(mujoco.mjtTrn.mjTRN_TENDON): _TENDON,
}  # fmt: skip
_WRAP = mujoco.mjtWrap.mjWRAP_JOINT
_BETWEEN_BODIES = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))


@dataclass(frozen=True)
class Held:
    """The ``text`` of an MJCF, and by body how far [m] bases that float in the robot's own file were lifted in it."""

    text: str
    lifted: Mapping[str, float]


def held_file(path: str | os.PathLike[str], joints: Mapping[str, float | None]) -> Held:
    """The MJCF ``path`` without ``joints``, each held at a value [rad, m], or where the file has it.

    They are names, or patterns of several, as ``caster_*``. Floating bases are held above where anything of them may
    reach the ground. Paths of meshes become absolute. Raises UserError for an unknown joint, a value of a ball or free
    joint, one of two joints of a body moved away from where the file has it, or a tendon or coupling with a joint that
    is not held.
    """
    compiled = compile_robot(path)
    if compiled.notes:
        raise UserError(f"{path}: is a URDF: make an MJCF of it by `cmbrl convert`, and hold joints of that")
    model = compiled.model
    known = [name_of(model, "joint", k) for k in range(model.njnt)]
    found: dict[str, float | None] = {}
    for name, value in joints.items():
        meant = [name] if name in known else [each for each in known if fnmatch.fnmatchcase(each, name)]
        if not meant:
            raise UserError(f"{path}: no joint {name!r}; {did_you_mean(name, known)}")
        found |= dict.fromkeys(meant, value)
    joints = found
    with quiet():
        try:
            spec = mujoco.MjSpec.from_file(str(path))
            fix_paths(spec)
            model = spec.compile()
            _name_all(spec, model)
            spec.compile()
            spec = mujoco.MjSpec.from_string(spec.to_xml())  # its frames and defaults are resolved
            model = spec.compile()
            _place(spec, model, joints, str(path))
            ways = lifts(model, joints)
            for name, way in ways.items():
                spec.body(name).pos += way
            _remove(spec, model, set(joints), str(path))
            _untie(spec)
            _keep_apart(spec, model)
            spec.compile()
            return Held(str(spec.to_xml()), {name: float(np.linalg.norm(way)) for name, way in ways.items()})
        except UserError:
            raise
        except (ValueError, mujoco.FatalError) as error:
            raise UserError(f"{path}: MuJoCo cannot write this file with held joints ({error})") from None


def holding(joints: Sequence[str], known: Sequence[str]) -> str:
    """The options that hold ``joints``: a pattern where they are many, and no other one of those ``known`` has it."""
    alike = takewhile(lambda pair: pair[0] == pair[1], zip(min(joints), max(joints), strict=False))
    pattern = "".join(letter for letter, _ in alike) + "*"
    if len(joints) > 2 and {name for name in known if fnmatch.fnmatchcase(name, pattern)} == set(joints):
        return f"--hold '{pattern}'"
    return " ".join(f"--hold {name}" for name in joints)


def _name_all(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Names what has no name and may be looked up: two tendons without one could not be told apart.

    Each gets the name that it has everywhere else, such as that of a floating base, or an actuator's of its joint: a
    log of the robot names them so. Only where two would be called alike is there a new one.
    """
    every = {"joint": spec.joints, "body": spec.bodies, "tendon": spec.tendons, "actuator": spec.actuators}
    for kind, elements in every.items():
        taken = {element.name for element in elements}
        for element in (element for element in elements if not element.name):
            name = name_of(model, kind, element.id)
            element.name = f"unnamed_{kind}_{element.id}" if name in taken else name
            taken.add(element.name)


def _place(spec: mujoco.MjSpec, model: mujoco.MjModel, joints: Mapping[str, float | None], path: str) -> None:
    """Moves bodies to where held joints put them."""
    data = mujoco.MjData(model)
    moved = set()
    for name, value in joints.items():
        joint = model.joint(name)
        hinged = joint.type[0] in _HINGED
        if value is None or (hinged and value == joint.qpos0[0]):
            continue
        body = model.body(joint.bodyid[0])
        others = [model.joint(k).name for k in range(body.jntadr[0], body.jntadr[0] + body.jntnum[0])]
        if not hinged:
            raise UserError(
                f"{path}: joint {name!r} is no hinge or slide: hold it where the file has it, without a value"
            )
        if not set(others) <= set(joints):
            raise UserError(f"{path}: joint {name!r} shares its body with {_others(others, joints)}: hold that as well")
        data.qpos[joint.qposadr[0]] = value
        moved.add(int(body.id))
    mujoco.mj_kinematics(model, data)
    for k in moved:
        turn, above = data.xmat[model.body_parentid[k]].reshape(3, 3).T, model.body_parentid[k]
        body, quaternion = spec.body(model.body(k).name), np.empty(4)
        mujoco.mju_mat2Quat(quaternion, (turn @ data.xmat[k].reshape(3, 3)).ravel())
        body.pos, body.quat = turn @ (data.xpos[k] - data.xpos[above]), quaternion


def _remove(spec: mujoco.MjSpec, model: mujoco.MjModel, joints: set[str], path: str) -> None:
    """Takes out joints, and what is theirs alone."""
    gone = {_JOINT: joints, _TENDON: set(_tendons(model, joints, path)), _ACTUATOR: set[str]()}
    _keep_keyframes(spec, model, joints, gone)
    for actuator in list(spec.actuators):
        kind = _KINDS.get(int(actuator.trntype))
        if kind is not None and actuator.target in gone[kind]:
            gone[_ACTUATOR].add(actuator.name)
            spec.delete(actuator)
    for equality in list(spec.equalities):
        coupled = {mujoco.mjtEq.mjEQ_JOINT: _JOINT, mujoco.mjtEq.mjEQ_TENDON: _TENDON}.get(equality.type)
        names = {name for name in (equality.name1, equality.name2) if name}
        if coupled is None or not names & gone[coupled]:
            continue
        if not names <= gone[coupled]:
            raise UserError(
                f"{path}: {_others(sorted(names), gone[coupled])} is coupled to a held joint: hold it as well"
            )
        spec.delete(equality)
    for sensor in list(spec.sensors):
        if sensor.objname in gone.get(sensor.objtype, ()):
            spec.delete(sensor)
    for tendon in [each for each in spec.tendons if each.name in gone[_TENDON]]:
        spec.delete(tendon)
    for name in joints:
        spec.delete(spec.joint(name))


def _tendons(model: mujoco.MjModel, joints: set[str], path: str) -> Iterator[str]:
    """Names of the tendons of held joints alone."""
    for k in range(model.ntendon):
        wraps = range(model.tendon_adr[k], model.tendon_adr[k] + model.tendon_num[k])
        own = [model.joint(model.wrap_objid[w]).name for w in wraps if model.wrap_type[w] == _WRAP]
        name = model.tendon(k).name
        if not set(own) & joints:
            continue
        if not set(own) <= joints:
            raise UserError(f"{path}: tendon {name!r} pulls {_others(own, joints)} too: hold it as well")
        yield name


def _keep_keyframes(
    spec: mujoco.MjSpec, model: mujoco.MjModel, joints: set[str], gone: Mapping[mujoco.mjtObj, set[str]]
) -> None:
    """Takes the numbers of held joints and their motors out of keyframes."""
    q, v = np.ones(model.nq, dtype=bool), np.ones(model.nv, dtype=bool)
    for name in joints:
        joint = model.joint(name)
        q[joint.qposadr[0] : joint.qposadr[0] + len(joint.qpos0)] = False
        v[joint.dofadr[0] : joint.dofadr[0] + len(joint.damping)] = False
    driven = [_driven(model, k) for k in range(len(model.actuator_trntype))]
    stay = np.array([name not in gone[kind] for kind, name in driven], dtype=bool)
    a = np.ones(model.na, dtype=bool)
    for k in np.flatnonzero(~stay):
        a[model.actuator_actadr[k] : model.actuator_actadr[k] + model.actuator_actnum[k]] = False
    for key in spec.keys:
        for name, stays in (("qpos", q), ("qvel", v), ("ctrl", stay[controlled(model)]), ("act", a)):
            if len(numbers := np.asarray(getattr(key, name))) == len(stays):
                setattr(key, name, numbers[stays])


def _driven(model: mujoco.MjModel, actuator: int) -> tuple[mujoco.mjtObj, str]:
    """What an actuator drives: the kind and the name; of sites and bodies, nothing that can be held."""
    kind, target = _KINDS.get(int(model.actuator_trntype[actuator])), model.actuator_trnid[actuator, 0]
    return (_JOINT, "") if kind is None else (kind, _names(model, kind)[target])


def _untie(spec: mujoco.MjSpec) -> None:
    """Takes out what connects and welds bodies between which nothing moves any more."""
    model = spec.compile()
    for k, equality in reversed(list(enumerate(spec.equalities))):
        if int(equality.type) not in _BETWEEN_BODIES:
            continue
        ends = model.eq_obj1id[k], model.eq_obj2id[k]
        if model.eq_objtype[k] == mujoco.mjtObj.mjOBJ_SITE:
            ends = model.site_bodyid[ends[0]], model.site_bodyid[ends[1]]
        if model.body_weldid[ends[0]] == model.body_weldid[ends[1]]:
            spec.delete(equality)


def _keep_apart(spec: mujoco.MjSpec, free: mujoco.MjModel) -> None:
    """Excludes contacts of what is held with its links, where ``free``, the robot before, had none as parent and child.

    Bodies of a file are the same, in the same order, whatever is held.
    """
    if free.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT:
        return
    held = spec.compile()
    solid = [k for k in range(free.nbody) if held.body_geomnum[k] and free.body_weldid[k]]
    known = {frozenset((each.bodyname1, each.bodyname2)) for each in spec.excludes}
    for one, other in itertools.combinations(solid, 2):
        static = [held.body_weldid[k] == 0 for k in (one, other)]
        names = free.body(one).name, free.body(other).name
        if static[0] != static[1] and _parent_and_child(free, one, other) and frozenset(names) not in known:
            spec.add_exclude(bodyname1=names[0], bodyname2=names[1])


def _parent_and_child(model: mujoco.MjModel, one: int, other: int) -> bool:
    """Whether the body of one is right above the other's, each with all that is welded to it."""
    weld = model.body_weldid[one], model.body_weldid[other]
    above = [model.body_weldid[model.body_parentid[k]] for k in weld]
    return bool(weld[0] == above[1] or weld[1] == above[0])


def _names(model: mujoco.MjModel, kind: mujoco.mjtObj) -> list[str]:
    count = model.njnt if kind == _JOINT else model.ntendon
    return [mujoco.mj_id2name(model, kind, k) or "" for k in range(count)]


def _others(names: list[str], joints: Container[str]) -> str:
    """The joints among ``names`` that are not held."""
    return ", ".join(repr(name) for name in names if name not in joints)
