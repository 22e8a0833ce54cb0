"""A step of a single environment as Gymnasium makes it, with its default wrappers: ours and Gymnasium's own robot."""

from __future__ import annotations

from typing import Any

import numpy as np

from cmbrl.bench.timing import Spread, Work, interleaved

PAIRS = {"hopper rk4": ("cmbrl/Hopper-v0", "Hopper-v5"), "cheetah": ("cmbrl/Cheetah-v0", "HalfCheetah-v5")}
STEPS = 200  #: in a turn; actions are zero, and an episode that ends starts again


def measure(scene: str, repeats: int, seed: int) -> dict[str, Any]:
    """Seconds per step of the two environments of one of ``PAIRS``, and their ratio by turn."""
    import gymnasium

    import cmbrl.envs.registration  # noqa: F401  (registers the ids)

    ids = PAIRS[scene]
    environments = [gymnasium.make(name) for name in ids]
    work: Work = {name: (_Episodes(env, seed), STEPS) for name, env in zip(ids, environments, strict=True)}
    seconds = interleaved(work, repeats)
    ours, theirs = (seconds[name] for name in ids)
    return {"ids": list(ids), "ours": Spread.of(ours), "theirs": Spread.of(theirs), "ratio": Spread.of(theirs / ours)}


class _Episodes:
    """Calling it takes ``STEPS`` steps from the same initial state, the time of resets included."""

    def __init__(self, env: Any, seed: int) -> None:
        self.env, self.seed = env, seed
        self.action = np.zeros(env.action_space.shape, env.action_space.dtype)

    def __call__(self) -> None:
        self.env.reset(seed=self.seed)
        for _ in range(STEPS):
            *_, terminated, truncated, _ = self.env.step(self.action)
            if terminated or truncated:
                self.env.reset()
