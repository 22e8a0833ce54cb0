"""``mujoco.sysid``, MuJoCo's own system identification, on one of our logs.

It uses the toolbox's parameters and its optimiser (Gauss-Newton with finite differences through MuJoCo). The residual
is the error after one control step from every logged state, in standard deviations of the change, as in our fit. It is
one batched rollout: the toolbox's own residual, window by window in Python, took 65 s where this takes 5 (half-cheetah,
200 rows), and over windows of 5 steps it ended at more than twice the error.
"""

from __future__ import annotations

from collections.abc import Collection
from contextlib import redirect_stdout
from io import StringIO
from typing import Any

import numpy as np
import torch

from cmbrl.bench.peers.mujoco_model import MujocoModel, robot_model, with_parameters
from cmbrl.data.transitions import Transitions
from cmbrl.scene import Scene

MAX_ITERATIONS = 20
DIFFERENCE = 1e-6  # step of the differences; the toolbox's default of 1.5e-8 is below the noise of a contact solve


def installed() -> bool:
    """Whether the toolbox is complete; without its dependencies it imports as an empty module."""
    try:
        from mujoco import sysid
    except ImportError:
        return False
    return hasattr(sysid, "optimize")


def identified(
    scene: Scene, data: Transitions, start: np.ndarray, groups: Collection[str], integrator: str | None = None
) -> tuple[MujocoModel, dict[str, Any]]:
    """A MuJoCo model fitted to ``data``, and what the fit did.

    Args:
        scene: the robot; MuJoCo compiles its MJCF.
        data: the log.
        start: parameters (np,) of ``scene`` from which the fit starts.
        groups: parameter groups that are fitted; other parameters keep the values of the MJCF.
        integrator: of the model, default the MJCF's.
    """
    from mujoco import sysid

    base = robot_model(scene.path, integrator)
    substeps = round(data.dt / base.opt.timestep)
    parameters = sysid.ParameterDict()
    for value, p in zip(start, scene.parameters, strict=True):
        if p.group in groups:
            parameters.add(sysid.Parameter(p.name, float(value), p.low, p.high))
    names = list(parameters.keys())

    def model(values: np.ndarray) -> MujocoModel:
        return MujocoModel(with_parameters(base, dict(zip(names, values, strict=True))), substeps)

    states = [torch.as_tensor(x) for x in (data.q, data.v, data.u)]
    change = np.hstack([scene.difference(data.q, data.q_next), data.v_next - data.v]).std(axis=0)

    def residual(columns: np.ndarray, _: Any) -> tuple[list[np.ndarray], None, None]:
        """Residuals (n,) of one vector of parameters (p,), or (n, k) of k vectors (p, k)."""
        found = []
        for values in columns.reshape(len(names), -1).T:
            q, v = (x.numpy() for x in model(values).step(*states))
            error = np.hstack([scene.difference(data.q_next, q), v - data.v_next]) / change
            found.append(error.ravel() / np.sqrt(error.size))
        return [np.stack(found, axis=1) if columns.ndim > 1 else found[0]], None, None

    with redirect_stdout(StringIO()) as log:  # a line an iteration
        fitted, _ = sysid.optimize(
            parameters, residual, "mujoco", verbose=False, max_iters=MAX_ITERATIONS, eps=DIFFERENCE
        )
    stopped = next((line for line in log.getvalue().splitlines() if line.startswith("Terminated")), "")
    return model(fitted.as_vector()), {"parameters": len(names), "stopped": stopped}
