"""The physical parameters of a model as one vector theta (np,), in the order of the scene's parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cmbrl.errors import UserError, did_you_mean
from cmbrl.models.between.observation import Observation
from cmbrl.numbers import real, real_array, shown
from cmbrl.scene import Scene


def checked(scene: Scene, theta: Any) -> np.ndarray:
    """A copy of ``theta`` (np,); raises UserError for another shape, or a value outside its parameter's bounds."""
    theta = real_array(theta, "parameters").copy()
    if theta.shape != (len(scene.parameters),):
        raise UserError(f"parameters have shape {theta.shape}; scene {scene.name!r} has {len(scene.parameters)}")
    for p, x in zip(scene.parameters, theta, strict=True):
        if not p.low <= x <= p.high:
            raise UserError(f"parameter {p.name} = {x:g} is outside its bounds [{p.low:g}, {p.high:g}]")
    return theta


def checked_sets(scene: Scene, observer: Observation, sets: Any) -> np.ndarray:
    """A copy of ``sets`` (K, np), or (K, np + n) with what lies between a log and each; raises as ``checked``."""
    rows, count = np.atleast_2d(real_array(sets, "candidates")), len(scene.parameters)
    for row in rows:
        checked(scene, row[:count] if row.shape == (count + len(observer),) else row)
    return np.array(rows)


def replaced(scene: Scene, theta: np.ndarray, values: Mapping[str, Any]) -> np.ndarray:
    """``theta`` (np,) with the ``values`` of some parameters by name; raises UserError for an unknown name."""
    known = {p.name: i for i, p in enumerate(scene.parameters)}
    changed = theta.copy()
    for name, value in values.items():
        if name not in known:
            raise UserError(f"no parameter {shown(name)} in scene {scene.name!r}: {did_you_mean(str(name), known)}")
        changed[known[name]] = real(value, name)
    return changed


def by_name(scene: Scene, theta: np.ndarray) -> dict[str, float]:
    """``theta`` (np,) as JSON has it."""
    return dict(zip([p.name for p in scene.parameters], theta.tolist(), strict=True))


def from_names(scene: Scene, values: Mapping[str, float]) -> np.ndarray:
    """Inverse of :func:`by_name`, (np,); raises UserError unless it names the parameters of the scene, and no others.

    Laws that move on request alone may be missing: an earlier version did not have them, and they are as in the file.
    """
    known = {p.name: i for i, p in enumerate(scene.parameters)}
    theta = scene.parameter_vector()
    for name, value in values.items():
        if name not in known:
            raise UserError(
                f"{name!r} is not a parameter of scene {scene.name!r}; was the model fitted to another scene?"
            )
        theta[known[name]] = value
    if missing := [p.name for p in scene.parameters if p.default and p.name not in values]:
        raise UserError(f"no value for the parameter {missing[0]!r} of scene {scene.name!r}: fit again")
    return theta
