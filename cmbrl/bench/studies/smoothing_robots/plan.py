"""What the study does, fixed before its first judged run: scenes, learners, settings tried, seeds, sizes, verdicts.

The question and what counts as an answer are in ``text.toml``; the report begins with them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product
from typing import Any

from cmbrl.bench.studies.smoothing.plan import CONSTANT, GAUSSIAN, HARD, PUBLISHED, Arm


@dataclass(frozen=True)
class Learner:
    """A task and the algorithm that learns it, with the settings that are not its recipe's."""

    task: str
    algorithm: str
    rate: str  #: the setting that is the rate of Adam
    settings: dict[str, Any] = field(default_factory=dict)


UNCUT = {"tame": 1e9}  # SHAC as published: no gradient of a single sample is cut
SCENES = {f"{task} fopg": Learner(task, "fopg", "rate") for task in ("cheetah_dojo", "hopper_dojo")} | {
    f"{task} shac": Learner(task, "shac", "actor_rate", UNCUT)
    for task in ("cheetah_dojo", "hopper_dojo", "cheetah", "hopper")
}
RATE = 2e-3  #: of Adam, but for the last rung


@dataclass(frozen=True)
class Size:
    """Of a training: updates of the policy, and how often on the way it is tried."""

    updates: int
    points: int = 10


def settings() -> dict[str, list[Arm]]:
    """Family -> what is tried of it."""
    constants = [f"barrier:kappa=1e{k}" for k in range(-6, 1)]
    gaussians = [
        f"{kind}:length={x}" for x, kind in product(("3e-5", "1e-4", "3e-4", "1e-3"), ("gaussian", "gaussian-stopped"))
    ]
    published = [f"abs:peak={peak},reach={reach}" for peak, reach in product(("1e-4", "1e-2", "1"), ("1e-2", "1e-1"))]
    soft = {CONSTANT: constants, GAUSSIAN: gaussians, PUBLISHED: published}
    return {HARD: [Arm("exact", rate=RATE)]} | {
        family: [Arm(softening, both, RATE) for both, softening in product((False, True), names)]
        for family, names in soft.items()
    }


@dataclass(frozen=True)
class Plan:
    """Sizes of the study of one scene; as those of :class:`cmbrl.bench.studies.smoothing.plan.Plan`.

    ``timed``: updates that tell what one
    costs.
    """

    tasks: tuple[str, ...]
    tried: dict[str, list[Arm]] = field(default_factory=settings)
    rungs: tuple[Size, ...] = (Size(40, 1), Size(100, 1))
    keep: int = 5
    rates: tuple[float, ...] = (2e-3, 5e-3)
    choosing: tuple[int, ...] = (110, 111, 112)  #: seeds
    judged: Size = field(default_factory=lambda: Size(300))
    seeds: tuple[int, ...] = tuple(range(300, 310))  #: fresh
    longer: int = 600
    longer_seeds: int = 3
    timed: Size = field(default_factory=lambda: Size(20, 1))
    turns: int = 3
    episodes: int = 16  #: of a trial


def plan_of(scene: str, quick: bool) -> Plan:
    """The scene's plan."""
    if not quick:
        return Plan((scene,))
    return Plan(
        (scene,),
        tried={HARD: [Arm("exact", rate=RATE)], CONSTANT: [Arm("barrier:kappa=1e-2", rate=RATE)],
               GAUSSIAN: [Arm("gaussian:length=1e-3", rate=RATE)],
               PUBLISHED: [Arm("abs:peak=1e-2,reach=1e-2", rate=RATE)]},
        rungs=(Size(1, 1), Size(2, 1)), rates=(RATE,), choosing=(100,), judged=Size(4, 2), seeds=(200, 201, 202),
        longer=6, longer_seeds=1, timed=Size(1, 1), turns=1, episodes=2,
    )  # fmt: skip
