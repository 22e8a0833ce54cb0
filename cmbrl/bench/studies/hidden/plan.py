"""What the study of hidden systems does, fixed before its first run: robots, families, draws, seeds, sizes.

The question and what would count as an answer are in ``text.toml``; the report begins with them. The loop has fewer
updates than its default (hopper 2,400 of 6,000, half-cheetah 2,400 of 3,000), so that all of it fits 16 core hours.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from cmbrl.hidden import task as hidden

SCENES = ("hopper", "cheetah")
FAMILIES, DRAW_SEED = hidden.FAMILIES, hidden.DRAW_SEED  #: the seed is of the hidden systems
PARAMETERS, PAYLOAD, FLOOR, OUTSIDE = FAMILIES
FIRST_SEED = 300  #: of training and logs; draw k takes FIRST_SEED + k. Settings were chosen on smaller ones
EPISODES, EPISODE_SEED = 10, 9_000  #: of every policy in every system: the same starts for all

UPSIDE_DOWN = 0.1  #: share of an episode with the torso beyond 90 degrees from which it counts as a fall
THRESHOLD = 0.1  #: share of falls in the model, over all trials, from which a policy is said to fall
FALLEN = 0.5  #: share of real episodes with a fall from which a policy counts as one that falls
GAP = 0.1  #: a draw's share of the way counts where oracle and nominal differ by so much of the larger return


@dataclass(frozen=True)
class Plan:
    """Sizes of the study; the mappings at the end change settings of algorithms."""

    draws: int = 10  #: of each family
    extra_draws: int = 4  #: of other log sizes and of the neural arms
    base_seeds: int = 3  #: of what is trained without data
    widths: tuple[float, ...] = (0.15, 0.3)  #: of domain randomisation
    rows: int = 1000  #: transitions of a log
    other_rows: tuple[int, ...] = (100, 300, 3000)
    repeats: int = 1  #: further seeds of fit and oracle on the first draw of each family
    episodes: int = EPISODES
    trials: int = 64  #: episodes in the model of each trial
    draws_of_fit: int = 256  #: parameter sets of a randomised model
    neural_seconds: Mapping[str, float] = field(default_factory=lambda: {"hopper": 240.0, "cheetah": 120.0})
    loop: Mapping[str, Mapping[str, Any]] = field(
        default_factory=lambda: {"hopper": {"iterations": 2400}, "cheetah": {"iterations": 2400}}
    )  #: scene -> changed settings of the loop
    neural: Mapping[str, Any] = field(default_factory=lambda: {"ensemble_updates": 2000, "neural_iterations": 600})
    mbpo: Mapping[str, Any] = field(default_factory=dict)


_QUICK_LOOP = {
    "iterations": 2, "policies": 2, "further": 0, "environments": 4, "horizon": 4, "draws": 4, "score_episodes": 2,
    "more": 20, "episode_steps": 20, "actor_hidden": (8,), "critic_hidden": (8,),
}  # fmt: skip
QUICK = Plan(
    draws=1, extra_draws=1, base_seeds=1, widths=(0.3,), rows=60, other_rows=(30,), repeats=0, episodes=2, trials=2,
    draws_of_fit=4, neural_seconds={"hopper": 1.0, "cheetah": 1.0}, loop={scene: _QUICK_LOOP for scene in SCENES},
    neural={"ensemble_updates": 20, "neural_iterations": 2},
    mbpo={"warmup": 60, "block": 10, "rollouts": 50, "fit_updates": 10, "refit_updates": 2, "hidden": (8, 8)},
)  # fmt: skip
