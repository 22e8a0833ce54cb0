"""A decision process in one system, the real one or a model of it, as a Gymnasium environment."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from cmbrl.envs.mdp import MDP
from cmbrl.envs.spaces import action_space, observation_space
from cmbrl.envs.system import System
from cmbrl.errors import UserError

try:
    import gymnasium
except ImportError:
    raise UserError("gymnasium is not installed: pip install 'cmbrl[tasks]'") from None


class MDPEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One episode at a time; actions are clipped to [-1, 1], rewards are without shaping.

    The time limit is the process's own, told as ``truncated``: no wrapper is needed. ``info`` holds what the process
    tells of a step, such as ``x_position`` and the parts of the reward. A state that is not finite terminates.

    Args:
        mdp, system: what is asked, and of whom.
        render_mode: None, or "rgb_array": ``render`` then returns a picture (height, width, 3).
        width, height: of pictures.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}  # noqa: RUF012  (the type is Gymnasium's)

    def __init__(
        self, mdp: MDP, system: System, render_mode: str | None = None, width: int = 480, height: int = 360
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise UserError(f"render_mode {render_mode!r}: use None or 'rgb_array'")
        self.mdp, self.system = mdp, system
        self.render_mode, self.width, self.height = render_mode, width, height
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": max(1, round(1 / mdp.dt))}
        self.observation_space, self.action_space = observation_space(mdp), action_space(mdp)
        self._q = self._v = torch.empty(0)
        self._age = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """A new episode; the same ``seed`` gives the same. No options."""
        super().reset(seed=seed)
        generator = torch.Generator().manual_seed(int(self.np_random.integers(2**63)))
        self._q, self._v = self.mdp.reset(1, generator)
        self.system.reset(self._q[0].numpy(), self._v[0].numpy())
        self._age = 0
        return self._observe(), {}

    @torch.no_grad()
    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Observation (n_o,), reward, terminated, truncated, info after an action (n_a,)."""
        if not self._q.numel():
            raise UserError("the episode has not begun: call reset()")
        a = torch.from_numpy(np.clip(action, -1.0, 1.0).astype(np.float64))[None]
        q, v, u = self.mdp.act(self._q, self._v, a)
        if not (torch.equal(q, self._q) and torch.equal(v, self._v)):
            self.system.reset(q[0].numpy(), v[0].numpy())
        for _ in range(self.mdp.repeat):
            state = self.system.step(u[0].numpy())
        q_next, v_next = (torch.from_numpy(x.copy())[None] for x in state)
        reward = self.mdp.reward(self._q, self._v, a, q_next, v_next).nan_to_num(0.0, 0.0, 0.0).item()
        info = {} if self.mdp.info is None else self.mdp.info(self._q, self._v, a, q_next, v_next)
        lost = not (torch.isfinite(q_next).all() and torch.isfinite(v_next).all())
        terminated = lost or bool(self.mdp.terminated(q_next, v_next))
        self._q, self._v = q_next, v_next
        self._age += 1
        truncated = self._age >= self.mdp.episode_steps and not terminated
        return self._observe(), reward, terminated, truncated, {name: x.item() for name, x in info.items()}

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """A picture (height, width, 3) uint8 of the present state; None without a render mode."""
        return self.system.render(self.width, self.height) if self.render_mode else None

    def _observe(self) -> np.ndarray:
        return self.mdp.observe(self._q, self._v)[0].nan_to_num(0.0, 0.0, 0.0).numpy()
