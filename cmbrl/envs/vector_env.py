"""Many episodes of a decision process as one Gymnasium vector environment; on a model, one native call per step."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from cmbrl.envs.simulation import Simulation
from cmbrl.envs.spaces import action_space, observation_space
from cmbrl.errors import UserError

try:
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError:
    raise UserError("gymnasium is not installed: pip install 'cmbrl[tasks]'") from None


class MDPVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """All episodes of a simulation; autoreset mode SAME_STEP.

    The step that ends an episode returns the first observation of the next one. As in Gymnasium's own vector
    environments, ``infos["final_obs"][k]`` is the old episode's last observation, and ``infos["_final_obs"]`` their
    mask. Actions are clipped to [-1, 1]; rewards are without shaping; a row that is not finite terminates.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.num_envs = simulation.count
        self.render_mode = None
        self.single_observation_space = observation_space(simulation.mdp)
        self.single_action_space = action_space(simulation.mdp)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts new episodes in all rows, (B, n_o); the same ``seed`` gives the same ones. No options."""
        super().reset(seed=seed)
        self.simulation.restart(int(self.np_random.integers(2**63)))
        return self.simulation.observe().numpy(), {}

    @torch.no_grad()
    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Observations (B, n_o), rewards, terminated, truncated (B,) and infos after actions (B, n_a)."""
        action = torch.from_numpy(np.clip(actions, -1.0, 1.0).astype(np.float64))
        step = self.simulation.step(self.simulation.observe(), action)
        reward = step.reward.nan_to_num(0.0, 0.0, 0.0).numpy()
        terminated, truncated = step.terminated.numpy(), step.truncated.numpy()
        done = terminated | truncated
        if not done.any():
            return step.next_observation.numpy(), reward, terminated, truncated, {}
        last = np.full(self.num_envs, None, dtype=object)
        for k in np.flatnonzero(done):
            last[k] = step.next_observation[k].nan_to_num(0.0, 0.0, 0.0).numpy()
        infos = {"final_obs": last, "_final_obs": done}
        return self.simulation.observe().numpy(), reward, terminated, truncated, infos
