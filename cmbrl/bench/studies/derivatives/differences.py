"""Derivatives of the whole step against finite differences of the same softened step, column by column.

A column is compared with the 4-point stencil, among a few step sizes, whose 4-point and 2-point values agree best:
large steps miss the curvature of hard contact, small ones drown in round-off. Two kinds of columns are left out and
counted, because differences do not measure a derivative there: those whose stencils all lie across a kink of the model
(:mod:`cmbrl.bench.studies.derivatives.kinks`), and those whose two values agree at no step size (twin contact points at
a kappa near zero have derivatives of about 1/kappa).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmbrl.bench.states import Ranges, random_states
from cmbrl.bench.studies.derivatives.kinks import Array, choices
from cmbrl.contact import Barrier, Exact, Gaussian
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

Point = tuple[Array, Array, Array, Array]  #: q (B, nq), v (B, nv), u (B, nu), theta (np,)
STEPS = (1e-6, 1e-5, 1e-7, 1e-8, 1e-9, 1e-10)  #: m, rad, m/s, controls; parameters in natural units
RESOLVED = 1e-7  #: relative difference of 4-point and 2-point value below which no other step is tried
_FRICTION_LAWS = ("frictionloss", "friction_slope", "stribeck")  # one-sided where nothing rubs
_ONE_SIDED = {
    "restitution": "low",
    "backlash": "low",
    "force_limit": "high",
    "force_limit_slope": "low",
    "tendon_frictionloss": "low",
}  # on this bound
VAGUE = 1e-3  #: the difference above which a column is left out
NEGLIGIBLE = 1e-3  #: columns smaller than this are judged absolutely
SMOOTHINGS: dict[str, Smoothing] = {
    "exact": Exact(),
    "kappa 1e-6": Barrier(1e-6),
    "kappa 1e-4": Barrier(1e-4),
    "kappa 1e-2": Barrier(1e-2),
    "gaussian": Gaussian(length=0.01, floor=1e-6),
}
RANGES = Ranges(gap=(-0.005, 0.005), speed=1.0)


@dataclass(frozen=True)
class Column:
    """One argument of the step: kind ("q", "v", "u" or a parameter's group), place in the Jacobian, shift by x."""

    kind: str
    place: int
    shift: Callable[[float], Point]


def measure(
    scene: Scene,
    smoothing: str,
    states: int,
    seed: int = 0,
    restitution: float = 0.0,
    parameters: int = 60,
    integrator: str | None = None,
) -> dict[str, Any]:
    """Relative errors over random states near contact under one of ``SMOOTHINGS``, and what was left out.

    Args:
        scene: whose step is differentiated.
        smoothing: a name in ``SMOOTHINGS``.
        states: number of states.
        seed: of the states.
        restitution: of all contacts of a rigid scene; at 0 its derivative is one-sided and its columns are left out, as
            are those of friction losses of 0.
        parameters: number of parameter columns at most, spread over all groups.
        integrator: default the model's.
    """
    theta, groups = scene.parameter_vector(), np.array([p.group for p in scene.parameters])
    theta[groups == "restitution"] = restitution
    theta[groups == "softness_time"] *= 1.25  # off MuJoCo's least time constant, where files like to put it
    model = ComplementarityModel(
        scene, smoothing=SMOOTHINGS[smoothing], integrator=integrator, parameters=theta, path_tolerance=1e-12
    )
    result = compare(model, *random_states(scene, states, np.random.default_rng(seed), RANGES), parameters)
    return {"law": scene.contact_law, "smoothing": smoothing, "restitution": restitution, **result}


def compare(model: ComplementarityModel, q: Array, v: Array, u: Array, parameters: int) -> dict[str, Any]:
    """Errors of one model on states q (B, nq), v (B, nv), u (B, nu), and what was left out.

    ``median`` and ``worst`` are over states, with all columns of a state together; ``kinds`` over single columns.
    """
    r = model.predict(q, v, u, jacobian=True, parameter_jacobian=True)
    assert r.jacobian is not None  # it was asked for
    solved = r.status == SolverStatus.CONVERGED
    columns, one_sided = _columns(model, q, v, u, parameters)
    errors: dict[str, list[Array]] = {}
    across = vague = total = 0
    squares = np.zeros((2, len(q)))  # of error and of reference, over all columns
    here = choices(model, q, v, u, model.parameters)
    for column in columns:
        error, size, doubt = _judge(model, r.q_next, r.v_next, r.jacobian[:, :, column.place], column, here)
        smooth, clear = np.isfinite(doubt), doubt <= VAGUE * np.maximum(size, NEGLIGIBLE)
        keep = solved & clear
        across += int((solved & ~smooth).sum())
        vague += int((solved & smooth & ~clear).sum())
        total += int(solved.sum())
        squares += np.where(keep, [error**2, size**2], 0.0)
        errors.setdefault(column.kind, []).append((error / np.maximum(size, NEGLIGIBLE))[keep])
    state = np.sqrt(squares[0] / np.maximum(squares[1], NEGLIGIBLE**2))[solved]
    state = state if len(state) else np.array([np.inf])  # no solve to differentiate
    kinds = {kind: _summary(np.concatenate(values)) for kind, values in errors.items()}
    return {
        "kinds": kinds,
        "median": float(np.median(state)),
        "worst": float(state.max()),
        "worst_column": max(k["worst"] for k in kinds.values()),
        "columns": total,
        "across_kinks": across,
        "vague": vague,
        "one_sided": one_sided,
        "unsolved": int((~solved).sum()),
    }


def _columns(model: ComplementarityModel, q: Array, v: Array, u: Array, parameters: int) -> tuple[list[Column], int]:
    """All columns of state and control, some of every parameter group's, and the number of one-sided parameters."""
    scene, theta, nv = model.scene, model.parameters, model.scene.nv
    shifts: dict[str, Callable[[Array], Point]] = {
        "q": lambda x: (scene.integrate(q, np.tile(x, (len(q), 1))), v, u, theta),
        "v": lambda x: (q, v + x, u, theta),
        "u": lambda x: (q, v, u + x, theta),
        "theta": lambda x: (q, v, u, theta + x),
    }

    def column(kind: str, argument: str, size: int, k: int, first: int) -> Column:
        return Column(kind, first + k, lambda x: shifts[argument](x * np.eye(size)[k]))

    sizes = {"q": (nv, 0), "v": (nv, nv), "u": (scene.inputs, 2 * nv)}
    columns = [column(name, name, size, k, first) for name, (size, first) in sizes.items() for k in range(size)]
    groups: dict[str, list[int]] = {}
    one_sided = 0
    losses = {p.name: x for p, x in zip(scene.parameters, theta, strict=True) if p.group == "frictionloss"}
    for k, p in enumerate(scene.parameters):
        places = groups.setdefault(p.group, [])
        joint = p.name.removeprefix(f"{p.group}.")
        rubs = p.group not in _FRICTION_LAWS or losses[f"frictionloss.{joint}"] > 0.0
        if not rubs or (p.group in _ONE_SIDED and theta[k] == getattr(p, _ONE_SIDED[p.group])):
            one_sided += 1
        else:
            places.append(k)
    share = max(1, parameters // len(groups)) if groups else 0
    for name, places in groups.items():
        chosen = places[:: max(1, -(-len(places) // share))]
        columns += [column(name, "theta", len(theta), k, 2 * nv + scene.inputs) for k in chosen]
    return columns, one_sided


def _judge(
    model: ComplementarityModel, q_next: Array, v_next: Array, ours: Array, column: Column, here: NDArray[np.bool_]
) -> tuple[Array, Array, Array]:
    """Error (B,) and size (B,) of a column (B, 2 nv); doubt (B,) of the reference, infinite where all stencils kink."""
    count = len(ours)
    best, error, size = np.full(count, np.inf), np.zeros(count), np.zeros(count)
    for step in STEPS:
        rows = np.flatnonzero(best > RESOLVED * np.maximum(size, NEGLIGIBLE))
        if not len(rows):
            break
        points = []
        for x in (-2 * step, -step, step, 2 * step):
            q, v, u, theta = column.shift(x)
            points.append((q[rows], v[rows], u[rows], theta))
        smooth = np.all([(choices(model, *points[k]) == here[rows]).all(axis=1) for k in (0, 3)], axis=0)
        values = []
        for point in points:
            r = model.predict(*point)
            values.append(np.concatenate([model.scene.difference(q_next[rows], r.q_next), r.v_next - v_next[rows]], 1))
        two = (values[2] - values[1]) / (2 * step)
        four = (4 * two - (values[3] - values[0]) / (4 * step)) / 3
        noise = 1e-14 * (1 + np.abs(v_next[rows]).max(axis=1)) / step
        doubt = np.where(smooth, np.linalg.norm(four - two, axis=1) + noise, np.inf)
        better = doubt < best[rows]
        rows, four, doubt = rows[better], four[better], doubt[better]
        best[rows] = doubt
        error[rows] = np.linalg.norm(ours[rows] - four, axis=1)
        size[rows] = np.linalg.norm(four, axis=1)
    return error, size, best


def _summary(errors: np.ndarray) -> dict[str, float]:
    if not len(errors):
        return {"median": 0.0, "worst": 0.0, "count": 0}
    return {"median": float(np.median(errors)), "worst": float(errors.max()), "count": len(errors)}
