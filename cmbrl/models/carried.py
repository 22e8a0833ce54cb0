"""A fit for a task: at the task's control step, and for another file of its robot.

A robot is often fitted where it hangs or is bolted down, from a log of its encoders, and then trained where it walks.
Joints, actuators and links have the same names in both files, and so have their parameters.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.checks import TIME_STEP_TOLERANCE
from cmbrl.data.drive import law_of
from cmbrl.errors import UserError
from cmbrl.scene.fittable.play import plays

if TYPE_CHECKING:
    from cmbrl.models.complementarity import ComplementarityModel
    from cmbrl.scene import Scene

_FEW = 4  # names in a warning


def fit_for(fit: ComplementarityModel, nominal: ComplementarityModel, label: str) -> ComplementarityModel:
    """``fit`` where it is of the robot of a task, whose model of the file is ``nominal``; at the control step of that.

    A fit of the task's file with play is taken without it (``without_play``). Where the two files differ in their
    coordinates otherwise, the model is ``nominal`` with what the fit moved: parameters, biases of encoders, and
    lateness of commands, by name; its candidates too, within the bounds there. A warning tells what has no place
    there. Shares, such as masses, are shares of the file that they are carried to.

    Raises UserError for a fit of another robot, for an actuator that takes other commands than the task's, and for a
    value outside its bounds.
    """
    scene, own = nominal.scene, fit.scene
    _check_robot(own, scene, label)
    if is_without_play(scene, own):
        warnings.warn(
            f"{label}: {scene.name} has no play: the fit's gaps are left out, its other numbers kept", stacklevel=2
        )
        fit = without_play(fit, scene)
    if fit.coordinates == nominal.coordinates and own.nu == scene.nu:
        same = abs(fit.dt - nominal.dt) <= TIME_STEP_TOLERANCE * nominal.dt
        return fit if same else fit.at(nominal.dt)
    places = {p.name: k for k, p in enumerate(scene.parameters)}
    known = {p.name for p in nominal.observer.parameters}
    moved = [k for k, p in enumerate(own.parameters) if fit.parameters[k] != p.nominal]
    between = {name: x for name, x in fit.observation.items() if x}
    taken = [k for k in moved if own.parameters[k].name in places]
    lost = [own.parameters[k].name for k in moved if k not in taken] + [name for name in between if name not in known]
    count = len(moved) + len(between)
    if len(lost) == count > 0:
        raise UserError(f"{label}: none of what it moved is a parameter of {scene.name}: fit that file")
    if lost:
        told = ", ".join(lost[:_FEW]) + (", ..." if len(lost) > _FEW else "")
        warnings.warn(
            f"{label}: a fit of {own.name}; {len(lost)} of the {count} numbers that it moved have no place in "
            f"{scene.name} and are left out: {told}",
            stacklevel=2,
        )
    there = [places[own.parameters[k].name] for k in taken]
    theta = nominal.parameters.copy()
    theta[there] = fit.parameters[taken]
    candidates = None
    if fit.candidates is not None:
        candidates = np.tile(theta, (len(fit.candidates), 1))
        candidates[:, there] = fit.candidates[:, taken]
        candidates = np.clip(candidates, *np.array([(p.low, p.high) for p in scene.parameters]).T)
        candidates = np.hstack([candidates, _between(fit, nominal)])
    observation = {name: x for name, x in between.items() if name in known}
    return nominal.with_settings(parameters=theta, candidates=candidates, observation=observation)


def _between(fit: ComplementarityModel, model: ComplementarityModel) -> np.ndarray:
    """What ``fit``'s candidates end with, by name as those of ``model`` do: (K, n), or (K, 0) where they do not."""
    assert fit.candidates is not None
    rows = fit.candidates[:, len(fit.parameters) :]
    if not rows.shape[1]:
        return rows
    known = {p.name: k for k, p in enumerate(fit.observer.parameters)}
    columns = [rows[:, known[p.name]] if p.name in known else 0.0 * rows[:, 0] for p in model.observer.parameters]
    return np.column_stack(columns)


def is_without_play(scene: Scene, own: Scene) -> bool:
    """Whether ``scene`` is that of a file to which play was added in ``own``."""
    gaps = {joint.name for joint in plays(own.joints)}
    same = [name for name in own.joint_names if name not in gaps] == list(scene.joint_names)
    return bool(gaps) and same and {p.name for p in scene.parameters} <= {p.name for p in own.parameters}


def without_play(fit: ComplementarityModel, scene: Scene) -> ComplementarityModel:
    """``fit`` of a file with play, on the ``scene`` of the same file without: its laws, parameters and candidates."""
    known = {p.name: k for k, p in enumerate(fit.scene.parameters)}
    columns = [known[p.name] for p in scene.parameters]
    bare = fit.with_settings(scene=scene, parameters=fit.parameters[columns], candidates=None)
    if fit.candidates is None:
        return bare
    return bare.with_settings(candidates=np.hstack([fit.candidates[:, columns], _between(fit, bare)]))


def _check_robot(own: Scene, scene: Scene, label: str) -> None:
    """Raises UserError unless the actuators of one file are among those of the other, and take the same commands."""
    have, need = own.actuator_names, scene.actuator_names
    sizes = [(s.nq, s.nv, s.nu) for s in (own, scene)]
    if sizes[0] != sizes[1] and not (set(have) <= set(need) or set(need) <= set(have)):
        raise UserError(f"{label}: model of another robot: nq, nv, nu {sizes[0]}, {scene.name} has {sizes[1]}")
    for name in sorted(set(have) & set(need)):
        kinds = [law_of(s, s.actuator_names.index(name))[0] for s in (own, scene)]
        if kinds[0] != kinds[1]:
            raise UserError(
                f"{label}: actuator {name!r} takes a {kinds[0]} there and a {kinds[1]} in the task: give the task "
                f'drives=(Drive("*", "{kinds[0]}", ...),), see cmbrl.scene.drives'
            )
