"""A training run from names: which task, algorithm, model and hyperparameters, checked before any work starts."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from cmbrl.envs.checked_gradient import check_derivative, check_effect
from cmbrl.envs.checked_robot import check_robot
from cmbrl.envs.of_task import check_system, decision_process, real_system, task_for
from cmbrl.errors import UserError
from cmbrl.mdp import MDP
from cmbrl.models.named import nominal_model
from cmbrl.models.source import load_log
from cmbrl.registry import Task
from cmbrl.text import parse_fields
from cmbrl.train.algorithms import ALGORITHMS, algorithm
from cmbrl.train.models import NOMINAL, REAL, check_model, kind_of, load_model, usual_model, with_derivative
from cmbrl.train.recipe import configure
from cmbrl.train.start import carried_over, with_actions_of
from cmbrl.train.trainer import Trainer
from cmbrl.train.windows.learner import WindowLearner


@dataclass(frozen=True)
class Setup:
    """A training run, checked by :func:`set_up`; ``trainer`` loads the model and the log."""

    task: Task
    algorithm: str
    model: str
    config: Any  #: the algorithm's configuration dataclass
    mdp: MDP
    data: str | None
    offline: bool
    smoothing: str | None
    derivative: str | None
    seed: int
    threads: int | None
    motion: str | None = None
    start: str | None = None

    def trainer(self) -> Trainer:
        """A fresh trainer; raises UserError on a model or log that does not fit the task."""
        chosen = algorithm(self.algorithm)
        refits = "system" in chosen.takes
        model: Any
        if self.model == REAL:
            model = real_system(self.task)
        else:
            draws = 0 if refits else getattr(self.config, "draws", 0)
            model = load_model(self.model, self.task, self.smoothing, self.threads, draws, self.seed)
        if self.derivative:
            model = with_derivative(model, self.derivative, self.seed, refits)
        extras: dict[str, Any] = {}
        if "system" in chosen.takes:
            extras["system"] = None if self.offline else real_system(self.task)
        if "data" in chosen.takes:
            extras["data"] = load_log(self.data, self.task.load_scene()) if self.data else None
        config = with_actions_of(self.start, self.config, self.mdp, model) if self.start else self.config
        trainer: Trainer = chosen.load()[0](self.mdp, model, config, seed=self.seed, **extras)
        trainer.judged = None if self.task.trial is None else self.task.trial()
        if self.start:
            assert isinstance(trainer, WindowLearner)  # as those that go on are
            trainer.begin_with(carried_over(self.start, trainer.policy.architecture))
        return trainer


def set_up(
    task: str,
    algorithm_name: str | None = None,
    model: str | None = None,
    settings: Mapping[str, str] | None = None,
    *,
    data: str | None = None,
    offline: bool = False,
    smoothing: str | None = None,
    derivative: str | None = None,
    seed: int = 0,
    threads: int | None = None,
    motion: str | None = None,
    contact_law: str | None = None,
    sliding: str | None = None,
    start: str | None = None,
) -> Setup:
    """A checked training run.

    Args:
        task: name of a registered task with a reward.
        algorithm_name: a name of ``cmbrl.train.algorithms``; None: see :func:`recommended`.
        model: "nominal", "ensemble", "real", or the folder of a fit or an ensemble; None: the algorithm's usual one.
        settings: hyperparameters as text, over those of the task.
        data: file of a log to start from, for an algorithm that learns its model.
        offline: take no real steps, learn from ``data`` alone.
        smoothing: of the simulation, e.g. "barrier:kappa=1e-4"; None: that of the task.
        derivative: what the model's derivative is, e.g. "gaussian:length=1e-3"; None: that of the simulation.
        seed: of everything random.
        threads: of the native core; results do not depend on it.
        motion: file of the motion to imitate, for a task that imitates; None: the task's own.
        contact_law: of the nominal model, as in :meth:`cmbrl.Scene.from_mjcf`; None: the task's.
        sliding: of the nominal model, as in :class:`cmbrl.ComplementarityModel`; None: the task's.
        start: folder of a run whose policy this one begins with; None: a fresh one.

    Raises UserError on names, values and combinations that do not work.
    """
    found = task_for(task, motion, contact_law, sliding)
    name = algorithm_name or recommended(found, model)
    chosen = algorithm(name)
    mdp = decision_process(found)
    model = model or usual_model(chosen.models[0])
    check_model(model)
    if kind_of(model) not in chosen.models:
        possible = " or ".join(chosen.models)
        raise UserError(f"--model {model}: {name} cannot train on a {kind_of(model)}; it takes: {possible}")
    for given, what in ((contact_law, "--contact-law"), (sliding, "--sliding")):
        if given and model != NOMINAL:
            raise UserError(f"{what} applies to the nominal model, not to {model}: drop it")
    if smoothing and model == REAL:
        raise UserError("--smoothing does not apply to the real system: drop it")
    if data and "data" not in chosen.takes:
        raise UserError(f"--data: {name} does not learn from a log: fit a model to it and name that by --model")
    if offline and not (data and "system" in chosen.takes):
        raise UserError("--offline needs --data FILE and an algorithm that takes real steps")
    if start and not chosen.goes_on:
        able = " or ".join(known for known, one in ALGORITHMS.items() if one.goes_on)
        raise UserError(f"--start: {name} begins with a policy of its own: train by {able}")
    check_robot(mdp, found)
    check_system(found)
    if chosen.differentiates and check_derivative(mdp, f"task {found.name!r}"):  # else one fault would be told twice
        with suppress(UserError):  # a file that cannot be modelled is refused where it has to be
            check_effect(mdp, nominal_model(found, threads=1), f"task {found.name!r}")
    config = configure(name, found, parse_fields(chosen.load()[1], settings or {}, name))
    return Setup(found, name, model, config, mdp, data, offline, smoothing, derivative, seed, threads, motion, start)


def recommended(task: Task, model: str | None = None) -> str:
    """The default algorithm: the task's; or the loop if there is a real system and no model is named, else SHAC."""
    if task.algorithm is not None:
        return task.algorithm
    return "loop" if task.system is not None and model is None else "shac"
