"""The models that are compared: how each is trained on a log, and how far it scales."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from typing import Any

from cmbrl.bench.peers import mujoco_sysid
from cmbrl.bench.studies.learning.logs import WRONG_GROUPS, System, wrong_parameters
from cmbrl.data.transitions import Transitions
from cmbrl.fitting import fit
from cmbrl.models.baselines import HoldVelocity
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.neural.ensemble import EnsembleConfig, NeuralEnsemble
from cmbrl.models.protocol import Model

SIZES = (200, 1_000, 5_000, 20_000, 100_000)
QUICK_SIZES = (200, 1_000)
OTHER_INTEGRATOR = {"hopper": "euler", "cheetah": "rk4"}  # than the real system's, at its time step

Trained = tuple[Model, dict[str, Any]]  #: a model, and what its training did


@dataclass(frozen=True)
class Arm:
    """A kind of model."""

    train: Callable[[System, Any, int], Trained]  #: from a system, a log (Transitions, None without ``learns``), a seed
    learns: bool = True  #: from a log
    max_rows: int = SIZES[-1]  #: larger logs are left out, because ``stops``
    all_seeds_to: int = SIZES[-1]  #: larger logs get one seed only
    stops: str = ""
    tasks: tuple[str, ...] = ("hopper", "cheetah")
    quick_rows: int = QUICK_SIZES[-1]  #: the largest log of a quick study
    needs: str = ""  #: a package of the extra "bench"

    def available(self) -> bool:
        """Whether the package that it needs is installed."""
        if self.needs == "mujoco[sysid]":
            return mujoco_sysid.installed()
        return not self.needs or find_spec({"scikit-learn": "sklearn"}[self.needs]) is not None


def updates_for(rows: int) -> int:
    """Gradient steps of the ensemble on so many rows.

    2,000 instead of 5,000 on logs of 200 and 1,000 rows change the error over a step by less than 4 % on both robots.
    """
    return 2_000 if rows <= 1_000 else 3_000 if rows <= 5_000 else 6_000 if rows <= 20_000 else 8_000


def _from_mjcf(system: System, wrong: bool) -> ComplementarityModel:
    parameters = wrong_parameters(system.scene) if wrong else None
    return ComplementarityModel(system.scene, parameters=parameters, **system.task.model_options())


def _fitted(system: System, log: Transitions, seed: int, groups: str | None) -> Trained:
    result = fit(_from_mjcf(system, wrong=True), log, seed=seed, groups=groups)
    moved = sum(p.status != "nominal" for p in result.parameters.values())
    return result.model, {"parameters": moved, "candidates": result.report["candidates"]}


def _ensemble(config: EnsembleConfig) -> Callable[[System, Transitions, int], Trained]:
    def train(system: System, log: Transitions, seed: int) -> Trained:
        settings = config if config.updates is None else replace(config, updates=updates_for(len(log)))
        model = NeuralEnsemble(system.scene, log.dt, settings)
        report = model.fit(log, seed)
        weights = sum(p.numel() for p in model.network.parameters())
        return model, {"parameters": weights, "updates": report.updates, "stopped": report.stopped}

    return train


def _process(system: System, log: Transitions, seed: int) -> Trained:
    from cmbrl.bench.peers.gaussian_process import GaussianProcess

    model = GaussianProcess(system.scene, log, seed)
    return model, {"parameters": sum(len(p.kernel_.theta) for p in model.processes)}


def _sysid(system: System, log: Transitions, integrator: str | None) -> Trained:
    return mujoco_sysid.identified(system.scene, log, wrong_parameters(system.scene), WRONG_GROUPS, integrator)


_ORIGINAL = EnsembleConfig.original()
_sysid_arm = partial(Arm, max_rows=5_000, quick_rows=200, stops="its time grows with the rows", needs="mujoco[sysid]")
_PATIENCE = "its stopping rule lets it train for minutes"

ARMS = {
    "hold": Arm(lambda system, log, seed: (HoldVelocity(system.scene, system.held_out.dt), {}), learns=False),
    "wrong MJCF": Arm(lambda system, log, seed: (_from_mjcf(system, wrong=True), {}), learns=False),
    "true MJCF": Arm(lambda system, log, seed: (_from_mjcf(system, wrong=False), {}), learns=False),
    "fitted, all parameters": Arm(
        lambda system, log, seed: _fitted(system, log, seed, "all"), all_seeds_to=20_000,
        stops="the fit uses 5,000 rows of a log",
    ),
    "fitted, parsimonious": Arm(
        lambda system, log, seed: _fitted(system, log, seed, None), max_rows=5_000, quick_rows=200,
        stops="the selection uses 4,000 rows of a log",
    ),
    "mujoco.sysid, true integrator": _sysid_arm(lambda system, log, seed: _sysid(system, log, None)),
    "mujoco.sysid, other integrator": _sysid_arm(
        lambda system, log, seed: _sysid(system, log, OTHER_INTEGRATOR[system.task.name])
    ),
    "Gaussian process": Arm(
        _process, max_rows=5_000, quick_rows=200, needs="scikit-learn",
        stops="memory grows with the square and time with the cube of the rows",
    ),
    "ensemble (MBPO)": Arm(_ensemble(_ORIGINAL), all_seeds_to=20_000, stops=_PATIENCE),
    "ensemble (MBPO), targets normalised": Arm(
        _ensemble(replace(_ORIGINAL, normalise_targets=True)), max_rows=20_000, quick_rows=200, stops=_PATIENCE
    ),
    "ensemble, tuned": Arm(_ensemble(EnsembleConfig()), all_seeds_to=20_000, quick_rows=200, stops="training time"),
    "ensemble, tuned and larger": Arm(
        _ensemble(EnsembleConfig(width=400)), max_rows=20_000, all_seeds_to=1_000, quick_rows=0, tasks=("hopper",),
        stops="three times the training time",
    ),
}  # fmt: skip
