"""How far models drift from a log that they simulate from its start under its commands, without looking at it again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from cmbrl.errors import UserError
from cmbrl.models.protocol import Model, rollout, seen
from cmbrl.table import Cell, Table

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.scene import Scene


@dataclass(frozen=True)
class OpenLoop:
    """Positions (T, nv) less those of the log, by model, at ``time`` (T,) [s]; errors count from ``since`` [s] on.

    ``recording`` (T,) numbers the ``logs``, if there are several.
    """

    names: tuple[str, ...]
    time: np.ndarray
    errors: dict[str, np.ndarray]
    since: float
    recording: np.ndarray
    logs: tuple[str, ...] = ()

    def mean(self, model: str, log: int | None = None) -> np.ndarray:
        """Mean absolute errors (nv,) [rad, m] of the judged rows, perhaps of one log; infinite if it diverged."""
        judged = (self.time >= self.since) & (True if log is None else self.recording == log)
        size = np.abs(self.errors[model][judged])
        return np.where(np.isfinite(size), size, np.inf).mean(axis=0) if len(size) else np.full(len(self.names), np.nan)

    def text(self) -> str:
        """A line per model and coordinate."""
        means = {model: 1e3 * self.mean(model) for model in self.errors}
        rows: list[list[Cell]] = [["all", *(float(m.mean()) for m in means.values())]]
        for k, log in enumerate(self.logs if len(self.logs) > 1 else ()):
            rows.append([f"log {log}", *(1e3 * float(self.mean(model, k).mean()) for model in means)])
        rows += [[name, *(float(m[k]) for m in means.values())] for k, name in enumerate(self.names)]
        title = (
            f"mean absolute position error [mrad, mm], open loop from the start of the log, from {self.since:g} s on"
        )
        return Table(title, ["coordinate", *means], rows).text()

    def to_json(self) -> dict[str, Any]:
        """JSON types; None replaces an error that is not finite."""
        found: dict[str, dict[str, Any]] = {}
        for model in self.errors:
            by_name = dict(zip(self.names, (_finite(x) for x in self.mean(model)), strict=True))
            found[model] = {
                "mean_absolute_position_error": _finite(self.mean(model).mean()),
                "by_coordinate": by_name,
            }
            if len(self.logs) > 1:
                errors = [_finite(self.mean(model, k).mean()) for k in range(len(self.logs))]
                found[model]["by_log"] = dict(zip(self.logs, errors, strict=True))
        return {"from": self.since, "rows": int((self.time >= self.since).sum()), "models": found}


def simulate(
    models: Mapping[str, Model],
    data: Transitions,
    scene: Scene,
    time: np.ndarray,
    since: float = 0.0,
    progress: Callable[[float, str], None] | None = None,
    logs: Sequence[str] = (),
) -> OpenLoop:
    """Simulates each episode of ``data`` from its first state with every model.

    ``time`` (N,) [s] of the states after each row; ``logs``: names by ``data.recording``. Raises UserError for another
    robot, and if no row is at ``since`` or later.
    """
    data.check(scene)
    if not (time >= since).any():
        raise UserError(f"the log ends at {time.max():g} s, before {since:g} s: give an earlier --from")
    errors = {}
    for done, (name, model) in enumerate(models.items()):
        if progress is not None:
            progress(done / len(models), name)
        log = seen(model, data)
        errors[name] = np.concatenate(
            [_drift(model, log.select(log.episode == e), scene) for e in np.unique(log.episode)]
        )
    return OpenLoop(tuple(scene.coordinate_names), time, errors, since, data.recording, tuple(logs))


def _drift(model: Model, log: Transitions, scene: Scene) -> np.ndarray:
    """Errors (T, nv) over one episode."""
    with torch.no_grad():
        q, _ = rollout(model, *(torch.as_tensor(a) for a in (log.q[:1], log.v[:1], log.u[None])))
    with np.errstate(all="ignore"):
        return np.asarray(scene.difference(log.q_next, q[0].numpy()))


def _finite(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None
