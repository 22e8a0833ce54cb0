"""A decision process on a model or in the real system as a Gymnasium environment."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import torch

from cmbrl.envs.drawing import Drawer
from cmbrl.envs.spaces import action_space, check_render_mode, observation_space
from cmbrl.errors import UserError
from cmbrl.mdp import MDP
from cmbrl.models.between.robots import Robots
from cmbrl.models.native_step.result import SolverWarning
from cmbrl.models.protocol import Model, forget

try:
    import gymnasium
except ImportError:
    raise UserError("gymnasium is not installed: pip install 'cmbrl[tasks]'") from None


class MDPEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One episode at a time; actions are clipped to [-1, 1], rewards are without shaping.

    The process's time limit is reported as ``truncated``. ``info`` holds what ``MDP.info`` gives, such as
    ``x_position`` and the parts of the reward. A state that is not finite terminates.

    Args:
        mdp: the decision process.
        model: what moves it; for the real system, a :class:`cmbrl.envs.system_batch.SystemBatch` of one.
        scene: path of the MJCF for pictures.
        render_mode: None, or "rgb_array": ``render`` then returns a picture (height, width, 3).
        width, height: of pictures.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}  # noqa: RUF012  (the type is Gymnasium's)

    def __init__(
        self,
        mdp: MDP,
        model: Model,
        scene: str,
        render_mode: str | None = None,
        width: int = 480,
        height: int = 360,
    ) -> None:
        check_render_mode(render_mode)
        self.mdp, self.model, self.scene = mdp, model, scene
        self.render_mode, self.width, self.height = render_mode, width, height
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": max(1, round(1 / mdp.dt))}
        self.observation_space, self.action_space = observation_space(mdp), action_space(mdp)
        self._q = self._v = torch.empty(0)
        self._robot = Robots(model, 1)
        self._age = 0
        self._drawer: Drawer | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts an episode; the same ``seed`` gives the same one. No options."""
        super().reset(seed=seed)
        generator = torch.Generator().manual_seed(int(self.np_random.integers(2**63)))
        self._q, self._v = self.mdp.reset(1, generator)
        forget(self.model)
        self._robot = Robots(self.model, 1)
        self._age = 0
        return self._observe(), {}

    @torch.no_grad()
    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Observation (n_o,), reward, terminated, truncated, info after an action (n_a,)."""
        self._check_begun()
        a = torch.from_numpy(np.asarray(action, np.float64).clip(-1.0, 1.0)[None])
        if a.shape != (1, self.mdp.actions):
            raise UserError(f"the action has shape {tuple(a.shape[1:])}: give ({self.mdp.actions},)")
        q_next, v_next, u = self.mdp.act(self._q, self._v, a)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SolverWarning)  # counted in the model's ``failures``
            for _ in range(self.mdp.repeat):
                q_next, v_next = self.mdp.move(self._robot.step, q_next, v_next, u)
        score, info = self.mdp.score(self._q, self._v, a, q_next, v_next)
        reward = score.item()
        lost = not (_finite(q_next.numpy()) and _finite(v_next.numpy()))
        terminated = lost or bool(self.mdp.terminated(q_next, v_next))
        self._q, self._v = q_next, v_next
        self._age += 1
        truncated = not terminated and bool(self.mdp.out_of_time(q_next, v_next, self._age))
        told = {name: x.item() for name, x in info.items()}
        return self._observe(), reward if math.isfinite(reward) else 0.0, terminated, truncated, told

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """A picture (height, width, 3) uint8 of the current state; None without a render mode."""
        if self.render_mode is None:
            return None
        self._check_begun()
        if self._drawer is None:
            self._drawer = Drawer(self.scene, self.width, self.height)
        return self._drawer.draw(self.mdp.robot(self._q)[0].numpy())

    def close(self) -> None:
        """Frees the renderer."""
        if self._drawer is not None:
            self._drawer.close()
            self._drawer = None

    def _check_begun(self) -> None:
        if not self._q.numel():
            raise UserError("the episode has not begun: call reset()")

    def _observe(self) -> np.ndarray:
        row = self.mdp.observe(self._q, self._v).numpy()[0]
        return row.copy() if _finite(row) else np.nan_to_num(row, posinf=0.0, neginf=0.0)


def _finite(x: np.ndarray) -> bool:
    """Whether all of a few numbers are finite; Python's own test is faster than NumPy's on so few."""
    return all(map(math.isfinite, x.ravel().tolist()))
