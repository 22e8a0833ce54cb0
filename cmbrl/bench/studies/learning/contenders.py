"""The models that are compared: how each is trained on a log, and how far it scales."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Any

from cmbrl.bench.studies.learning import mujoco_sysid
from cmbrl.bench.studies.learning.logs import System, wrong_parameters
from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError
from cmbrl.fitting import fit
from cmbrl.models.baselines import HoldVelocity
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.ensemble import EnsembleConfig, NeuralEnsemble
from cmbrl.models.protocol import Model

SIZES = (200, 1_000, 5_000, 20_000, 100_000)
QUICK_SIZES = (200, 1_000)
OTHER_INTEGRATOR = {"hopper": "EULER", "cheetah": "RK4"}  # than the real system's, at its time step

Train = Callable[[System, Transitions | None, int], tuple[Model, dict[str, Any]]]


@dataclass(frozen=True)
class Contender:
    """``train(system, log, seed)`` gives the model and what its training did; ``learns``: it needs a log.

    ``max_rows``: larger logs are left out, because ``stops``; ``all_seeds_to``: on larger logs one seed only;
    ``quick_rows``: the largest log of a quick study.
    """

    name: str
    train: Train
    learns: bool = True
    max_rows: int = SIZES[-1]
    all_seeds_to: int = SIZES[-1]
    stops: str = ""
    tasks: tuple[str, ...] = ("hopper", "cheetah")
    quick_rows: int = QUICK_SIZES[-1]


def updates_for(rows: int) -> int:
    """Gradient steps of the ensemble: what a log of so many rows repays, within the time of the study.

    2,000 instead of 5,000 on logs of 200 and 1,000 rows: error over a step within 4 % on both robots.
    """
    return 2_000 if rows <= 1_000 else 3_000 if rows <= 5_000 else 6_000 if rows <= 20_000 else 8_000


def _nominal(system: System, wrong: bool) -> ComplementarityModel:
    parameters = wrong_parameters(system.scene) if wrong else None
    return ComplementarityModel(system.scene, parameters=parameters, **system.task.model_options())


def _hold(system: System, log: Transitions | None, seed: int) -> tuple[Model, dict[str, Any]]:
    return HoldVelocity(system.scene, system.held_out.dt), {}


def _untrained(wrong: bool) -> Train:
    return lambda system, log, seed: (_nominal(system, wrong), {})


def _fitted(groups: str | None) -> Train:
    def train(system: System, log: Transitions | None, seed: int) -> tuple[Model, dict[str, Any]]:
        assert log is not None  # every fitted model has one
        result = fit(_nominal(system, wrong=True), log, seed=seed, groups=groups)
        moved = sum(p.status != "nominal" for p in result.parameters.values())
        return result.model, {"parameters": moved, "candidates": result.report["candidates"]}

    return train


def _ensemble(config: EnsembleConfig) -> Train:
    def train(system: System, log: Transitions | None, seed: int) -> tuple[Model, dict[str, Any]]:
        assert log is not None
        settings = config if config.updates is None else replace(config, updates=updates_for(len(log)))
        model = NeuralEnsemble(system.scene, log.dt, settings)
        report = model.fit(log, seed)
        weights = sum(p.numel() for p in model.network.parameters())
        return model, {"parameters": weights, "updates": report.updates, "stopped": report.stopped}

    return train


def _process(system: System, log: Transitions | None, seed: int) -> tuple[Model, dict[str, Any]]:
    assert log is not None
    if find_spec("sklearn") is None:
        raise UserError("scikit-learn is not installed: pip install 'cmbrl[bench]'")
    from cmbrl.bench.studies.learning.gaussian_process import GaussianProcess

    model = GaussianProcess(system.scene, log, seed)
    return model, {"parameters": sum(len(p.kernel_.theta) for p in model.processes)}


def _sysid(other: bool) -> Train:
    def train(system: System, log: Transitions | None, seed: int) -> tuple[Model, dict[str, Any]]:
        assert log is not None
        integrator = OTHER_INTEGRATOR[system.task.name] if other else None
        start = wrong_parameters(system.scene)
        return mujoco_sysid.sysid_model(system.task, system.scene, log, start, integrator)

    return train


_ORIGINAL = EnsembleConfig.original()
_SYSID_STOPS = "its time grows with the rows"
_PATIENCE = "patience lets it train for minutes"

CONTENDERS = (
    Contender("hold", _hold, learns=False),
    Contender("wrong MJCF", _untrained(wrong=True), learns=False),
    Contender("true MJCF", _untrained(wrong=False), learns=False),
    Contender("fitted, all parameters", _fitted("all"), all_seeds_to=20_000, stops="looks at 5,000 rows of a log"),
    Contender("fitted, parsimonious", _fitted(None), max_rows=5_000, quick_rows=200,
              stops="the selection looks at 4,000 rows of a log"),
    Contender("mujoco.sysid, true integrator", _sysid(other=False), max_rows=5_000,
              quick_rows=200, stops=_SYSID_STOPS),
    Contender("mujoco.sysid, other integrator", _sysid(other=True), max_rows=5_000,
              quick_rows=200, stops=_SYSID_STOPS),
    Contender("Gaussian process", _process, max_rows=5_000, quick_rows=200,
              stops="memory grows with the square and time with the cube of the rows"),
    Contender("ensemble (MBPO)", _ensemble(_ORIGINAL), all_seeds_to=20_000, stops=_PATIENCE),
    Contender("ensemble (MBPO), targets normalised", _ensemble(replace(_ORIGINAL, normalise_targets=True)),
              max_rows=20_000, quick_rows=200, stops=_PATIENCE),
    Contender("ensemble, tuned", _ensemble(EnsembleConfig()), all_seeds_to=20_000, quick_rows=200,
              stops="training time"),
    Contender("ensemble, tuned and larger", _ensemble(EnsembleConfig(width=400)), max_rows=20_000, all_seeds_to=1_000,
              quick_rows=0, tasks=("hopper",), stops="three times the training time"),
)  # fmt: skip
