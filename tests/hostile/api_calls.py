"""Hostile calls of the Python API: one argument of a sound call is of the wrong type, shape or size."""

from __future__ import annotations

import contextlib
import datetime
import decimal
import fractions
import random
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from . import judge


class Raises:
    """Whatever asks it for something gets an error of its own kind."""

    def __array__(self, *arguments: object, **options: object) -> np.ndarray:
        raise RuntimeError("no array")

    def __float__(self) -> float:
        raise OSError("no number")

    def __repr__(self) -> str:
        raise KeyError("no text")


def deep(levels: int) -> list[Any]:
    """A list in a list in a list."""
    found: list[Any] = []
    for _ in range(levels):
        found = [found]
    return found


WRONG: dict[str, Callable[[], Any]] = {
    "None": lambda: None, "True": lambda: True, "-1": lambda: -1, "0": lambda: 0, "1.9": lambda: 1.9,
    "nan": lambda: float("nan"),
    "inf": lambda: float("inf"), "-inf": lambda: -float("inf"), "1e300": lambda: 1e300, "5e-324": lambda: 5e-324,
    "2**31": lambda: 2**31, "2**63": lambda: 2**63,
    "10**400": lambda: 10**400, "10**6000": lambda: 10**6000, "text": lambda: "text", "digits": lambda: "0.5",
    "empty text": lambda: "", "bytes": lambda: b"1", "null": lambda: "a\0b",
    "long": lambda: "x" * 5000, "complex": lambda: 1 + 2j, "complex numpy": lambda: np.complex128(1 + 2j),
    "list": lambda: [], "dict": dict, "set": lambda: {1, 2}, "object": object,
    "function": lambda: len, "range": lambda: range(3), "generator": lambda: (x for x in "ab"),
    "date": lambda: datetime.date(2020, 1, 1),
    "decimal": lambda: decimal.Decimal("0.5"), "fraction": lambda: fractions.Fraction(1, 2),
    "datetime64": lambda: np.datetime64("2020-01-01"), "deep": lambda: deep(1000),
    "deeper": lambda: deep(50), "ragged": lambda: [[1.0], [1.0, 2.0]], "none list": lambda: [None], "raises": Raises,
    "bool array": lambda: np.ones((3, 6), bool), "0-d": lambda: np.zeros(()),
    "empty": lambda: np.zeros((0, 6)), "1-d": lambda: np.zeros(6), "3-d": lambda: np.zeros((2, 3, 6)),
    "huge view": lambda: np.broadcast_to(0.0, (10**12, 6)), "nan tensor": lambda: torch.full((3, 6), torch.nan,
    dtype=torch.float64),
    "float32": lambda: torch.zeros(3, 6), "meta": lambda: torch.zeros(3, 6, device="meta"),
    "sparse": lambda: torch.zeros(3, 6, dtype=torch.float64).to_sparse(), "gradient": lambda: torch.zeros(3, 6,
    dtype=torch.float64, requires_grad=True),
    "conjugate": lambda: torch.zeros(3, 6, dtype=torch.complex128).conj(), "int tensor": lambda: torch.zeros(3, 6,
    dtype=torch.int64), "scalar tensor": lambda: torch.tensor(1.0),
    "masked": lambda: np.ma.masked_array(np.zeros((3, 6)), mask=np.eye(3, 6)), "structured": lambda: np.zeros((3, 6),
    [("a", float)]), "path": lambda: Path("nowhere.xml"),
}  # fmt: skip
CHANGES: dict[str, Callable[[np.ndarray], Any]] = {
    "strings": lambda x: x.astype("U"), "bytes": lambda x: x.astype("S"), "times": lambda x: x.astype("M8[s]"),
    "durations": lambda x: x.astype("m8[s]"),
    "complex numbers": lambda x: x.astype(complex), "objects": lambda x: x.astype(object),
    "whole numbers": lambda x: x.astype(int), "halves": lambda x: x.astype("f2"),
    "longdouble": lambda x: x.astype("g"), "big-endian": lambda x: x.astype(">f8"), "records": lambda x: x.view([("a",
    "f8")]), "wider": lambda x: np.concatenate([x, x], axis=-1),
    "taller": lambda x: np.concatenate([x, x]), "narrower": lambda x: x[..., :-1], "fewer": lambda x: x[:-1],
    "flat": lambda x: x.ravel(), "backwards": lambda x: x[::-1], "fortran": lambda x: np.asfortranarray(x),
    "transposed": lambda x: x.T, "nan": lambda x: x * np.nan, "inf": lambda x: x + np.inf, "1e300": lambda x: x + 1e300,
    "1e150": lambda x: x + 1e150, "1e20": lambda x: x + 1e20, "1e9": lambda x: x + 1e9,
    "tiny": lambda x: x * 0 + 5e-324,
    "list": lambda x: x.tolist(), "tuple": lambda x: tuple(map(tuple, np.atleast_2d(x))),
    "readonly": lambda x: np.broadcast_to(x, x.shape), "tensor": lambda x: torch.from_numpy(x.copy()),
    "matrix": lambda x: np.asmatrix(x),
}  # fmt: skip


@cache
def sound() -> dict[str, tuple[Callable[..., Any], dict[str, Any]]]:
    """Calls by name: what is called, and the arguments with which it works."""
    from cmbrl import ComplementarityModel, Scene, Transitions
    from cmbrl.contact.smoothing import ABS, Barrier, Exact, Gaussian, Relaxed
    from cmbrl.data import read_trajectories
    from cmbrl.gradients.kinds import derivative_model
    from cmbrl.registry import load_task

    task = load_task("hopper")
    log, scene = task.record(60, seed=0), task.load_scene()
    model = ComplementarityModel(scene, **task.model_options())
    q, v, u, theta = log.q[:3], log.v[:3], log.u[:3], model.parameters
    states = {"q": q, "v": v, "u": u}
    tensors = {name: torch.from_numpy(x.copy()) for name, x in states.items()}
    rows = {name: getattr(log, name) for name in ("q", "v", "u", "q_next", "v_next", "dt", "episode")}

    def smoothed(policy: Callable[..., Any]) -> Callable[..., Any]:
        return lambda **options: model.with_settings(smoothing=policy(**options)).predict(q, v, u)

    settings = {
        "substeps": 2, "time_step": 0.002, "smoothing": None, "backward_smoothing": None, "integrator": "midpoint",
        "parameters": theta,
        "threads": 1, "implicit_springs": False, "prune": 3.0, "path_tolerance": 1e-6, "candidates": theta[None],
    }  # fmt: skip
    return {
        "Transitions": (Transitions, {**rows, "joint_names": log.joint_names, "source": log.source}),
        "read_trajectories": (read_trajectories, {"q": log.q, "lengths": np.array([20, 40]), "dt": log.dt, "v": log.v,
        "u": log.u}),
        "select": (log.select, {"rows": slice(3)}),
        "split": (log.split, {"fraction": 0.5, "seed": 0}),
        "windows": (log.windows, {"k": 3}),
        "joined": (Transitions.joined, {"logs": [log, log]}),
        "check": (log.check, {"scene": scene, "dt": log.dt}),
        "load": (Transitions.load, {"path": "nowhere.npz"}),
        "from_mjcf": (
            Scene.from_mjcf, {"source": task.scene_path, "ignore": (), "contact_law": "rigid", "reduce": True},
        ),
        "model": (lambda **options: ComplementarityModel(scene, **options).predict(q, v, u), settings),
        "with_settings": (lambda **options: model.with_settings(**options).predict(q, v, u), settings),
        "with_parameters": (model.with_parameters, {"theta": theta}),
        "predict": (model.predict, {**states, "theta": theta, "jacobian": True, "parameter_jacobian": True,
        "impulse": True}),
        "step": (model.step, {**tensors, "theta": torch.from_numpy(theta.copy())}),
        "smooth_dynamics": (model.smooth_dynamics, {"q": q, "v": v, "theta": theta}),
        "contact_problems": (model.contact_problems, {**states, "theta": theta}),
        "difference": (scene.difference, {"q_from": q, "q_to": q}),
        "integrate": (scene.integrate, {"q": q, "dv": v}),
        "gaps": (scene.gaps, {"q": q}),
        "body_poses": (scene.body_poses, {"q": q}),
        "exact": (smoothed(Exact), {"speed": 1e-9}),
        "relaxed": (smoothed(Relaxed), {"speed": 3e-4}),
        "abs": (smoothed(ABS), {"peak": 0.1, "reach": 1e-3, "floor": 1e-8}),
        "barrier": (smoothed(Barrier), {"kappa": 1e-4, "length": None}),
        "gaussian": (smoothed(Gaussian), {"length": 1e-3, "floor": 1e-8, "derivative": "exact"}),
        "derivative": (lambda **options: derivative_model(model, **options), {"kind": "bundle", "seed": 0, "samples": 4,
        "position": 1e-3}),
        "branches": (lambda **options: derivative_model(model, "bcg", **options), {"seed": 0, "branches": 4}),
        "record": (task.record, {"n_steps": 5, "seed": 0, "behaviour": "random"}),
    }  # fmt: skip


def draw(rng: random.Random, folder: Path) -> judge.Case:
    """A sound call with one argument replaced, or one array changed."""
    name = rng.choice(list(sound()))
    call, arguments = sound()[name]
    argument = rng.choice(list(arguments))
    value = arguments[argument]
    if isinstance(value, np.ndarray | torch.Tensor) and rng.random() < 0.6:
        change = rng.choice(list(CHANGES))
        what, make = change, lambda: _changed(value, change)
    else:
        what = rng.choice(list(WRONG))
        make = WRONG[what]
    return f"{name}({argument}={what})", lambda: _use(call, arguments | {argument: make()})


def _changed(value: np.ndarray | torch.Tensor, change: str) -> Any:
    if isinstance(value, np.ndarray):
        return CHANGES[change](value)
    found = CHANGES[change](value.numpy())
    with contextlib.suppress(TypeError, ValueError):
        return torch.from_numpy(np.ascontiguousarray(found))
    return found


def _use(call: Callable[..., Any], arguments: dict[str, Any]) -> str:
    """The call, and the next state finite or marked as failed."""
    from cmbrl.models.native_step.result import StepResult
    from cmbrl.native import SolverStatus

    found = call(**arguments)
    if isinstance(found, StepResult):
        fine = np.isfinite(found.q_next).all(axis=1) & np.isfinite(found.v_next).all(axis=1)
        judge.require(
            bool((fine | (found.status == SolverStatus.FAILED)).all()), "a step is not finite, and says nothing"
        )
    return judge.RIGHT
