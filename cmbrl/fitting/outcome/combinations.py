"""What a log tells of masses, centres and inertias together, where it does not tell them one by one.

A joint feels the bodies beyond it by few numbers: the inertia about its axis, and how large gravity's torque gets as it
turns. These are base parameters of the robot (Khalil and Dombre, Modeling, Identification and Control of Robots, 2002,
chapter 9): sums over bodies, which motion tells even where each body by itself could be another one. Their intervals
follow from the covariance of all parameters, flat ones included, since errors that cancel in a sum do no harm to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cmbrl.fitting.search.space import Space
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene.records import JointKind

WEIGHT = "gravity's"  #: how names of what gravity does at a joint begin
_BODIES = ("mass", "com_x", "com_y", "com_z", "inertia", "inertia_tilt")  # groups
_STEP = 1e-4  # of z, of the differences
_TOLD = 0.5  # of the prior's standard deviation: more is not told by the log
_LEAST = 1e-3  # of the largest torque of a joint; smaller ones are not reported
_NORMAL_95 = 1.96


def combinations(
    model: ComplementarityModel,
    space: Space,
    z: np.ndarray,
    covariance: np.ndarray,
    flat: np.ndarray,
    pose: np.ndarray,
    together: Sequence[int] = (),
) -> tuple[list[dict[str, Any]], str | None]:
    """Inertia and largest torque of gravity of each joint that the log tells, while parameters of bodies are flat.

    Args:
        model: of the fit.
        space: of all parameters.
        z: (n,) where the fit ended.
        covariance: (n, n) in z, of the flat parameters too.
        flat: mask (n,) of the parameters that the log hardly tells.
        pose: q (nq,) at which joints feel what hangs on them; the joint itself turns.
        together: columns of a common factor, the unit of force, if motion does not tell it.

    Returns:
        {"name", "value", "low", "high", "nominal", "unit"} each, and the parameter of ``together`` in whose unit they
        are, as the file has it: the one that leaves them the narrowest intervals.
    """
    bodies = np.isin(space.groups, _BODIES)
    if not (bodies & flat).any():
        return [], None
    names, units, felt = _felt(model, space, pose)
    moved = np.diag(covariance) > 0.0
    value, nominal = felt(z), felt(np.zeros_like(z))
    slope = np.zeros((len(names), len(z)))
    for k in np.flatnonzero(moved):
        step = np.zeros_like(z)
        step[k] = _STEP
        slope[:, k] = (np.log(felt(z + step)) - np.log(felt(z - step))) / (2 * _STEP)
    concerns = (np.abs(slope[:, bodies & flat]) > 0.0).any(axis=1)
    torques = np.arange(len(names)) < len(names) // 2
    heavy = ~torques | (value > _LEAST * value[torques].max(initial=0.0))
    reference = _reference(space, slope[concerns & heavy], covariance, together)
    if reference is not None:
        slope[:, reference] -= space.sd[reference]
        value = value * space.nominal[reference] / space.theta(z)[reference]
    believed = np.zeros_like(covariance)
    own = np.ix_(moved, moved)
    believed[own] = np.linalg.inv(space.precision)[own]
    spread, prior = _spread(slope, covariance), _spread(slope, believed)
    with np.errstate(over="ignore"):  # of what a short log does not tell at all, and no row tells
        factor = np.exp(_NORMAL_95 * spread)
    rows = [
        {
            "name": names[k], "value": float(value[k]), "low": float(value[k] / factor[k]),
            "high": float(value[k] * factor[k]), "nominal": float(nominal[k]), "unit": units[k],
        }
        for k in np.flatnonzero(concerns & heavy & (spread < _TOLD * prior))
    ]  # fmt: skip
    return rows, None if reference is None else space.names[reference]


def _reference(space: Space, slope: np.ndarray, covariance: np.ndarray, together: Sequence[int]) -> int | None:
    """The column of ``together`` beside which what has these slopes (m, n) is known best; None if there is none.

    Not one of the bodies where there is another: beside a link's mass, the file alone tells its weight.
    """
    columns = [k for k in together if space.transform[k] == "log" and covariance[k, k] > 0.0]
    columns = [k for k in columns if space.groups[k] not in _BODIES] or columns
    beside = [_spread(slope - space.sd[k] * (np.arange(slope.shape[1]) == k), covariance).sum() for k in columns]
    return columns[int(np.argmin(beside))] if columns else None


def _spread(slope: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Standard deviations (m,) of logarithms that have these slopes (m, n); rounding may leave less than nothing."""
    return np.sqrt(np.maximum(((slope @ covariance) * slope).sum(axis=1), 0.0))


def _felt(model: ComplementarityModel, space: Space, pose: np.ndarray) -> tuple[list[str], list[str], Any]:
    """Names and units of what joints feel, and these numbers (k,) as a function of z."""
    scene = model.scene
    joints = [joint for joint in scene.joints if joint.kind != JointKind.BALL]
    places, count = [joint.vadr for joint in joints], len(joints)
    poses = np.tile(pose, (1 + 2 * count, 1))
    for k, joint in enumerate(joints):
        if joint.kind == JointKind.HINGE:
            poses[2 + 2 * k, joint.qadr] += np.pi / 2
    still, free = np.zeros((len(poses), scene.nv)), len(scene.parameters)

    def felt(z: np.ndarray) -> np.ndarray:
        theta = space.theta(z)
        dynamics = model.smooth_dynamics(poses, still, theta[:free], contacts=False)
        inertia = np.array([dynamics["M"][0, d, d] for d in places])
        sides = np.array([[dynamics["bias"][1 + 2 * k + side, d] for side in (0, 1)] for k, d in enumerate(places)])
        hinge = np.array([joint.kind == JointKind.HINGE for joint in joints], dtype=bool)
        torque = np.where(hinge, np.hypot(*sides.T), np.abs(sides[:, 0]))
        return np.maximum(np.concatenate([torque, inertia]), 1e-300)

    told = [scene.coordinate_names[d] for d in places]
    hinges = [joint.kind == JointKind.HINGE for joint in joints]
    names = [f"{WEIGHT} {'torque' if h else 'force'} at {name}" for h, name in zip(hinges, told, strict=True)]
    names += [f"inertia felt by {name}" for name in told]
    units = [("N m" if h else "N") for h in hinges] + [("kg m^2" if h else "kg") for h in hinges]
    return names, units, felt
