"""Episodes on a model or on real systems for Stable-Baselines3: its vector environment over our batched simulation.

>>> vec_env = VecMonitor(Sb3VecEnv(Simulation(task.mdp(), model, count=64)))  # on a model: a native call a step
>>> vec_env = VecMonitor(Sb3VecEnv(Simulation(task.mdp(), SystemBatch(task.system, 4), count=4)))  # real
>>> vec_env = VecMonitor(Sb3VecEnv(gymnasium.make_vec("cmbrl/Hopper-v0", num_envs=64)))  # as registered
>>> PPO("MlpPolicy", vec_env).learn(100_000)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from cmbrl.envs.simulation import Simulation
from cmbrl.envs.spaces import action_space, observation_space
from cmbrl.envs.vector_env import MDPVectorEnv
from cmbrl.errors import UserError

try:
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv
except ImportError:
    raise UserError("stable-baselines3 is not installed: pip install 'cmbrl[train]'") from None


class Sb3VecEnv(VecEnv):
    """All episodes of a simulation, or of one of our Gymnasium vector environments; each restarts when it ends.

    As SB3 expects, the step that ends an episode returns the new episode's observation. The old one's last observation
    is ``infos[k]["terminal_observation"]``, and ``infos[k]["TimeLimit.truncated"]`` tells a time limit from a
    termination. Rewards are without shaping. Raises UserError for an environment that is not ours.
    """

    def __init__(self, simulation: Simulation | MDPVectorEnv) -> None:
        self.simulation = _simulation(simulation)
        self.render_mode = None
        mdp = self.simulation.mdp
        super().__init__(self.simulation.count, observation_space(mdp), action_space(mdp))

    def reset(self) -> np.ndarray:
        """First observations (B, n_o) of new episodes, drawn by the seed last given to ``seed``, if any."""
        self.simulation.restart(self._seeds[0])
        self._reset_seeds()
        return self.simulation.observe().numpy()

    def step_async(self, actions: np.ndarray) -> None:
        """Takes actions (B, n_a), clipped to [-1, 1]."""
        self._actions = torch.from_numpy(np.clip(actions, -1.0, 1.0))

    @torch.no_grad()
    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Observations (B, n_o), rewards (B,), dones (B,), infos of the step."""
        step = self.simulation.step(self.simulation.observe(), self._actions)
        done = (step.terminated | step.truncated).numpy()
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]
        for k in np.flatnonzero(done):
            # A row that is not finite ends here; a replay buffer must not see it.
            last = np.nan_to_num(step.next_observation[k].numpy(), posinf=0.0, neginf=0.0)
            infos[k] = {"TimeLimit.truncated": bool(step.truncated[k]), "terminal_observation": last}
        reward = step.reward.nan_to_num(0.0, 0.0, 0.0).float().numpy()
        observation = self.simulation.observe() if done.any() else step.next_observation
        return observation.numpy(), reward, done, infos

    def close(self) -> None:
        """Nothing to free."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute, shared by all environments, once for each of ``indices``."""
        return [getattr(self, attr_name)] * len(self._get_indices(indices))  # type: ignore[arg-type]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Sets the attribute for all; raises UserError if ``indices`` are only some."""
        if len(self._get_indices(indices)) != self.num_envs:  # type: ignore[arg-type]
            raise UserError(f"{attr_name} is the same in all environments: set it for all")
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Raises UserError: the environments have no methods of their own."""
        raise UserError(f"no method {method_name!r}: the environments are rows of one simulation")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """No row is wrapped."""
        return [False] * len(self._get_indices(indices))  # type: ignore[arg-type]

    def get_images(self) -> Sequence[np.ndarray | None]:
        """No pictures."""
        return [None] * self.num_envs


def _simulation(given: object) -> Simulation:
    inner = getattr(given, "unwrapped", given)  # Gymnasium's wrappers around a vector environment
    if isinstance(inner, MDPVectorEnv):
        return inner.simulation
    if isinstance(inner, Simulation):
        return inner
    raise UserError(
        f"Sb3VecEnv takes a Simulation or cmbrl's own vector environment, not {type(given).__name__}: give "
        "gymnasium.make_vec('cmbrl/...'), or for others use stable_baselines3's make_vec_env"
    )
