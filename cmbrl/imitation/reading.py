"""Motions from files.

- CSV without a header, one frame a row: root position x, y, z [m], root quaternion x, y, z, w, then the angle of every
  joint [rad] in the order of the model. Unitree's retargeted LAFAN1 clips have this form, at 30 frames a second.
- npz with ``q`` (N, nq) in MuJoCo's layout (quaternions w, x, y, z) and ``rate`` [frames/s]; with ``joint_names``, the
  joints' columns are taken by name, and joints without a servo may be missing: they stay as in the file.

A robot whose root is fixed to the world has the joints alone.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from cmbrl.data import npz
from cmbrl.errors import UserError
from cmbrl.imitation import feasible, plausible
from cmbrl.imitation.flight import hanging
from cmbrl.imitation.joints import driven, joint_names, root
from cmbrl.imitation.motion import Motion, check_finite
from cmbrl.reading import regular_file
from cmbrl.scene import Scene
from cmbrl.scene.records import Array

CSV_RATE = 30.0  # frames/s
ROOT = 7  # coordinates of a free body
_UNIT = 0.05  # a quaternion's length may be off by this


def read_motion(path: str | Path, scene: Scene, dt: float) -> Motion:
    """The motion in a file, at steps of ``dt`` [s]; warns of flights in which it hangs in the air.

    Raises UserError, which names the file, if it does not fit.
    """
    file = regular_file(path, "give the path of a motion (.csv or .npz)")
    if file.suffix == ".npz":
        q, rate = _npz(file, scene)
    elif file.suffix == ".csv":
        q, rate = _csv(file, scene), CSV_RATE
    else:
        raise UserError(f"{file}: motions are .csv or .npz files")
    if root(scene)[0]:
        length = np.linalg.norm(q[:, 3:ROOT], axis=1)
        wrong = np.flatnonzero(np.abs(length - 1) > _UNIT)
        if len(wrong):
            raise UserError(f"{file}: the quaternion of row {wrong[0] + 1} has length {length[wrong[0]]:.3g}, not 1")
        q[:, 3:ROOT] /= length[:, None]
    motion = Motion.of_frames(scene, q, rate, dt, str(file))
    flights = hanging(scene, q, rate)
    for told in (*([flights] if flights else []), *plausible.doubts(scene, q, rate), *feasible.doubts(scene, motion)):
        warnings.warn(f"{file}: {told}", stacklevel=2)
    return motion


def _csv(file: Path, scene: Scene) -> Array:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of NumPy, on a file without data: said below
            rows = np.loadtxt(file, delimiter=",", ndmin=2, dtype=np.float64)
    except ValueError as error:
        raise UserError(f"{file}: not a table of numbers ({str(error).splitlines()[0]})") from None
    _check_shape(file, rows, scene)
    check_finite(rows, str(file))
    if not root(scene)[0]:
        return rows
    return np.concatenate([rows[:, :3], rows[:, 6:7], rows[:, 3:6], rows[:, ROOT:]], axis=1)


def _npz(file: Path, scene: Scene) -> tuple[Array, float]:
    held = npz.read_arrays(file)
    for name, dimensions in (("q", 2), ("rate", 0)):
        if name not in held or held[name].dtype.kind not in "fiu" or held[name].ndim != dimensions:
            raise UserError(f"{file}: no numbers {name!r}; a motion holds q (N, nq) and rate () [frames/s]")
    q, rate = held["q"].astype(np.float64), float(held["rate"])
    check_finite(q, str(file))
    if "joint_names" in held:
        q = _by_name(file, q, [str(name) for name in np.ravel(held["joint_names"])], scene)
    _check_shape(file, q, scene)
    return q, rate


def _by_name(file: Path, q: Array, names: list[str], scene: Scene) -> Array:
    wanted, first = list(joint_names(scene)), root(scene)[0]
    if missing := [name for name, has in zip(wanted, driven(scene), strict=True) if has and name not in names]:
        raise UserError(
            f"{file}: has no joint {missing[0]!r} of {scene.name}: is it a motion of another robot? One that keeps "
            "still needs a column, too"
        )
    if q.shape[1] != first + len(names):
        raise UserError(
            f"{file}: q has {q.shape[1]} columns for {'a root and ' if first else ''}{len(names)} joints; give "
            f"{first + len(names)}"
        )
    filled = np.tile(scene.q0, (len(q), 1))
    filled[:, :first] = q[:, :first]
    for k, name in enumerate(wanted):
        if name in names:
            filled[:, first + k] = q[:, first + names.index(name)]
    return filled


def _check_shape(file: Path, rows: Array, scene: Scene) -> None:
    if not len(rows):
        raise UserError(f"{file}: has no frames")
    if rows.shape[1] != scene.nq:
        first, has = root(scene)[0], driven(scene)
        passive = [name for name, one in zip(joint_names(scene), has, strict=True) if not one] or [""]
        told = f" Joints without a servo, as {passive[0]!r}, may be missing in an npz with joint_names"
        raise UserError(
            f"{file}: {rows.shape[1]} columns, but {scene.name} has {scene.nq} coordinates (root {first}, joints "
            f"{scene.nq - first}): is it a motion of another robot?{told * (not has.all())}"
        )
