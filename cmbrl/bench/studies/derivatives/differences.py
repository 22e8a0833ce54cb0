"""Derivatives of the whole step against finite differences of the same softened step, column by column.

A column is judged on the 4-point stencil whose 4-point and 2-point values agree best among a few step sizes: large
steps miss the curvature of hard contact, small ones drown in round-off. Stencils across a kink of the model (a gap or
a limit margin changes sign, the nearer limit changes, a control, force or time constant reaches its range, a row enters
or leaves the solve, restitution sets in) do not measure a derivative: they are left out and counted; so are columns
whose two values agree at no step size (twin contact points at a kappa near zero have derivatives like 1/kappa).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmbrl.bench.states import Ranges, random_states
from cmbrl.contact import Adaptive, Barrier, Exact
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

Array = NDArray[np.float64]
Point = tuple[Array, Array, Array, Array]  #: q (B, nq), v (B, nv), u (B, nu), theta (np,)
STEPS = (1e-6, 1e-5, 1e-7, 1e-8, 1e-9, 1e-10)  #: m, rad, m/s, controls; parameters in natural units
RESOLVED = 1e-6  #: relative difference of 4-point and 2-point value below which no other step is tried
VAGUE = 1e-3  #: the same, above which finite differences cannot tell: the column is left out and counted
NEGLIGIBLE = 1e-3  #: columns smaller than this are judged absolutely
SMOOTHINGS: dict[str, Smoothing] = {
    "exact": Exact(),
    "kappa 1e-6": Barrier(1e-6),
    "kappa 1e-4": Barrier(1e-4),
    "kappa 1e-2": Barrier(1e-2),
    "adaptive": Adaptive(length=0.01, floor=1e-7),
}
RANGES = Ranges(gap=(-0.005, 0.005), speed=1.0)


@dataclass(frozen=True)
class Column:
    """One argument of the step: kind ("q", "v", "u" or a parameter's group), place in the Jacobian, shift by x."""

    kind: str
    place: int
    shift: Callable[[float], Point]


def run(
    scenes: Mapping[str, Scene],
    states: int = 1000,
    seed: int = 0,
    smoothings: Mapping[str, Smoothing] | None = None,
    restitution: float = 0.0,
    parameters: int = 60,
    integrator: str | None = None,
    threads: int = 2,
    progress: Callable[[int], object] | None = None,
) -> dict[str, Any]:
    """Relative errors by scene and smoothing over random states near contact.

    ``restitution``: given to all contacts of rigid scenes; at 0 its derivative is one-sided and its columns are left
    out. ``parameters``: at most that many columns, spread over all kinds; a 29-joint robot has hundreds.
    ``integrator``: default the model's.
    ``progress(1)`` is called after every scene and smoothing.
    """
    rows = []
    for name, scene in scenes.items():
        for label, smoothing in (smoothings or SMOOTHINGS).items():
            theta = scene.parameter_vector()
            bounces = np.array([p.group == "restitution" for p in scene.parameters], dtype=bool)
            theta[bounces] = restitution
            times = np.array([p.group == "softness_time" for p in scene.parameters], dtype=bool)
            theta[times] *= 1.25  # off MuJoCo's least time constant, where files like to put it
            model = ComplementarityModel(
                scene,
                smoothing=smoothing,
                integrator=integrator,
                parameters=theta,
                path_tolerance=1e-12,
                threads=threads,
            )
            result = compare(model, *random_states(scene, states, np.random.default_rng(seed), RANGES), parameters)
            setting = {"scene": name, "law": scene.contact_law, "smoothing": label, "restitution": restitution}
            rows.append({**setting, **result})
            if progress:
                progress(1)
    return {"states": states, "seed": seed, "rows": rows}


def compare(model: ComplementarityModel, q: Array, v: Array, u: Array, parameters: int) -> dict[str, Any]:
    """Errors of one model on states q (B, nq), v (B, nv), u (B, nu), and what was left out.

    ``median`` and ``worst`` are over states, all comparable columns of one together; ``kinds`` over single columns.
    """
    r = model.predict(q, v, u, jacobian=True, parameter_jacobian=True)
    assert r.jacobian is not None  # it was asked for
    solved = r.status == SolverStatus.CONVERGED
    columns, one_sided = _columns(model, q, v, u, parameters)
    errors: dict[str, list[Array]] = {}
    across = vague = total = 0
    squares = np.zeros((2, len(q)))  # of error and of reference, over all columns
    here = signature(model, q, v, u, model.parameters)
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


def signature(model: ComplementarityModel, q: Array, v: Array, u: Array, theta: Array) -> NDArray[np.bool_]:
    """Discrete choices of one step, (B, n) bool: two points of a stencil that differ in one lie across a kink."""
    scene, core, h = model.scene, model.scene.core, model.time_step
    if model.integrator != "semi-implicit":
        q = scene.integrate(q, 0.5 * h * v)
    smooth = model.smooth_dynamics(q, v, theta)
    gap, normal = smooth["gap"], smooth["J"][:, :, 0]
    speed = np.einsum("bcv,bv->bc", normal, v)
    x = q[:, core.lim_qadr]
    below, above = x - core.lim_lo, core.lim_hi - x
    near, side = np.minimum(below, above), np.where(below < above, 1.0, -1.0)
    parts = [
        gap > 0,
        gap > core.con_margin,
        gap / h + speed < model.prune,
        below < above,
        near > core.lim_margin,
        near / h + side * v[:, core.lim_dof] < model.prune,
        *_clamps(model, q, v, u, theta),
    ]
    if any(p.group == "restitution" for p in scene.parameters):
        free = model.with_settings(prune=-1e300, parameters=None, integrator="semi-implicit", substeps=1)
        approach = -np.einsum("bcv,bv->bc", normal, free.predict(q, v, u, theta).v_next)
        parts += [approach > 3 * 9.81 * h, gap < approach * h]
    return np.concatenate(parts, axis=1)


def _clamps(model: ComplementarityModel, q: Array, v: Array, u: Array, theta: Array) -> list[NDArray[np.bool_]]:
    scene, core = model.scene, model.scene.core
    P, layout = scene.physical_vector(theta), scene.layout
    time = P[[layout.contact(k, "solref0") for k in range(core.ncontact)]]
    block = P[layout.actuator(0) : layout.gravity].reshape(-1, 5)
    gear, gain, bias0, bias1, bias2 = block.T
    low, high = np.reshape(core.act_ctrl, (-1, 2)).T
    least, most = np.reshape(core.act_force, (-1, 2)).T
    length, rate = gear * q[:, core.act_qadr], gear * v[:, core.act_dof]
    force = gain * np.clip(u, low, high) + bias0 + bias1 * length + bias2 * rate
    shortest = np.tile(time > 2 * model.time_step, (len(q), 1))  # MuJoCo's least time constant
    return [u < low, u > high, force < least, force > most, shortest]


def _columns(model: ComplementarityModel, q: Array, v: Array, u: Array, parameters: int) -> tuple[list[Column], int]:
    """All columns of state and control, a spread of the parameters', and how many of these are one-sided."""
    scene, theta, nv = model.scene, model.parameters, model.scene.nv

    def in_q(unit: Array) -> Callable[[float], Point]:
        return lambda x: (scene.integrate(q, np.tile(x * unit, (len(q), 1))), v, u, theta)

    def in_v(unit: Array) -> Callable[[float], Point]:
        return lambda x: (q, v + x * unit, u, theta)

    def in_u(unit: Array) -> Callable[[float], Point]:
        return lambda x: (q, v, u + x * unit, theta)

    def in_theta(unit: Array) -> Callable[[float], Point]:
        return lambda x: (q, v, u, theta + x * unit)

    columns = [Column("q", k, in_q(unit)) for k, unit in enumerate(np.eye(nv))]
    columns += [Column("v", nv + k, in_v(unit)) for k, unit in enumerate(np.eye(nv))]
    columns += [Column("u", 2 * nv + k, in_u(unit)) for k, unit in enumerate(np.eye(scene.nu))]
    groups: dict[str, list[int]] = {}
    for k, p in enumerate(scene.parameters):
        groups.setdefault(p.group, []).append(k)
    one_sided = [k for k in groups.get("restitution", []) if theta[k] == 0.0]
    groups = {name: [k for k in places if k not in one_sided] for name, places in groups.items()}
    share = max(1, parameters // len(groups)) if groups else 0
    for name, places in groups.items():
        for k in places[:: max(1, -(-len(places) // share))]:
            columns.append(Column(name, 2 * nv + scene.nu + k, in_theta(np.eye(len(theta))[k])))
    return columns, len(one_sided)


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
        points = [_take(column.shift(x), rows) for x in (-2 * step, -step, step, 2 * step)]
        ends = [signature(model, *points[k]) == here[rows] for k in (0, 3)]
        smooth = ends[0].all(axis=1) & ends[1].all(axis=1)
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


def _take(point: Point, rows: NDArray[np.int64]) -> Point:
    q, v, u, theta = point
    return q[rows], v[rows], u[rows], theta


def _summary(errors: np.ndarray) -> dict[str, float]:
    if not len(errors):
        return {"median": 0.0, "worst": 0.0, "count": 0}
    return {"median": float(np.median(errors)), "worst": float(errors.max()), "count": len(errors)}
