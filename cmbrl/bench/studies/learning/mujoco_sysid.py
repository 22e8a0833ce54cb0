"""``mujoco.sysid`` on our logs: MuJoCo's own system identification, given the same rows and the same wrong start.

The toolbox's parameters and its optimiser (Gauss-Newton with finite differences of MuJoCo itself), on the error after
one control step from every logged state, in standard deviations of the change as in our fit. The residual is one
batched rollout: the toolbox's own, window by window in Python, took 65 s where this takes 5 (half-cheetah, 200 rows),
and over windows of 5 steps it ended at more than twice the error. It is told which groups of parameters are wrong and
fits those alone, in its favour.

Where the real system is simulated by MuJoCo with the same integrator, the toolbox holds the very model that made the
log, which no other method does; with another integrator it has to make up for a difference of models, as ours has.
"""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO
from typing import Any

import numpy as np
import torch

from cmbrl.bench.studies.learning.logs import WRONG_GROUPS
from cmbrl.bench.studies.learning.mujoco_model import MujocoModel, compiled, with_parameters
from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError
from cmbrl.registry import Task
from cmbrl.scene import Scene

MAX_ITERATIONS = 20
DIFFERENCE = 1e-6  # step of the differences: the toolbox's default of 1.5e-8 is below the noise of a contact solve


def sysid_model(
    task: Task, scene: Scene, data: Transitions, start: np.ndarray, integrator: str | None = None
) -> tuple[MujocoModel, dict[str, Any]]:
    """A MuJoCo model fitted to ``data`` from the parameters ``start`` (np,) of ``scene``, and what the fit did.

    integrator: of the model; None is the file's, which is that of the real system.
    Raises UserError when the toolbox's own dependencies are missing.
    """
    from mujoco import sysid

    if not hasattr(sysid, "optimize"):  # the toolbox imports as an empty module when a dependency of it is missing
        raise UserError("mujoco.sysid is not complete: pip install 'cmbrl[bench]' (or 'mujoco[sysid]')")
    base = compiled(task.scene_path, integrator)
    substeps = round(data.dt / base.opt.timestep)
    parameters = sysid.ParameterDict()
    for value, p in zip(start, scene.parameters, strict=True):
        if p.group in WRONG_GROUPS:
            parameters.add(sysid.Parameter(p.name, float(value), p.low, p.high))
    names = list(parameters.keys())

    def model(values: np.ndarray) -> MujocoModel:
        return MujocoModel(with_parameters(base, dict(zip(names, values, strict=True))), substeps)

    states = [torch.as_tensor(x) for x in (data.q, data.v, data.u)]
    change = np.hstack([scene.difference(data.q, data.q_next), data.v_next - data.v]).std(axis=0)

    def residual(columns: np.ndarray, _: Any) -> tuple[list[np.ndarray], None, None]:
        """Residuals (n,) of one vector of parameters, or (n, k) of k columns of them."""
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
