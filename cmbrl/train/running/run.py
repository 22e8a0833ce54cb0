"""A training run in a folder: iterations, metrics, checkpoints. A killed and resumed run ends at the same bits.

metrics.csv              one row per iteration       checkpoint.safetensors    everything the next iteration needs
policy.json, policy.safetensors                      the policy at the last checkpoint
train.json, metrics.png  how the run ended           diverged.npz              last states of a run that diverged
"""

from __future__ import annotations

import io
import json
import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cmbrl.errors import UserError
from cmbrl.files import make_folder, write_bytes, write_json
from cmbrl.train.policies.file import save_policy
from cmbrl.train.running.checkpoint import load_state, save_state
from cmbrl.train.running.clock import RunClock
from cmbrl.train.running.interruption import interruptible
from cmbrl.train.running.metrics import MetricsLog, Row, as_csv, from_csv
from cmbrl.train.running.metrics_plot import plot_metrics
from cmbrl.train.running.sources import check_sources
from cmbrl.train.running.texts import progress_text
from cmbrl.train.trainer import Diverged, Trainer

CHECKPOINT, RESULT, PLOT, DIVERGED = "checkpoint.safetensors", "train.json", "metrics.png", "diverged.npz"
FINISHED, INTERRUPTED, HAS_DIVERGED = "finished", "interrupted", "diverged"
_PATIENCE = 20  # iterations in a row whose loss or gradient is not finite; most trainers give up earlier
_WATCHED = ("loss", "gradient_norm", "critic_loss")

Progress = Callable[[float, str], object]


@dataclass(frozen=True)
class Outcome:
    """How a run ended ("finished" or "interrupted"), its iterations and seconds in all parts, its last row.

    ``failed_trials``: of a finished run, as its trainer tells them.
    """

    stopped: str
    iteration: int
    seconds: float
    last: Row
    failed_trials: dict[str, float]


class TrainingRun:
    """Trains ``trainer`` in ``folder``.

    Args:
        trainer: a fresh one; to resume, made with the same arguments as before.
        folder: created if missing.
        about: what policy.json says besides the architecture: task, algorithm, ...
        resume: continue from the folder's checkpoint.
        checkpoint_seconds: time between checkpoints; there is also one before the first iteration and one at the end.
        options: what tells this run from others, JSON types; a checkpoint of others is refused. Default ``about``.
        sources: digests of the files that it learns on (:func:`cmbrl.train.running.sources.sources`).

    Raises UserError if there is no checkpoint to resume from, if it belongs to another trainer, or if one of the
    ``sources`` has changed since.
    """

    def __init__(
        self,
        trainer: Trainer,
        folder: str | os.PathLike[str],
        about: Mapping[str, Any],
        resume: bool = False,
        checkpoint_seconds: float = 60.0,
        options: Mapping[str, Any] | None = None,
        sources: Mapping[str, str] | None = None,
    ) -> None:
        self.trainer, self.folder, self.about = trainer, Path(folder), dict(about)
        self.sources = dict(sources or {})
        self._options = json.dumps(dict(about if options is None else options), sort_keys=True)
        self.checkpoint_seconds = checkpoint_seconds
        self.iteration, self.clock = 0, RunClock()
        self._unusable = 0
        self._rows: list[Row] = []  # of metrics.csv
        make_folder(self.folder)
        if resume:
            self._restore()
        else:
            self._checkpoint()

    def train(self, iterations: int, progress: Progress | None = None) -> Outcome:
        """Continues until ``iterations`` are done in all, or until Ctrl-C, which lets the current one finish.

        A trainer may want ``further`` ones.

        ``progress(share, text)`` is called after each iteration, and before what takes long. Raises Diverged if the run
        cannot continue; then diverged.npz holds the last states, and the last checkpoint is kept.
        """
        self.clock.go_on()
        saved = time.monotonic()
        log = MetricsLog(self.folder, self._rows)
        try:
            with interruptible() as interrupted:
                while not (self._done(iterations) or interrupted()):
                    if progress is not None and self.trainer.ahead:
                        progress(self.iteration / (iterations + self.trainer.further), self.trainer.ahead)
                    metrics = self.trainer.update()
                    self.iteration += 1
                    log.append({"iteration": self.iteration, **self.clock.read(), **metrics})
                    self._watch(metrics)
                    if progress is not None:
                        progress(self.iteration / (iterations + self.trainer.further), progress_text(log.rows[-1]))
                    if time.monotonic() - saved > self.checkpoint_seconds:
                        self._checkpoint()
                        saved = time.monotonic()
                self._checkpoint()
            if progress is not None and self._done(iterations):
                progress(1.0, "trials of the policy in the model")
            return self._conclude(FINISHED if self._done(iterations) else INTERRUPTED, log)
        except Diverged as error:
            raise self._give_up(error, log) from None
        finally:
            log.close()

    def _done(self, iterations: int) -> bool:
        return self.iteration >= iterations + self.trainer.further or self.trainer.over

    def _checkpoint(self) -> None:
        self.trainer.keep(self.folder)  # first: a run that goes on from this checkpoint has no fit to write any more
        state = {"iteration": self.iteration, **self.clock.told(), "metrics": as_csv(self._rows)}
        state |= {"options": self._options, "sources": self.sources}
        save_state(self.folder / CHECKPOINT, {**state, "trainer": self.trainer.state()})
        about = self.about | self._conditions() | {"iteration": self.iteration}
        save_policy(self.trainer.policy, self.folder, about)

    def _conditions(self) -> dict[str, Any]:
        found = self.trainer.conditions()
        return {"commands": found} if found else {}

    def _restore(self) -> None:
        path = self.folder / CHECKPOINT
        state = load_state(path)
        if state.get("options") != self._options:
            raise UserError(f"{path}: belongs to a run with other options: choose another --out")
        check_sources(self.folder, state.get("sources", {}), self.sources)  # runs of an earlier version tell none
        try:
            self.trainer.restore(state["trainer"])
            self.iteration = int(state["iteration"])
            self.clock = RunClock(float(state["seconds"]), float(state["processor_seconds"]))
            self._rows = from_csv(state["metrics"])
        except (KeyError, IndexError, AttributeError, TypeError, ValueError, RuntimeError, AssertionError) as error:
            last = (str(error).strip().splitlines() or [type(error).__name__])[-1].strip()
            why = f"does not belong to this run ({last}), or is of another version"
            raise UserError(f"{path}: {why}: choose another --out") from None

    def _watch(self, metrics: Mapping[str, float]) -> None:
        """Raises Diverged if weights are not finite, or losses or gradients too many times in a row."""
        if not all(bool(torch.isfinite(p).all()) for p in self.trainer.policy.parameters()):
            raise Diverged(f"the policy's weights are not finite after iteration {self.iteration}", self._states())
        usable = all(math.isfinite(metrics.get(name, 0.0)) for name in _WATCHED)
        self._unusable = 0 if usable else self._unusable + 1
        if self._unusable > _PATIENCE:
            raise Diverged(f"losses or gradients of {self._unusable} iterations were not finite", self._states())

    def _states(self) -> dict[str, np.ndarray]:
        """The states of the trainer's simulation, where it has one."""
        simulation = self.trainer.simulation
        return {} if simulation is None else {"q": simulation.q.detach().numpy(), "v": simulation.v.detach().numpy()}

    def _give_up(self, error: Diverged, log: MetricsLog) -> Diverged:
        content = io.BytesIO()
        np.savez(content, **error.states)  # type: ignore[arg-type]
        write_bytes(self.folder / DIVERGED, content.getvalue())
        self._conclude(HAS_DIVERGED, log)
        return Diverged(f"{error}; the last states are in {self.folder / DIVERGED}", error.states)

    def _conclude(self, stopped: str, log: MetricsLog) -> Outcome:
        last = log.rows[-1] if log.rows else {}
        spent = {name: round(seconds, 3) for name, seconds in self.clock.told().items()}
        result: dict[str, Any] = {"stopped": stopped, "iteration": self.iteration, **spent}
        result |= self._conditions()
        if self.trainer.returns_to:
            result["went_back"] = [list(pair) for pair in self.trainer.returns_to]
        if self.trainer.learned_on:
            result["learned_on"] = [list(pair) for pair in self.trainer.learned_on]
        if self.trainer.kept is not None:
            result["kept"] = self.trainer.kept
        trials = self.trainer.failed_trials() if stopped == FINISHED else {}
        result |= {"failed_trials": trials} if trials else {}
        if self.trainer.gradients:
            result["lost_gradients"] = self.trainer.gradients
        if self.trainer.remarks:
            result["remarks"] = dict(self.trainer.remarks)
        if self.trainer.earned:
            result["model_return"] = {name: round(x, 3) for name, x in self.trainer.earned.items()}
        known = {name: value if math.isfinite(value) else None for name, value in last.items()}
        write_json(self.folder / RESULT, {**result, "last": known})
        if log.rows:
            title = ", ".join(f"{name} {value}" for name, value in self.about.items())
            plot_metrics(log.rows, self.folder / PLOT, title)
        return Outcome(stopped, self.iteration, self.clock.seconds, last, trials)
