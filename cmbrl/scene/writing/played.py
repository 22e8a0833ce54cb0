"""A robot with play behind some of its joints: each gets a joint of its own for it (``play``)."""

from __future__ import annotations

import fnmatch
import os
import warnings
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from cmbrl.errors import UserError
from cmbrl.files import write_text
from cmbrl.scene.fittable.play import SUFFIX
from cmbrl.scene.scene import Scene
from cmbrl.scene.source.robot_source import compile_robot, quiet
from cmbrl.scene.writing.fitted_file import fix_paths
from cmbrl.text import did_you_mean

GAPS = {True: 0.001, False: 0.01}  #: by whether it slides: the gap where none is given [m, rad]
_STOP, _IMPEDANCE = (0.004, 1.0), (0.95, 0.99, 1e-3, 0.5, 2.0)  # solref and solimp of the ends
_HINGE, _SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE


def played_file(path: str | os.PathLike[str], joints: Mapping[str, float | None]) -> str:
    """The text of the MJCF ``path`` with play behind ``joints``, each with a gap [rad, m] from end to end.

    They are names, or patterns of several; gaps default to ``GAPS``. Paths of meshes become absolute. Raises UserError
    for an unknown joint, one that is no hinge or slide, has play already or no armature, and a gap that is not above 0.
    """
    if compile_robot(path).notes:
        raise UserError(f"{path}: is a URDF: make an MJCF of it by `cmbrl convert`, and give that play")
    with quiet(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # MuJoCo's on the file, which the scene has told
        try:
            spec = mujoco.MjSpec.from_file(str(path))
            for name, gap in _meant(joints, [joint.name for joint in spec.joints if joint.name], str(path)).items():
                _add(spec, name, gap, str(path))
            for key in list(spec.keys):  # poses of fewer joints
                spec.delete(key)
            fix_paths(spec)
            spec.compile()
            return str(spec.to_xml())
        except UserError:
            raise
        except (ValueError, mujoco.FatalError) as error:
            raise UserError(f"{path}: MuJoCo cannot write this file with play ({error})") from None


def played_scene(scene: Scene, joints: Mapping[str, float | None], out: str | os.PathLike[str] | None = None) -> Scene:
    """The ``scene`` of a file with play behind ``joints``, as in ``played_file``, read as it was; ``out``: its file."""
    text = played_file(scene.path, joints)
    if out is not None:
        write_text(out, text)
    source = text if out is None else out
    return Scene.from_mjcf(source, scene.ignore, scene.contact_law, scene.reduce, scene.self_contact, scene.drives)


def gaps_of(scene: Scene) -> dict[str, float]:
    """The gaps [rad, m] that the file of ``scene`` has, by the joint that the play is behind."""
    return {p.name.partition(".")[2]: p.nominal for p in scene.parameters if p.group == "play"}


def _meant(joints: Mapping[str, float | None], known: Sequence[str], path: str) -> dict[str, float | None]:
    """Gaps by the name of the joint, for names and patterns."""
    found: dict[str, float | None] = {}
    for name, gap in joints.items():
        meant = [name] if name in known else [each for each in known if fnmatch.fnmatchcase(each, name)]
        if not meant:
            raise UserError(f"{path}: no joint {name!r}; {did_you_mean(name, known)}")
        found |= dict.fromkeys(meant, gap)
    return found


def _add(spec: mujoco.MjSpec, name: str, gap: float | None, path: str) -> None:
    joint = spec.joint(name)
    if joint.type not in (_HINGE, _SLIDE):
        raise UserError(f"{path}: joint {name!r} is no hinge or slide: only those have play")
    if spec.joint(name + SUFFIX) is not None:
        raise UserError(f"{path}: joint {name!r} has play already, {name + SUFFIX!r}: leave it out of --play")
    if joint.armature == 0.0:
        raise UserError(f"{path}: joint {name!r} has no armature: give it the rotor that runs through its gap")
    gap = GAPS[joint.type == _SLIDE] if gap is None else gap
    if not 0.0 < gap < np.inf:
        raise UserError(f"--play {name}={gap:g}: give the gap from end to end, above 0 [rad, m]")
    half = 0.5 * (np.rad2deg(gap) if spec.compiler.degree and joint.type == _HINGE else gap)
    joint.parent.add_joint(
        name=name + SUFFIX, type=joint.type, axis=joint.axis, pos=joint.pos, range=(-half, half),
        limited=mujoco.mjtLimited.mjLIMITED_TRUE, solref_limit=_STOP, solimp_limit=_IMPEDANCE,
        armature=0.0, frictionloss=0.0, margin=0.0,
        damping=np.zeros(np.size(joint.damping)), stiffness=np.zeros(np.size(joint.stiffness)),
    )  # fmt: skip
