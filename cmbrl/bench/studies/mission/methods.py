"""The contenders of the mission: how each trainer is made from a task, a random log and a seed; how long it runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from importlib.util import find_spec
from typing import Any

from cmbrl.bench.studies.mission.runs import Contest, Plan
from cmbrl.contact.smoothing import Adaptive
from cmbrl.data.transitions import Transitions
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.ensemble import EnsembleConfig, NeuralEnsemble
from cmbrl.models.protocol import Model
from cmbrl.registry import Task
from cmbrl.train.baselines import PPO, SAC
from cmbrl.train.loop import Loop, LoopConfig
from cmbrl.train.mbpo import MBPO
from cmbrl.train.recipe import configure
from cmbrl.train.shac import SHAC, SHACConfig
from cmbrl.train.trainer import Trainer

LOOP, LOOP_ABS, NOMINAL = "complementarity loop", "complementarity loop, ABS", "nominal MJCF"
MBPO_LOG, SHAC_NEURAL = "MBPO, same log", "SHAC on neural ensemble, same log"
MBPO_ONLINE, SAC_ONLINE, PPO_ONLINE = "MBPO online", "SAC online", "PPO online"
_SB3 = "stable_baselines3"
ENDLESS = 1_000_000  # iterations of a run that ends by its seconds
_RIVALS = {LOOP_ABS: 3, NOMINAL: 3, MBPO_LOG: 3, SHAC_NEURAL: 3, MBPO_ONLINE: 1, SAC_ONLINE: 3, PPO_ONLINE: 3}


@dataclass(frozen=True)
class Work:
    """Sizes of the study."""

    seeds: Mapping[str, Mapping[str, int]] = field(
        default_factory=lambda: {
            "hopper": {LOOP: 10, **_RIVALS},
            "cheetah": {LOOP: 5, **_RIVALS},
        }
    )  #: scene -> method -> number of seeds
    transitions: int = 1000  #: of the random log that a seed's methods share
    seconds: Mapping[str, float] = field(
        default_factory=lambda: {"hopper": 420.0, "cheetah": 150.0}
    )  #: scene -> processor time of a run of a method that has no end of its own: what the loop takes there
    points: int = 8  #: of a curve
    ensemble_updates: int = 2000  #: of the ensemble that SHAC trains on
    neural_iterations: int = 1200  #: of SHAC on it, at most: on the hopper the time of one of the loop's policies
    loop: Mapping[str, Any] = field(default_factory=dict)  #: other settings of the loop (and of SHAC) than the task's
    mbpo: Mapping[str, Any] = field(default_factory=dict)  #: of MBPO, than ``two_cores``
    sac: Mapping[str, Any] = field(default_factory=dict)
    ppo: Mapping[str, Any] = field(default_factory=dict)


_SMALL_LOOP = {
    "iterations": 6, "policies": 2, "environments": 8, "horizon": 4, "draws": 8, "score_episodes": 4,
    "episode_steps": 50, "actor_hidden": (16,), "critic_hidden": (16,),
}  # fmt: skip
QUICK = Work(
    seeds={name: dict.fromkeys((LOOP, *_RIVALS), 1) for name in ("hopper", "cheetah")},
    transitions=200, seconds={"hopper": 2.0, "cheetah": 2.0}, points=2, ensemble_updates=50, loop=_SMALL_LOOP,
    mbpo={"warmup": 200, "block": 10, "rollouts": 200, "fit_updates": 20, "refit_updates": 5, "hidden": (16, 16)},
    sac={"warmup": 200, "block": 50, "hidden": (16, 16)}, ppo={"horizon": 128, "hidden": (16, 16)},
)  # fmt: skip


@dataclass(frozen=True)
class Setup:
    """What a method is given: a task, its nominal model, the seed's random log (None: it collects its own)."""

    task: Task
    contest: Contest
    nominal: ComplementarityModel
    work: Work
    seed: int
    log: Transitions | None

    def loop_config(self) -> LoopConfig:
        """The task's settings, with what the study changes."""
        config: LoopConfig = configure("loop", self.task, {"transitions": self.work.transitions, **self.work.loop})
        return config


@dataclass(frozen=True)
class Method:
    """``make`` builds the trainer (on the clock), ``model`` the one that its policy believes in; ``plan`` its length.

    ``takes_log``: whether it learns from the seed's random log. ``library``: what it cannot be made without.
    """

    make: Callable[[Setup], Any]
    plan: Callable[[Setup], Plan]
    model: Callable[[Any], Model] | None = None
    takes_log: bool = False
    library: str | None = None

    def available(self) -> bool:
        """Whether its library is installed."""
        return self.library is None or find_spec(self.library) is not None


def _loop(s: Setup) -> Loop:
    return Loop(s.contest.mdp, s.nominal, s.loop_config(), s.seed, system=s.contest.system, data=s.log)


def _loop_abs(s: Setup) -> Loop:
    """`cmbrl train --derivative adaptive:length=1e-3`: as ABS in the study of estimators."""
    return _loop(replace(s, nominal=s.nominal.with_settings(backward_smoothing=Adaptive(1e-3))))


def _nominal(s: Setup) -> Trainer:
    return SHAC(s.contest.mdp, s.nominal, s.loop_config().shac(), s.seed)


def _shac_neural(s: Setup) -> Trainer:
    assert s.log is not None
    config = EnsembleConfig(updates=s.work.ensemble_updates)
    ensemble = NeuralEnsemble(s.task.load_scene(), s.task.control_dt, config)
    ensemble.fit(s.log, s.seed)
    return SHAC(s.contest.mdp, ensemble, _neural_config(s), s.seed)


def _neural_config(s: Setup) -> SHACConfig:
    own = s.loop_config().shac()
    return replace(own, iterations=min(own.iterations, s.work.neural_iterations))


def _mbpo(s: Setup, online: bool) -> Trainer:
    config = configure("mbpo", s.task).two_cores()
    if not online:  # rollouts as long as they get in the end: its schedule goes by real transitions, which do not come
        config = replace(config, length_start=config.length_end)
    config = replace(config, **s.work.mbpo)
    ensemble = NeuralEnsemble(s.task.load_scene(), s.task.control_dt, EnsembleConfig.original())
    return MBPO(s.contest.mdp, ensemble, config, s.seed, s.contest.system if online else None, s.log)


def _sac(s: Setup) -> Trainer:
    return SAC(s.contest.mdp, s.contest.system, configure("sac", s.task, s.work.sac), s.seed)


def _ppo(s: Setup) -> Trainer:
    return PPO(s.contest.mdp, s.contest.system, configure("ppo", s.task, s.work.ppo), s.seed)


def _whole_loop(s: Setup) -> Plan:
    return Plan(s.loop_config().iterations, points=s.work.points)


def _one_policy(s: Setup) -> Plan:
    return Plan(s.loop_config().shac().iterations, points=s.work.points)


def _neural(s: Setup) -> Plan:
    return Plan(_neural_config(s).iterations, points=s.work.points)


def _seconds(s: Setup) -> Plan:
    return Plan(ENDLESS, s.work.seconds[s.task.name], s.work.points)


def _own(trainer: Any) -> Model:
    return trainer.model  # type: ignore[no-any-return]


METHODS = {
    LOOP: Method(_loop, _whole_loop, _own, takes_log=True),
    LOOP_ABS: Method(_loop_abs, _whole_loop, _own, takes_log=True),
    NOMINAL: Method(_nominal, _one_policy, _own),
    MBPO_LOG: Method(partial(_mbpo, online=False), _seconds, _own, takes_log=True, library=_SB3),
    SHAC_NEURAL: Method(_shac_neural, _neural, _own, takes_log=True),
    MBPO_ONLINE: Method(partial(_mbpo, online=True), _seconds, _own, library=_SB3),
    SAC_ONLINE: Method(_sac, _seconds, library=_SB3),
    PPO_ONLINE: Method(_ppo, _seconds, library=_SB3),
}


def settings_of(work: Work) -> dict[str, Any]:
    """What a cell depends on beside scene, method and seed: JSON types."""
    return {f.name: _plain(getattr(work, f.name)) for f in fields(work) if f.name != "seeds"}


def _plain(x: Any) -> Any:
    if isinstance(x, Mapping):
        return {k: _plain(v) for k, v in x.items()}
    return list(x) if isinstance(x, tuple) else x
