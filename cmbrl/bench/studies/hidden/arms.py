"""What the study compares: how each trainer is made from a hidden robot's log, and how long it runs.

All arms with a contact model take the loop's policy step: several policies, the best in the model is kept.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from cmbrl.bench.peers import mujoco_sysid
from cmbrl.bench.studies.hidden.hidden_system import Hidden
from cmbrl.bench.studies.hidden.plan import FAMILIES, OUTSIDE, PARAMETERS, Plan
from cmbrl.bench.studies.mission.arms import ARMS as MISSION
from cmbrl.bench.studies.mission.arms import MBPO_LOG, SHAC_NEURAL
from cmbrl.bench.studies.mission.runs import Setup, Training, Work, random_log
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.named import nominal_model
from cmbrl.scene import Scene
from cmbrl.train.loop import Loop
from cmbrl.train.loop_config import LoopConfig
from cmbrl.train.recipe import configure

NOMINAL, RANDOMISED, FIT, ORACLE = "nominal", "randomised", "fit", "true parameters"
ON_POLICY, SYSID = "fit, one on-policy round", "mujoco.sysid"
WRONG = ("mass", "gear", "damping", "friction")  #: groups that the toolbox is told; those of the family "parameters"
VARIED = (*WRONG, "softness_time")  #: groups that domain randomisation varies


class GivenModel(Loop):
    """The loop's policies on a model that is given: it neither acts nor fits."""

    def _execute(self) -> None:
        pass

    def _fit(self) -> None:
        self.model = self.nominal


@dataclass(frozen=True)
class Arm:
    """``train`` runs one draw. ``colour``: in pictures. ``extra``: on the first draws only."""

    train: Callable[[Hidden, int, Plan], Training]
    colour: str
    families: tuple[str, ...] = FAMILIES
    extra: bool = False
    available: Callable[[], bool] = lambda: True


def setup(hidden: Hidden, seed: int, plan: Plan, rows: int | None) -> Setup:
    """A run on the hidden robot from the nominal file, with a log of ``rows`` random transitions (None: no log)."""
    task = hidden.task
    assert task.mdp is not None
    mdp = task.mdp()
    log = None if rows is None else random_log(mdp, hidden.systems(), rows, seed)
    return Setup(task, mdp, hidden.systems(), nominal_model(task, threads=1), work(plan), seed, log)


def work(plan: Plan) -> Work:
    """Sizes of the mission's arms; a curve of one point, since it costs episodes."""
    return Work(transitions=plan.rows, seconds=plan.neural_seconds, points=1, mbpo=plan.mbpo, **plan.neural)


def loop_config(s: Setup, plan: Plan) -> LoopConfig:
    """The task's settings, with what the study changes; the log is as long as it is."""
    rows = plan.rows if s.log is None else len(s.log)
    config: LoopConfig = configure("loop", s.task, {"transitions": rows, **plan.loop[s.task.name]})
    return config


def fit_arm(hidden: Hidden, seed: int, plan: Plan, rows: int | None = None) -> Training:
    """The product's loop on the hidden robot's random log."""
    s = setup(hidden, seed, plan, rows or plan.rows)
    return _loop(s, loop_config(s, plan))


def on_policy_arm(hidden: Hidden, seed: int, plan: Plan) -> Training:
    """The loop with a second round: the policy acts, and everything is fitted again. Twice the updates."""
    s = setup(hidden, seed, plan, plan.rows)
    config = loop_config(s, plan)
    return _loop(s, replace(config, rounds=2, iterations=2 * config.iterations))


def _loop(s: Setup, config: LoopConfig) -> Training:
    return Training(s, config.iterations).run(
        lambda s: Loop(s.mdp, s.nominal, config, s.seed, system=s.system, data=s.log)
    )


def train_on(s: Setup, plan: Plan, make: Callable[[Setup], ComplementarityModel]) -> Training:
    """The loop's policies on the model that ``make`` gives, on the clock."""
    config = loop_config(s, plan)
    return Training(s, config.iterations).run(lambda s: GivenModel(s.mdp, make(s), config, s.seed, system=s.system))


def oracle_arm(hidden: Hidden, seed: int, plan: Plan) -> Training:
    """On the file that tells the truth, as far as a file can."""
    return train_on(setup(hidden, seed, plan, None), plan, lambda s: model_of(s, hidden.file_like))


def sysid_arm(hidden: Hidden, seed: int, plan: Plan) -> Training:
    """On the file that MuJoCo's own toolbox corrects from the same log, told which groups are wrong."""

    def make(s: Setup) -> ComplementarityModel:
        assert s.log is not None
        scene = s.nominal.scene
        fitted, _ = mujoco_sysid.identified(scene, s.log, scene.parameter_vector(), WRONG)
        return model_of(s, fitted.model)

    return train_on(setup(hidden, seed, plan, plan.rows), plan, make)


def neural_arm(hidden: Hidden, seed: int, plan: Plan, name: str) -> Training:
    """An arm of the mission on the same log."""
    s, arm = setup(hidden, seed, plan, plan.rows), MISSION[name]
    return Training(s, arm.iterations and arm.iterations(s)).run(arm.make)


def model_of(s: Setup, file: Any) -> ComplementarityModel:
    """The task's model of a compiled MuJoCo model."""
    return nominal_model(s.task, Scene.from_mjcf(file, contact_law=s.task.contact_law), threads=1)


def arms(plan: Plan) -> dict[str, Arm]:
    """Arms of a draw by name, in the order of tables and legends."""
    sizes = {
        f"fit of {rows:,}": Arm(partial(fit_arm, rows=rows), colour, (PARAMETERS,), True)
        for rows, colour in zip(plan.other_rows, ("#9ecae1", "#6baed6", "#2171b5"), strict=False)
    }
    return {
        FIT: Arm(fit_arm, "#08519c"),
        ORACLE: Arm(oracle_arm, "#238b45"),
        ON_POLICY: Arm(on_policy_arm, "#6a51a3", (OUTSIDE,)),
        SYSID: Arm(sysid_arm, "#d94801", (PARAMETERS,), available=mujoco_sysid.installed),
        **sizes,
        **{
            name: Arm(partial(neural_arm, name=name), MISSION[name].colour, (PARAMETERS,), True,
                      available=MISSION[name].available)
            for name in (MBPO_LOG, SHAC_NEURAL)
        },
    }  # fmt: skip
