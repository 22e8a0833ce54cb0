"""``--model M``: what a policy is trained or tried on, from the word on the command line to an object that steps."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cmbrl.cli.options import positive_number
from cmbrl.errors import UserError

if TYPE_CHECKING:
    from cmbrl.envs.mdp import MDP
    from cmbrl.envs.system import SystemFactory
    from cmbrl.models.protocol import Model
    from cmbrl.registry import Task
    from cmbrl.train.policy_file import SavedPolicy

NOMINAL, ENSEMBLE, REAL = "nominal", "ensemble", "real"
_BUILT_IN = (NOMINAL, ENSEMBLE, REAL)
MODEL_HELP = "nominal (the task's scene as it is), the run folder of a fit, the folder of an ensemble"


@dataclass(frozen=True)
class Softness:
    """``--smoothing``: "exact", or "barrier" or "adaptive" with its kappa [J] or length [m]."""

    kind: str
    size: float = 0.0

    def __str__(self) -> str:
        return self.kind if self.kind == "exact" else f"{self.kind}={self.size:g}"

    def build(self) -> Any:
        """The smoothing policy that it stands for."""
        from cmbrl.contact import Adaptive, Barrier, Exact

        if self.kind == "exact":
            return Exact()
        return Barrier(kappa=self.size) if self.kind == "barrier" else Adaptive(length=self.size)


def softness(text: str) -> Softness:
    """``exact``, ``barrier=KAPPA`` or ``adaptive=LENGTH``."""
    kind, sign, size = text.partition("=")
    if kind == "exact" and not sign:
        return Softness(kind)
    if kind in ("barrier", "adaptive") and sign:
        return Softness(kind, positive_number(size))
    raise argparse.ArgumentTypeError(f"{text!r} is not exact, barrier=KAPPA or adaptive=LENGTH, e.g. barrier=1e-4")


def add_smoothing(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--smoothing",
        type=softness,
        metavar="S",
        help="how contacts of the model are softened: exact, barrier=KAPPA [J] or adaptive=LENGTH [m] (default: as the "
        "task or the fit has it)",
    )


def add_derivative(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--derivative",
        metavar="D",
        help="what the model's derivative is: exact (default), barrier:kappa=1e-4 (BS), adaptive:length=1e-3 (ABS), "
        "bundle:samples=16,position=1e-3, bcg:branches=10",
    )


def differentiated(model: Any, text: str, seed: int, refits: bool) -> Any:
    """``model`` with its derivative as in ``--derivative``; ``refits``: the algorithm changes the model's parameters.

    Raises UserError for what is no contact model, and for a bundle around a model that is to be fitted.
    """
    from cmbrl.gradients.kinds import derivative_model, parse_derivative
    from cmbrl.models.complementarity import ComplementarityModel

    if not isinstance(model, ComplementarityModel):
        raise UserError("--derivative: is of contacts, and this model has none: leave it out")
    kind, options = parse_derivative(text)
    found = derivative_model(model, kind, seed, **options)
    if refits and not isinstance(found, ComplementarityModel):
        raise UserError(f"--derivative {text}: this algorithm fits its model, which a {kind} cannot be: use adaptive")
    return found


def decision_process(task: Task) -> MDP:
    """What is asked of the task's robot; raises UserError for a task without it."""
    if task.mdp is None:
        raise UserError(f"task {task.name!r} has no reward (Task.mdp): policies are for {_with_mdp()}")
    mdp = task.mdp()
    if abs(mdp.dt / mdp.repeat - task.control_dt) > 1e-6 * task.control_dt:
        raise UserError(
            f"task {task.name!r}: its process (Task.mdp) takes {mdp.repeat} model steps in {mdp.dt:g} s, of "
            f"{task.control_dt:g} s each: mend dt, repeat or control_dt"
        )
    return mdp


def saved_policy(folder: str) -> tuple[SavedPolicy, Task, MDP]:
    """The policy in ``folder``, its task, and what is asked there; raises UserError when they do not fit together."""
    from cmbrl.registry import load_task
    from cmbrl.train.policy_file import load_policy

    saved = load_policy(folder)
    task = load_task(saved.task)
    mdp = decision_process(task)
    shape = saved.policy.architecture
    have, need = (shape.observations, shape.actions), (mdp.observations, mdp.actions)
    if have != need:
        raise UserError(
            f"{folder}: takes {have[0]} observations for {have[1]} actions, task {task.name!r} has {need[0]} and "
            f"{need[1]}: train again"
        )
    return saved, task, mdp


def real_system(task: Task) -> SystemFactory:
    """What makes the task's real system; raises UserError for a task without one."""
    if task.system is None:
        raise UserError(f"task {task.name!r} has no real system to act in (Task.system): use --model")
    return task.system


def check_model(word: str) -> None:
    """Raises UserError unless ``word`` is nominal, ensemble, real, or a folder that holds a fit or an ensemble."""
    from cmbrl.models.named import check_name

    check_name(word, _BUILT_IN)


def kind_of(word: str) -> str:
    """The kind of model that a checked ``word`` names, in the words of `cmbrl.train.algorithms`."""
    from cmbrl.models.named import holds_fit
    from cmbrl.train import algorithms as kinds

    if word in _BUILT_IN:
        return {NOMINAL: kinds.CONTACT, ENSEMBLE: kinds.UNTRAINED, REAL: kinds.REAL}[word]
    return kinds.CONTACT if holds_fit(word) else kinds.ENSEMBLE


def usual_word(kind: str) -> str:
    """What ``--model`` is when it is not given, for an algorithm that usually trains on ``kind``."""
    return next((word for word in _BUILT_IN if kind_of(word) == kind), NOMINAL)


def load_model(word: str, task: Task, smoothing: Softness | None = None, threads: int | None = None) -> Model:
    """The next-state model that a checked ``word`` names (any but "real"); raises UserError as ``named_model`` does."""
    from cmbrl.models.ensemble import EnsembleConfig, NeuralEnsemble
    from cmbrl.models.named import named_model

    if word == ENSEMBLE:
        if smoothing is not None:
            raise UserError("--smoothing: an ensemble has no contacts to soften: leave it out")
        return NeuralEnsemble(task.load_scene(), task.control_dt, EnsembleConfig.original())
    return named_model(word, task, smoothing.build() if smoothing else None, threads)


def _with_mdp() -> str:
    from cmbrl.registry import load_task, names

    return ", ".join(name for name in names() if load_task(name).mdp is not None) or "no task here"
