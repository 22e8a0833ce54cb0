"""Many episodes of a decision process as one Gymnasium vector environment; on a model, one native call per step."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from cmbrl.envs.drawing import Drawer
from cmbrl.envs.simulation import Simulation
from cmbrl.envs.spaces import action_space, check_render_mode, observation_space
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
    mask; what ``MDP.info`` gives is there by name (B,), of a simulation that tells it, and of steps that end an episode
    in ``infos["final_info"]``. Actions are clipped to [-1, 1]; rewards are without shaping; a row that is not finite
    terminates.

    Args:
        simulation: of all episodes.
        scene: path of the MJCF for pictures.
        render_mode: None, or "rgb_array": ``render`` then returns a picture (height, width, 3) of each episode.
        width, height: of pictures.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": ["rgb_array"]}  # noqa: RUF012

    def __init__(
        self,
        simulation: Simulation,
        scene: str = "",
        render_mode: str | None = None,
        width: int = 480,
        height: int = 360,
    ) -> None:
        check_render_mode(render_mode)
        self.simulation, self.scene = simulation, scene
        self.num_envs = simulation.count
        self.render_mode, self.width, self.height = render_mode, width, height
        self.metadata = {**self.metadata, "render_fps": max(1, round(1 / simulation.mdp.dt))}
        self.single_observation_space = observation_space(simulation.mdp)
        self.single_action_space = action_space(simulation.mdp)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._drawer: Drawer | None = None

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
        if tuple(action.shape) != self.action_space.shape:
            raise UserError(f"actions have shape {tuple(action.shape)}: give {self.action_space.shape}")
        step = self.simulation.step(self.simulation.observe(), action)
        reward = step.reward.nan_to_num(0.0, 0.0, 0.0).numpy()
        terminated, truncated = step.terminated.numpy(), step.truncated.numpy()
        done = terminated | truncated
        infos = _told(step.info, ~done)
        if not done.any():
            return step.next_observation.numpy(), reward, terminated, truncated, infos
        last = np.full(self.num_envs, None, dtype=object)
        for k in np.flatnonzero(done):
            last[k] = step.next_observation[k].nan_to_num(0.0, 0.0, 0.0).numpy()
        infos |= {"final_obs": last, "_final_obs": done}
        if step.info:
            infos |= {"final_info": _told(step.info, done), "_final_info": done}
        return self.simulation.observe().numpy(), reward, terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture (height, width, 3) uint8 of each episode's present state; None without a render mode."""
        if self.render_mode is None:
            return None
        if self._drawer is None:
            self._drawer = Drawer(self.scene, self.width, self.height)
        return tuple(self._drawer.draw(q).copy() for q in self.simulation.mdp.robot(self.simulation.q).numpy())

    def close_extras(self, **_: Any) -> None:
        """Frees the renderer."""
        if self._drawer is not None:
            self._drawer.close()
            self._drawer = None


def _told(info: dict[str, Tensor], rows: np.ndarray) -> dict[str, Any]:
    """``info`` (B,) of ``rows`` (B,) bool, and 0 elsewhere, with the masks that Gymnasium gives."""
    told = {name: np.where(rows, value.numpy(), 0.0) for name, value in info.items()}
    return told | {f"_{name}": rows.copy() for name in told}
