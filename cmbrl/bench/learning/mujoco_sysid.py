"""``mujoco.sysid`` on our logs: MuJoCo's own system identification, given the same rows and the same wrong start.

The toolbox minimises squared residuals over windows by Gauss-Newton with finite differences of MuJoCo itself. A window
here is ``WINDOW`` control steps from a logged state; residuals are in standard deviations of the change over a step,
as in our fit. It is told which groups of parameters are wrong and fits those alone, in its favour: over all that it
shares with us (54 on the half-cheetah) it takes 75 s for 1,000 rows and has not converged after 20 iterations. Where
the real system is simulated by MuJoCo with the same integrator, the toolbox holds the very model that made the log,
which no other method does; with another integrator it has to make up for a difference of models, as ours has.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from typing import Any

import mujoco
import numpy as np
from absl import logging

from cmbrl.bench.learning.logs import WRONG_GROUPS
from cmbrl.bench.learning.mujoco_model import MujocoModel, compiled, full_states, with_parameters
from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError
from cmbrl.registry import Task
from cmbrl.scene import Scene

WINDOW = 5  # control steps
MAX_ITERATIONS = 20
DIFFERENCE = 1e-6  # step of the differences: the toolbox's default of 1.5e-8 is below the noise of a contact solve
MAX_ROWS = 1_000  # rows given to the toolbox, which rolls out every window once a parameter and iteration


def sysid_model(
    task: Task, scene: Scene, data: Transitions, start: np.ndarray, integrator: str | None = None
) -> tuple[MujocoModel, dict[str, Any]]:
    """A MuJoCo model fitted to ``data`` from the parameters ``start`` (np,) of ``scene``, and what the fit did.

    integrator: of the model; None is the file's, which is that of the real system.
    Raises UserError when the toolbox's own dependencies are missing, or no episode has ``WINDOW`` rows.
    """
    from mujoco import sysid

    if not hasattr(sysid, "optimize"):  # the toolbox imports as an empty module when a dependency of it is missing
        raise UserError("mujoco.sysid is not complete: pip install 'mujoco[sysid]'")
    base = compiled(task.scene_path, integrator)
    substeps = round(data.dt / base.opt.timestep)
    parameters = sysid.ParameterDict()
    for k, p in enumerate(scene.parameters):
        if p.group in WRONG_GROUPS:
            parameters.add(sysid.Parameter(p.name, float(start[k]), p.low, p.high))
    names = list(parameters.keys())
    models: dict[bytes, Any] = {}  # the toolbox asks for the same model once a window

    def build(values: Any, spec: Any) -> Any:
        vector = values.as_vector()
        if vector.tobytes() not in models:
            if len(models) > 2 * len(names):
                models.clear()
            models[vector.tobytes()] = with_parameters(base, dict(zip(names, vector, strict=True)))
        return models[vector.tobytes()]

    change = np.hstack([data.q_next - data.q, data.v_next - data.v]).std(axis=0)

    def residual(values: Any, predicted: Any, measured: Any, model: Any, everything: bool, state: Any) -> Any:
        ends = state[substeps - 1 :: substeps, 1:]
        return (ends - measured.data[1:]) / change, measured, measured

    with _quiet():
        sequences = _windows(sysid, task, base, data, substeps)
        function = sysid.build_residual_fn(
            models_sequences=sequences, build_model=build, modify_residual=residual, n_threads=1, resample_true=False
        )
        fitted, _ = sysid.optimize(
            parameters, function, "mujoco", verbose=False, max_iters=MAX_ITERATIONS, eps=DIFFERENCE
        )
    model = with_parameters(base, dict(zip(names, fitted.as_vector(), strict=True)))
    return MujocoModel(model, substeps), {"parameters": len(names), "rows": WINDOW * len(sequences[0].measured_rollout)}


@contextmanager
def _quiet() -> Iterator[None]:
    """Without the toolbox's line an iteration, and its warning a window that the log holds states and no sensors."""
    verbosity = logging.get_verbosity()
    logging.set_verbosity(logging.ERROR)
    try:
        with redirect_stdout(StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.set_verbosity(verbosity)


def _windows(sysid: Any, task: Task, base: Any, data: Transitions, substeps: int) -> list[Any]:
    """The log as the toolbox wants it: one sequence a window, controls once a physics step."""
    starts: list[int] = []
    for row in data.windows(WINDOW):
        if not starts or row >= starts[-1] + WINDOW:
            starts.append(int(row))
    if len(starts) * WINDOW > MAX_ROWS:
        even = np.linspace(0, len(starts) - 1, MAX_ROWS // WINDOW).astype(int)
        starts = [starts[k] for k in even]
    if not starts:
        raise UserError(f"no episode has {WINDOW} rows: mujoco.sysid has nothing to fit")
    steps = np.arange(WINDOW * substeps + 1) * base.opt.timestep
    ends = np.arange(WINDOW + 1) * data.dt
    states = full_states(base, data.q[starts], data.v[starts])
    controls, measured = [], []
    for row in starts:
        rows = slice(row, row + WINDOW)
        held = np.repeat(data.u[rows], substeps, axis=0)
        controls.append(sysid.TimeSeries(steps, np.vstack([held, held[-1:]])))  # it drops the last one
        path = np.hstack([data.q_next[rows], data.v_next[rows]])
        measured.append(sysid.TimeSeries(ends, np.vstack([np.r_[data.q[row], data.v[row]], path])))
    spec = mujoco.MjSpec.from_file(task.scene_path)
    names = [f"row {row}" for row in starts]
    return [sysid.ModelSequences(task.name, spec, names, list(states), controls, measured, allow_missing_sensors=True)]
