"""What the mission compares: how each trainer is made from a task, a random log and a seed, and how long it runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from typing import Any

from cmbrl.bench.studies.mission.runs import Result, Setup, Training, Work
from cmbrl.contact.smoothing import Gaussian
from cmbrl.models.neural.ensemble import EnsembleConfig, NeuralEnsemble
from cmbrl.train.loop import Loop
from cmbrl.train.loop_config import LoopConfig
from cmbrl.train.mbpo import MBPO
from cmbrl.train.ppo import PPO
from cmbrl.train.recipe import configure
from cmbrl.train.sac import SAC
from cmbrl.train.shac import SHAC, SHACConfig
from cmbrl.train.trainer import Trainer

LOOP, LOOP_GAUSSIAN, NOMINAL = "complementarity loop", "complementarity loop, Gaussian", "nominal MJCF"
MBPO_LOG, SHAC_NEURAL = "MBPO, same log", "SHAC on neural ensemble, same log"
MBPO_ONLINE, SAC_ONLINE, PPO_ONLINE = "MBPO online", "SAC online", "PPO online"
QUICK = Work(
    transitions=200, seconds={"hopper": 2.0, "cheetah": 2.0}, points=2, ensemble_updates=50,
    loop={"iterations": 6, "policies": 2, "environments": 8, "horizon": 4, "draws": 8, "score_episodes": 4,
          "episode_steps": 50, "actor_hidden": (16,), "critic_hidden": (16,)},
    mbpo={"warmup": 200, "block": 10, "rollouts": 200, "fit_updates": 20, "refit_updates": 5, "hidden": (16, 16)},
    sac={"warmup": 200, "block": 50, "hidden": (16, 16)}, ppo={"horizon": 128, "hidden": (16, 16)},
)  # fmt: skip


@dataclass(frozen=True)
class Arm:
    """``make`` builds the trainer (on the clock); ``iterations`` of it, None: until the scene's seconds are spent.

    ``colour``, ``marker``: in pictures. ``takes_log``: whether it learns from the seed's random log. ``modelled``:
    whether its policy is trained on a model, ``trainer.model``. ``library``: what it needs to be installed.
    """

    colour: str
    marker: str
    make: Callable[[Setup], Any]
    iterations: Callable[[Setup], int] | None = None
    takes_log: bool = False
    modelled: bool = True
    library: str | None = None

    def available(self) -> bool:
        """Whether its library is installed."""
        return self.library is None or find_spec(self.library) is not None


def train(scene: str, arm: str, seed: int, work: Work) -> Result:
    """One run, judged at its end."""
    chosen = ARMS[arm]
    setup = Setup.of(scene, seed, work, chosen.takes_log)
    training = Training(setup, chosen.iterations and chosen.iterations(setup)).run(chosen.make)
    return {"scene": scene, "arm": arm, "seed": seed, **training.result(chosen.modelled)}


def _config(s: Setup) -> LoopConfig:
    """The task's settings, with what the study changes."""
    config: LoopConfig = configure("loop", s.task, {"transitions": s.work.transitions, **s.work.loop})
    return config


def _loop(s: Setup) -> Loop:
    return Loop(s.mdp, s.nominal, _config(s), s.seed, system=s.system, data=s.log)


def _loop_gaussian(s: Setup) -> Loop:
    """`cmbrl train --derivative gaussian:length=1e-3`: as "Gaussian" in the study ``estimators``."""
    return _loop(replace(s, nominal=s.nominal.with_settings(backward_smoothing=Gaussian(1e-3))))


def _nominal(s: Setup) -> Trainer:
    return SHAC(s.mdp, s.nominal, _config(s).shac(), s.seed)


def _shac_neural(s: Setup) -> Trainer:
    assert s.log is not None
    ensemble = NeuralEnsemble(s.task.load_scene(), s.task.control_dt, EnsembleConfig(updates=s.work.ensemble_updates))
    ensemble.fit(s.log, s.seed)
    return SHAC(s.mdp, ensemble, _neural_config(s), s.seed)


def _neural_config(s: Setup) -> SHACConfig:
    own = _config(s).shac()
    return replace(own, iterations=min(own.iterations, s.work.neural_iterations))


def _mbpo(s: Setup, online: bool) -> Trainer:
    config = configure("mbpo", s.task).two_cores()
    if not online:  # the schedule of rollout lengths counts real transitions, so without any take its end
        config = replace(config, length_start=config.length_end)
    config = replace(config, **s.work.mbpo)
    ensemble = NeuralEnsemble(s.task.load_scene(), s.task.control_dt, EnsembleConfig.original())
    return MBPO(s.mdp, ensemble, config, s.seed, s.system if online else None, s.log)


def _sac(s: Setup) -> Trainer:
    return SAC(s.mdp, s.system, configure("sac", s.task, s.work.sac), s.seed)


def _ppo(s: Setup) -> Trainer:
    return PPO(s.mdp, s.system, configure("ppo", s.task, s.work.ppo), s.seed)


_SB3 = "stable_baselines3"
ARMS = {
    LOOP: Arm("#08519c", "o", _loop, lambda s: _config(s).iterations, takes_log=True),
    LOOP_GAUSSIAN: Arm("#6baed6", "o", _loop_gaussian, lambda s: _config(s).iterations, takes_log=True),
    NOMINAL: Arm("0.35", "x", _nominal, lambda s: _config(s).shac().iterations),
    MBPO_LOG: Arm("#fdae6b", "v", partial(_mbpo, online=False), takes_log=True, library=_SB3),
    SHAC_NEURAL: Arm("#cb181d", "s", _shac_neural, lambda s: _neural_config(s).iterations, takes_log=True),
    MBPO_ONLINE: Arm("#d94801", "^", partial(_mbpo, online=True), library=_SB3),
    SAC_ONLINE: Arm("#238b45", "D", _sac, modelled=False, library=_SB3),
    PPO_ONLINE: Arm("#6a51a3", "P", _ppo, modelled=False, library=_SB3),
}  #: by name, in the order of tables and legends
