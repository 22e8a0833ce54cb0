"""How wrong models are on a log: one step and open loop, by stratum, in normalised and in physical units.

Definitions
- A window of horizon k is k consecutive rows of one episode. The model sees the state at its start and the k logged
  controls; its error is that of the predicted state after the last control. Windows overlap but never cross episodes.
- The error of a state has 2 nv coordinates: the tangent vector from the logged to the predicted configuration
  (rotations as rotation vectors in the body frame), and the difference of the velocities.
- Normalised errors divide each coordinate by a standard deviation from the same log: of its change over a row at one
  step, of the coordinate itself (about the intrinsic mean) at longer horizons. They are root mean squares over
  coordinates and windows, without constant coordinates. The median is over windows, of the root mean square
  within a window.
- Physical errors are root mean squares of a body's vector norm for positions and rotations, and per joint for angles.
- A prediction that is not finite counts as diverged and makes the error of its stratum infinite.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch

from cmbrl.accuracy.strata import in_contact, is_moving, smallest_gap, window_strata
from cmbrl.accuracy.table import Entry, ErrorTable, Horizon
from cmbrl.accuracy.view import View
from cmbrl.data.checks import TIME_STEP_TOLERANCE
from cmbrl.data.unlogged import unlogged, with_columns
from cmbrl.errors import UserError
from cmbrl.models.deviations import deviations
from cmbrl.models.protocol import Model, failures, reset_failures, rollout
from cmbrl.models.windows import thinned

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.scene import Scene

CHUNK = 8192  # windows rolled out in one batch
MOST_GAPS = 10_000_000  # looked at for each horizon and model: a few seconds
KINDS = ("position", "angle", "rotation")


def compare(
    models: Mapping[str, Model],
    data: Transitions,
    scene: Scene,
    horizons: Sequence[int] = (1, 5, 20, 100),
    contact_gap: float = 2e-3,
    max_windows: int = 2000,
    progress: Callable[[float, str], None] | None = None,
    logs: Sequence[str] = (),
) -> ErrorTable:
    """Predicts ``data`` with every model (by the name to show) and tabulates the errors defined above.

    Args:
        models, data, scene: models of the scene, or of its file with play, and a log of it.
        horizons: steps; horizons without a window in the log are left out.
        contact_gap: [m] a row is in contact if a candidate is closer than this before or after it.
        max_windows: horizons above 1 use at most this many windows, evenly spread; one step uses every row.
        progress: called with the share of the work done and the current activity.
        logs: names of several logs in ``data``, by its ``recording``: each is a stratum besides.

    Raises:
        UserError: if data, scene and models do not belong together, or nothing changes in the log.
    """
    data = with_columns(data, scene)
    data.check(scene)
    data = data.going_on(scene)
    for name, model in models.items():
        if abs(model.dt - data.dt) > TIME_STEP_TOLERANCE * data.dt:
            raise UserError(f"{name}: steps {model.dt:g} s, the log {data.dt:g} s; use the log's control step")
    if min(horizons, default=0) < 1:
        raise UserError(f"horizons {list(horizons)}; give whole numbers of at least 1")
    change_scale, state_scale = deviations(data, scene)
    if np.isnan(change_scale).all():
        raise UserError("nothing changes in this log; give a log of a moving system")
    kinds = np.array(scene.coordinate_kinds, dtype=object)
    kinds[[joint.vadr for joint in unlogged(data, scene)]] = None
    contact, moving = in_contact(data, scene, contact_gap), is_moving(data, scene)
    views = {name: View.of(model, data, scene) for name, model in models.items()}
    starts = {k: thinned(data.windows(k), len(data) if k == 1 else max_windows) for k in sorted(set(horizons))}
    starts = {k: rows for k, rows in starts.items() if len(rows)}
    total = max(1, sum(k * len(rows) for k, rows in starts.items()) * len(models))

    entries, about, curves, done = [], [], {}, 0
    for k, rows in starts.items():
        strata = window_strata(rows, k, contact, moving)
        for number, log in enumerate(logs if len(logs) > 1 else ()):
            if (mask := data.recording[rows] == number).any():
                strata[f"log {log}"] = mask
        logged = np.stack([data.q_next[rows + j] for j in range(k)], axis=1)
        depth = _depth(scene, logged)
        counts = {name: int(mask.sum()) for name, mask in strata.items()}
        about.append(Horizon(k, counts, 1e3 * float(depth.max()), 1e3 * float(depth.mean())))
        scale = change_scale if k == 1 else state_scale
        for name, model in models.items():
            if progress is not None:
                progress(done / total, f"{name}, {k} steps")
            reset_failures(model)
            began = time.process_time()
            q, v = _predict(model, views[name].data, rows, k)
            seconds = time.process_time() - began
            error = views[name].error(rows, q, v)  # (W, k, 2 nv)
            depth = _depth(views[name].scene, q)
            for stratum, mask in strata.items():
                whole = stratum == "all"
                entries.append(
                    Entry(
                        model=name,
                        horizon=k,
                        stratum=stratum,
                        **_summary(error[mask, -1], depth[mask], scale, kinds, scene.planar),
                        failures=failures(model) if whole else None,
                        step_microseconds=1e6 * seconds / (k * len(rows)) if whole else None,
                    )
                )
            if k == max(starts):
                curves[name] = [_pooled(error[:, j], state_scale) for j in range(k)]
            done += k * len(rows)
    return ErrorTable(entries=entries, horizons=about, curves=curves, contact_gap=contact_gap, dt=data.dt)


def _predict(model: Model, data: Transitions, starts: np.ndarray, horizon: int) -> tuple[np.ndarray, np.ndarray]:
    """States (W, horizon, nq), (W, horizon, nv) predicted open loop from each start."""
    parts = []
    with torch.no_grad():
        for some in np.array_split(starts, -(-len(starts) // CHUNK)):
            rows = some[:, None] + np.arange(horizon)
            given = (data.q[some], data.v[some], data.u[rows], data.q[rows])
            q, v = rollout(model, *(torch.as_tensor(a) for a in given))
            parts.append((q.numpy(), v.numpy()))
    return np.concatenate([q for q, _ in parts]), np.concatenate([v for _, v in parts])


def _depth(scene: Scene, q: np.ndarray) -> np.ndarray:
    """Deepest penetration [m] (W, s) at states of windows (W, k, nq): zero without contact, NaN where q is not finite.

    Where a robot could touch in very many places, of some steps of each window, the last among them.
    """
    steps = q.shape[1]
    several = int(np.clip(MOST_GAPS // max(1, len(q) * scene.core.ncontact), 1, steps))
    q = q[:, np.unique(np.linspace(steps - 1, 0, several).round().astype(int))]
    flat = q.reshape(-1, q.shape[-1])
    finite = np.isfinite(flat).all(axis=1)
    depth = np.full(len(flat), np.nan)
    if finite.any():
        depth[finite] = np.maximum(0.0, -smallest_gap(scene, flat[finite]))
    return depth.reshape(q.shape[:2])


def _pooled(error: np.ndarray, scale: np.ndarray) -> float:
    """Root mean square of error (W, 2 nv) / scale; inf if a prediction diverged."""
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.square(error[:, np.isfinite(scale)] / scale[np.isfinite(scale)])
        value = float(np.sqrt(squares.mean()))
    return value if np.isfinite(value) else float("inf")


def _summary(error: np.ndarray, depth: np.ndarray, scale: np.ndarray, kinds: np.ndarray, planar: bool) -> dict:
    """Fields of an entry, from the final errors (W, 2 nv) and the depths (W, k) of the windows of one stratum.

    kinds: (nv,) of the coordinates, None where the log tells nothing.
    """
    finite = np.isfinite(error).all(axis=1)
    used = np.isfinite(scale)
    with np.errstate(over="ignore", invalid="ignore"):
        within = np.sqrt(np.square(error[:, used] / scale[used]).mean(axis=1))
    reached = depth[np.isfinite(depth)]
    return {
        "windows": len(error),
        "error": _pooled(error, scale),
        "median": float(np.median(np.where(np.isfinite(within), within, np.inf))),
        "physical": _physical(error, kinds, planar),
        "penetration_max_mm": 1e3 * float(reached.max()) if len(reached) else float("nan"),
        "penetration_mean_mm": 1e3 * float(reached.mean()) if len(reached) else float("nan"),
        "diverged": int((~finite).sum()),
    }


def _physical(error: np.ndarray, kinds: np.ndarray, planar: bool) -> dict[str, float]:
    """RMSE [m, rad, m/s, rad/s] of each kind of coordinate, and of its velocity."""
    found = {}
    for half, suffix in enumerate(("", "_velocity")):
        for kind in KINDS:
            columns = error[:, half * len(kinds) : (half + 1) * len(kinds)][:, kinds == kind]
            count = columns.shape[1]
            if count == 0:
                continue
            vector = {"position": min(count, 2 if planar else 3), "angle": 1, "rotation": 3}[kind]
            with np.errstate(over="ignore", invalid="ignore"):
                value = float(np.sqrt(vector * np.square(columns).mean()))
            found[kind + suffix] = value if np.isfinite(value) else float("inf")
    return found
