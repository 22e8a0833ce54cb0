"""An algorithm's settings for a task: what the task gives in ``Task.training``, and a derived recipe for the rest.

Settings are looked up in four places, the later ones winning: the defaults of the algorithm's dataclass, the recipe
below, ``Task.training``, and the caller's changes (``--set``). Nothing depends on the task's name.

The rules were chosen so that one set of numbers gives both settings that were tuned by hand, those of the hopper (8 ms
control steps) and of the half-cheetah (50 ms): a window of 32 and of 10 steps, 64 and 256 episodes, a discount of .995
and of .99. How fast derivatives grow is measured on the task's nominal model (`cmbrl.train.windows.growth`): it
shortens the windows of the walker to 9 steps and of the ant to 4. With the lengths of hopper and half-cheetah both
learn far more slowly: one seed each, the walker earned 850 in training after 650 updates of 32 steps and 1,470 after as
many of 8, the ant, in 200 steps, 90 after 225 updates of 10 steps and 440 after as many of 5.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from cmbrl.envs.of_task import decision_process
from cmbrl.mdp import MDP
from cmbrl.registry import Task
from cmbrl.settings import check_settings
from cmbrl.train.algorithms import algorithm

Settings = dict[str, Any]

# Windows: long enough to see what an action leads to, short enough that gradients do not explode in contacts. Below 10
# steps everything is left to the critic; beyond 32, noise and cost grow without a gain.
WINDOW, WINDOW_STEPS = 0.35, (10, 32)  # s, control steps
# Of SHAC, where derivatives grow: no longer than they take to grow so much, which leaves more to the critic.
GROWTH, SHORTEST = 1.45, 4  # times, control steps
# Discount 1 - 1/n: rewards count for n control steps, about 2.5 s of a robot's balance or gait.
MEMORY, MEMORY_STEPS = 2.5, (100, 200)  # s, control steps
# An update sees about 2,048 control steps, whatever their duration: that fixes the noise of its gradient.
ROWS, ENVIRONMENTS = 2048, (16, 256)
# Restarts show states near the start again to a policy that got stuck, such as a robot on its back. Episodes begin
# short, so that it learns first to move on from the start: half-cheetahs else fall and learn to run on their backs.
EPISODE = (2.5, 10.0)  # s, at the start and from half of the updates on
# No robot slides quite by a law, and a policy that meets one alone may lean on what only it does: over ten seeds each,
# half-cheetahs and hoppers that met both laws earned more in MuJoCo, and none fell (docs/results, "Both laws").
OTHER_LAW = 0.5  # share of the episodes
# Velocity noise as random pushes of one intensity: its variance grows with the duration of a step.
LINEAR, ANGULAR = 0.34, 1.1  # m/s and rad/s per square root of a second
# Less of it on linear velocities where these are small, times the largest spread under random actions. Most legged
# robots reach .2 m/s, and keep all; a ball on a table that tilts reaches .1, and a policy learned nothing under .34.
# But what nothing touches yet tells no speed: hence no less than a share.
CALM, FAINTEST = 2.0, 0.1  # per square root of a second; of LINEAR
# Nets: the first layer has at least four units per observation and action.
UNITS, WIDTH = 4, (128, 512)
# Rollouts of a neural model: its error grows with their duration.
ROLLOUT = 0.12  # s


def configure(name: str, task: Task, changes: Mapping[str, Any] | None = None) -> Any:
    """The settings of the algorithm ``name`` for ``task``, with ``changes``: an object of the algorithm's dataclass.

    Raises UserError for an unknown algorithm, a task without ``mdp``, and settings (in ``Task.training`` or
    ``changes``) that do not exist or are out of bounds.
    """
    chosen = algorithm(name)
    config = chosen.load()[1]
    for known in task.training:
        algorithm(known, where=f"task {task.name!r}: training")
    given: Settings = {}
    if chosen.base is not None:  # but not the length of a run, which is the algorithm's own
        given |= {k: v for k, v in task.training.get(chosen.base, {}).items() if k != "iterations"}
    given |= task.training.get(name, {})
    check_settings(config, given, f"task {task.name!r}: training[{name!r}]")
    check_settings(config, changes or {}, name)
    if "iterations" in (changes or {}) and "again" in given:
        given["again"] = 0  # a run that was given its length has it
    given |= changes or {}
    settings = RECIPES.get(name, _none)(decision_process(task))
    if chosen.measures and not {"window", "horizon"} & given.keys():
        settings |= measured(task, settings)
    return replace(config(), **settings | given)


def window(mdp: MDP) -> Settings:
    """Of a learner on windows: what follows from the control step and the sizes of observation and action."""
    steps = min(_within(WINDOW / mdp.dt, WINDOW_STEPS), mdp.episode_steps)
    first, last = (min(mdp.episode_steps, max(1, round(duration / mdp.dt))) for duration in EPISODE)
    found = {
        "window": steps * mdp.dt,
        "discount": 1.0 - 1.0 / _within(MEMORY / mdp.dt, MEMORY_STEPS),
        "episode_steps": last,
        "other_law": OTHER_LAW,
    }
    return found if mdp.curriculum else found | {"episode_steps_start": first}


def shac(mdp: MDP) -> Settings:
    """Of SHAC, and of the loop that trains by it."""
    found = window(mdp)
    width = _within(_power_of_two(UNITS * (mdp.observations + mdp.actions), math.ceil), WIDTH)
    return found | {
        "environments": environments(mdp, found["window"]),
        "noise_linear": LINEAR * math.sqrt(mdp.dt),
        "noise_angular": ANGULAR * math.sqrt(mdp.dt),
        "actor_hidden": (width, width // 2),
        "critic_hidden": (width // 2, width // 2),
    }


def environments(mdp: MDP, window: float) -> int:
    """Episodes side by side in windows of this length [s]."""
    return _within(_power_of_two(ROWS * mdp.dt / window, round), ENVIRONMENTS)


def measured(task: Task, settings: Settings) -> Settings:
    """What random motion of the task's nominal model changes in the ``settings`` of SHAC.

    Windows end where derivatives grow, and noise is in proportion to what moves slowly.
    """
    from cmbrl.models.named import nominal_model
    from cmbrl.train.windows.growth import random_motion

    mdp = decision_process(task)
    most = round(settings["window"] / mdp.dt)
    if most <= SHORTEST:
        return {}
    motion = random_motion(mdp, nominal_model(task, threads=1), most)
    steps = max(SHORTEST, motion.steady_steps(GROWTH))
    noise = min(LINEAR, max(FAINTEST * LINEAR, CALM * motion.fastest_slide)) * math.sqrt(mdp.dt)
    return {"window": steps * mdp.dt, "environments": environments(mdp, steps * mdp.dt), "noise_linear": noise}


def mbpo(mdp: MDP) -> Settings:
    """Of MBPO: the length of imagined rollouts, and an entropy for each action as its authors chose it."""
    return {"length_end": max(1, round(ROLLOUT / mdp.dt)), "target_entropy": -0.5 * mdp.actions}


def _none(mdp: MDP) -> Settings:
    """Model-free algorithms keep their library's defaults, which count steps."""
    return {}


RECIPES: dict[str, Callable[[MDP], Settings]] = {"shac": shac, "loop": shac, "fopg": window, "mbpo": mbpo}


def _within(x: float, bounds: tuple[int, int]) -> int:
    return min(max(round(x), bounds[0]), bounds[1])


def _power_of_two(x: float, rounded: Callable[[float], int]) -> int:
    return 1 << max(0, rounded(math.log2(x)))
