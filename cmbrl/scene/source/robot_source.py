"""What a scene is read from: an MJCF or URDF file, its text, a MuJoCo MjSpec or an MjModel; all become an MjModel."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import mujoco
import numpy as np
from numpy.typing import NDArray

from cmbrl.errors import UserError
from cmbrl.reading import regular_file
from cmbrl.scene.source.mjcf import name_of
from cmbrl.scene.source.precheck import check_xml

RobotSource: TypeAlias = str | Path | mujoco.MjSpec | mujoco.MjModel

LARGEST = 1e12  #: of any mass, length, stiffness or gain
_MASSLESS, _SAME_WAY = 1e14, 1e-9  # of 1 / mass, whose least is 1e-15 in MuJoCo; between axes
_INVERSE, _LIGHTEST = "invweight0", 1e16  # MuJoCo's 1 / masses: of a body of a milligram 1e6, of its turns 1e13
_OF_BODIES = ("body_", "jnt_", "dof_", "geom_", "pair_", "actuator_", "tendon_")
_PHYSICAL = ("qpos0", "qpos_spring", "wrap_prm", "eq_data", "eq_sol", *_OF_BODIES)
_NEVER_NEGATIVE = {  # what takes energy away, adds inertia, or is a distance, by owner
    "dof": ("armature", "damping", "frictionloss"),
    "tendon": ("armature", "damping", "frictionloss"),
    "actuator": ("armature", "damping"),
    "geom": ("gap",),
    "pair": ("gap",),
}
_LFS = b"version https://git-lfs"  # how the file begins that a clone without Git LFS has in place of another
_REMEDY = "give the path of an MJCF (.xml) or a URDF, its text, an MjSpec or an MjModel"


@dataclass(frozen=True)
class Compiled:
    """A compiled robot: where it came from, in a word, MuJoCo's warnings, and what was changed in a URDF."""

    model: mujoco.MjModel
    label: str  # for messages: the path, or what else it was
    file: Path | None  # None: not a file
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The name in ``<mujoco model="...">``, or the file's stem if it has none."""
        name = bytes(self.model.names).split(b"\0", 1)[0].decode()
        stem = self.file.stem if self.file else "robot"
        return stem if name in ("", "MuJoCo Model") else name.replace(" ", "_")


def compile_robot(source: RobotSource, ignore: Collection[str] = ()) -> Compiled:
    """Compiles ``source``; a string that starts with "<" is the text of an MJCF or a URDF, any other a path.

    A URDF is read as ``cmbrl convert`` reads it, on a fixed base and without actuators; ``ignore`` may have
    "missing_mesh".

    Raises UserError if a file is missing, is neither an MJCF nor a URDF, or does not compile.
    """
    notes: tuple[str, ...] = ()
    with quiet() as warnings:
        if isinstance(source, mujoco.MjModel):
            model, label, file = copy.copy(source), "MjModel", None  # which reading changes
        elif isinstance(source, mujoco.MjSpec):
            model, label, file = _compiled("MjSpec", source.compile), "MjSpec", None
        elif isinstance(source, str) and source.lstrip().startswith("<"):
            label, file, text = "XML text", None, source
            root = check_xml(text)
            model, notes = _from_xml(root, label, Path(label), text, ignore)
        else:
            file = regular_file(source, _REMEDY)
            label = _named(file)
            root = check_xml(file)
            model, notes = _from_xml(root, label, file, None, ignore)
    try:
        bytes(model.names).decode()
    except UnicodeDecodeError:
        raise UserError(f"{label}: has a name that is not UTF-8: save the file as UTF-8") from None
    _check_signs(model, label)
    _check_inertia(model, label)
    _check_values(model, label)
    return Compiled(model, label, file, tuple(warnings), notes)


def _named(file: Path) -> str:
    """The path as MuJoCo takes it; raises UserError for one that is not UTF-8, as by a locale of another encoding."""
    label = str(file)
    try:
        label.encode()
    except UnicodeEncodeError:
        raise UserError(f"{label}: the path is not UTF-8: rename it, or set a UTF-8 locale (LC_ALL=C.UTF-8)") from None
    return label


def _from_xml(
    root: str, label: str, file: Path, text: str | None, ignore: Collection[str]
) -> tuple[mujoco.MjModel, tuple[str, ...]]:
    """The model of a file, or of its text, whose root element is ``root``, and notes."""
    if root == "robot":
        from cmbrl.scene.urdf.convert import compile_urdf  # which reads with what is above

        return compile_urdf(file.read_bytes() if text is None else text.encode(), file, ignore)
    read = mujoco.MjModel.from_xml_path if text is None else mujoco.MjModel.from_xml_string
    return _compiled(label, lambda: read(text or label)), ()


def _compiled(label: str, compile_it: Callable[[], mujoco.MjModel]) -> mujoco.MjModel:
    try:
        return compile_it()
    except Exception as error:  # ValueError; for sizes and names that it cannot hold, several others
        raise UserError(f"{label}: MuJoCo cannot compile this file: {error}{_hint(str(error))}") from None


def _hint(error: str) -> str:
    """What helps where MuJoCo's error does not say it."""
    if any(is_pointer(name) for name in re.findall(r"'([^'\0]+)'", error)):
        return "; that file is a pointer of Git LFS: get what it stands for with `git lfs pull`"
    return ""


def is_pointer(name: str | Path) -> bool:
    """Whether a file is a pointer of Git LFS."""
    try:
        with Path(name).open("rb") as file:
            return file.read(len(_LFS)) == _LFS
    except OSError:
        return False


def _check_inertia(model: mujoco.MjModel, label: str) -> None:
    """Raises UserError where joints may move without moving any mass: there the mass matrix is singular."""
    for dof in np.flatnonzero((model.dof_invweight0 > _MASSLESS) | _hidden(model)):
        name = name_of(model, "joint", int(model.dof_jntid[dof]))
        raise UserError(
            f"{label}: joint {name!r} can move without moving any mass: give its body mass or the joint armature, and "
            "joints of one body different axes"
        )


def _hidden(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Dofs (nv,) without rotors of bodies that those move in fewer ways than there are.

    MuJoCo's weights tell it of all but slides alone, whose masses it takes to be apart.
    """
    ways = np.zeros((model.nv, 6))  # turn about, and velocity of, the body's origin
    for dof, joint in enumerate(model.dof_jntid):
        kind, axis, place = model.jnt_type[joint], model.jnt_axis[joint], model.jnt_pos[joint]
        if kind == mujoco.mjtJoint.mjJNT_HINGE:
            ways[dof] = *axis, *np.cross(place, axis)
        elif kind == mujoco.mjtJoint.mjJNT_SLIDE:
            ways[dof, 3:] = axis
        else:  # each turns or slides about an axis of its own
            ways[dof, (dof - int(model.jnt_dofadr[joint])) % 6] = 1.0
    hidden = np.zeros(model.nv, dtype=bool)
    for body in np.flatnonzero(model.body_dofnum > 1):
        own = model.body_dofadr[body] + np.arange(model.body_dofnum[body])
        own = own[model.dof_armature[own] == 0.0]  # a rotor moves with its own joint alone
        hidden[own] = len(own) > 0 and np.linalg.matrix_rank(ways[own], tol=_SAME_WAY) < len(own)
    return hidden


def _check_values(model: mujoco.MjModel, label: str) -> None:
    """Raises UserError unless every number that describes the motion is within LARGEST; ranges may be infinite."""
    for owner, prefixes in ((model, _PHYSICAL), (model.opt, ("",))):
        for name in dir(owner):
            if not name.startswith(prefixes) or name.startswith("_") or name.endswith("_user"):
                continue
            values = np.asarray(getattr(owner, name)) if not callable(getattr(owner, name)) else np.zeros(0)
            if values.dtype.kind != "f":
                continue
            most = _LIGHTEST if name.endswith(_INVERSE) else LARGEST
            bad = np.isnan(values) if name.endswith("range") else ~(np.abs(values) <= most)
            if bad.any():
                at = f"[{np.argwhere(np.atleast_1d(bad))[0][0]}]" if values.ndim else ""
                value = np.atleast_1d(values)[np.atleast_1d(bad)][0]
                raise UserError(f"{label}: MuJoCo's {name}{at} is {value:g}; give numbers of a robot, at most {most:g}")


def _check_signs(model: mujoco.MjModel, label: str) -> None:
    """Raises UserError for negative numbers that mean nothing, and that MuJoCo takes in ways of its own."""
    for kind, field in ((kind, field) for kind, fields in _NEVER_NEGATIVE.items() for field in fields):
        values = getattr(model, f"{kind}_{field}", np.zeros(0))  # some are of recent MuJoCo versions
        for k in np.flatnonzero(values < 0)[:1].tolist():
            owner, number = ("joint", int(model.dof_jntid[k])) if kind == "dof" else (kind, k)
            name = name_of(model, owner, number)
            raise UserError(f"{label}: {owner} {name!r} has {field} {values[k]:g}; give 0 or more")


@contextmanager
def quiet() -> Iterator[list[str]]:
    """Collects MuJoCo's warnings; by default MuJoCo prints them and writes MUJOCO_LOG.TXT to the working directory."""
    warnings: list[str] = []
    handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(warnings.append)
    try:
        yield warnings
    finally:
        mujoco.set_mju_user_warning(handler)
