"""How far models drift from a log that they simulate from its start under its commands, without looking at it again.

Where nothing pulls the robot back, as under commands of torque, the smallest error at the start grows, and the true
model drifts as a wrong one does. So each model is simulated from a start that is a little off, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from cmbrl.accuracy.view import View
from cmbrl.errors import UserError
from cmbrl.models.protocol import Model, rollout
from cmbrl.table import Cell, Table

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.scene import Scene


_OFF = 1e-4  # [rad, m] at the start, about what an encoder tells
_GROWS, _SHARE = 10.0, 0.25  # times that, and of a model's error: then the start decides as much as the model does


@dataclass(frozen=True)
class OpenLoop:
    """Positions (T, n) less those of the log, by model, at ``time`` (T,) [s]; errors count from ``since`` [s] on.

    n are the coordinates that the log measured.

    ``recording`` (T,) numbers the ``logs``, if there are several. ``astray``: by model, how far off [rad, m] it is, in
    the mean over judged rows, if its start is 0.1 mrad, mm off to the worse side. ``restart`` [s]: each simulation ends
    there, and the next starts from the log.
    """

    names: tuple[str, ...]
    time: np.ndarray
    errors: dict[str, np.ndarray]
    since: float
    recording: np.ndarray
    logs: tuple[str, ...] = ()
    astray: Mapping[str, float] = field(default_factory=dict)
    restart: float | None = None

    def mean(self, model: str, log: int | None = None) -> np.ndarray:
        """Mean absolute errors (n,) [rad, m] of the judged rows, perhaps of one log; infinite if it diverged."""
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
        start = "start of the log" if self.restart is None else f"log every {self.restart:g} s"
        title = f"mean absolute position error [mrad, mm], open loop from the {start}, from {self.since:g} s on"
        return "\n".join([Table(title, ["coordinate", *means], rows).text(), *self._unstable()])

    def _unstable(self) -> Iterator[str]:
        """A line on the models whose error the start decides."""
        told = [
            f"{name} {1e3 * off:.3g}"
            for name, off in self.astray.items()
            if np.isfinite(error := float(self.mean(name).mean())) and not off < max(_GROWS * _OFF, _SHARE * error)
        ]
        if told:
            yield (
                f"SAYS LITTLE: from a start 0.1 mrad, mm off, it ends elsewhere ({', '.join(told)} mrad, mm): these\n"
                "  commands do not hold the robot, so which model is nearer is chance. Start anew: --restart 1 [s]"
            )

    def to_json(self) -> dict[str, Any]:
        """JSON types; None replaces an error that is not finite."""
        found: dict[str, dict[str, Any]] = {}
        for model in self.errors:
            by_name = dict(zip(self.names, (_finite(x) for x in self.mean(model)), strict=True))
            found[model] = {
                "mean_absolute_position_error": _finite(self.mean(model).mean()),
                "by_coordinate": by_name,
            }
            if model in self.astray:
                found[model]["from_a_start_0.1_mrad_off"] = _finite(self.astray[model])
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
    restart: float | None = None,
    measured: np.ndarray | None = None,
) -> OpenLoop:
    """Simulates each episode of ``data`` from its first state with every model.

    ``time`` (N,) [s] of the states after each row; ``logs``: names by ``data.recording``; ``restart``: start anew from
    the log after so many seconds; ``measured`` (nv,): the coordinates that count, default: all. Raises UserError for
    another robot, and if no row is at ``since`` or later.
    """
    data.check(scene)
    if not (time >= since).any():
        raise UserError(f"the log ends at {time.max():g} s, before {since:g} s: give an earlier --from")
    errors, astray, judged = {}, {}, time >= since
    columns = np.arange(scene.nv) if measured is None else np.flatnonzero(measured)
    for done, (name, model) in enumerate(models.items()):
        if progress is not None:
            progress(done / len(models), name)
        view = View.of(model, data, scene)  # of whole episodes: late commands are those of before a new start
        log = view.data if restart is None else _restarted(view.data, restart)
        parts = [_drift(model, log.select(log.episode == e), view.scene) for e in np.unique(log.episode)]
        compared = view.told[columns]
        errors[name], *others = (np.concatenate(found)[:, compared] for found in zip(*parts, strict=True))
        with np.errstate(all="ignore"):
            astray[name] = float(np.max([np.abs(other - errors[name])[judged].mean() for other in others]))
    names = tuple(scene.coordinate_names[k] for k in columns)
    return OpenLoop(names, time, errors, since, data.recording, tuple(logs), astray, restart)


def _restarted(data: Transitions, seconds: float) -> Transitions:
    """``data`` in episodes of at most ``seconds``."""
    begins, row = np.append(True, np.diff(data.episode) != 0), np.arange(len(data))
    since = row - np.maximum.accumulate(np.where(begins, row, 0))
    begins |= since % max(1, round(seconds / data.dt)) == 0
    return replace(data, episode=np.cumsum(begins) - 1)


def _drift(model: Model, log: Transitions, scene: Scene) -> list[np.ndarray]:
    """Errors (T, nv) over one episode, and those from starts that are a little off, to either side."""
    off = _OFF * np.array([0.0, 1.0, -1.0])[:, None] * np.ones(scene.nv)
    start = scene.integrate(np.repeat(log.q[:1], 3, axis=0), off)
    given = (np.repeat(part[None], 3, axis=0) for part in (log.v[0], log.u, log.q))
    with torch.no_grad():
        q, _ = rollout(model, *(torch.as_tensor(part) for part in (start, *given)))
    with np.errstate(all="ignore"):
        return [np.asarray(scene.difference(log.q_next, path)) for path in q.numpy()]


def _finite(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None
