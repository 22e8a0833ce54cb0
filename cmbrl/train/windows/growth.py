"""How far derivatives through a task's model reach: over long windows those of a chaotic robot grow into noise.

And how fast what moves along a line does: noise that a legged robot hardly feels throws a ball off its table.

Measured before a training, under random actions in the task's nominal model. Each velocity is in units of its spread
over that motion: a ball that rolls turns by 50 rad/s per m/s, and nothing grows. The median over episodes of the norm
of a derivative varies little with the seed, and tells robots apart: over 32 steps of 8 ms it is 1.0 to 1.1 for
Gymnasium's hopper and 4 to 5 for its walker; over 10 steps of 50 ms .4 for the half-cheetah and about 30 for the ant.
"""

from __future__ import annotations

import warnings

import torch
from torch import Tensor

from cmbrl.mdp import MDP
from cmbrl.models.between.robots import Robots
from cmbrl.models.native_step.result import SolverWarning
from cmbrl.models.protocol import HasCoordinates, Model, failures

EPISODES, NOISE = 128, 0.37  # side by side; standard deviation of actions, SHAC's at its start
LEAST = 1e-3  # of the largest spread: what hardly moves has no unit of its own
SETTLE = 0.4  # s of motion before it is measured: a reset is often in the air


def random_motion(mdp: MDP, model: Model, steps: int, seed: int = 0) -> RandomMotion:
    """That of many episodes in so many control steps; warns SolverWarning once, where solves of it fail."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SolverWarning)  # one for every step
        motion = RandomMotion(mdp, model, steps, seed)
    if failed := failures(model):
        warnings.warn(
            f"{failed} contact solves of {EPISODES} episodes under random actions did not converge: try other starts "
            "(MDP.reset)",
            SolverWarning,
            stacklevel=2,
        )
    return motion


class RandomMotion:
    """Random motion of many episodes, kept to be differentiated; they go on whether they have failed or not.

    ``spread`` (nv,): standard deviation of each velocity [m/s, rad/s], at least LEAST of the largest.
    """

    def __init__(self, mdp: MDP, model: Model, steps: int, seed: int) -> None:
        self.mdp, self.model, self.robots = mdp, model, Robots(model, EPISODES)
        self.generator = torch.Generator().manual_seed(seed)
        q, v = mdp.reset(EPISODES, self.generator)
        with torch.no_grad():
            for _ in range(round(SETTLE / mdp.dt)):
                q, v = self._step(q, v)
        self.start = v.requires_grad_()
        v = self.start
        self.velocities: list[Tensor] = []
        for _ in range(steps):
            q, v = self._step(q, v)
            self.velocities.append(v)
        seen = torch.cat([self.start, *self.velocities]).detach()
        spread = seen[seen.isfinite().all(dim=1)].std(dim=0).nan_to_num(1.0)
        self.spread = spread.clamp_min(LEAST * float(spread.max())).clamp_min(torch.finfo(spread.dtype).tiny)

    @property
    def fastest_slide(self) -> float:
        """The largest spread of a linear velocity [m/s]; infinite where the model has none, or does not tell them."""
        if not isinstance(self.model, HasCoordinates) or not len(slides := list(self.model.coordinates.slides_v)):
            return torch.inf
        return float(self.spread[slides].max())

    def steady_steps(self, growth: float) -> int:
        """The most control steps, up to all, over which derivatives of velocities grow at most ``growth`` times.

        That is the norm of the derivative of a random direction of the velocity in the velocity at the start, both in
        units of their spread, in the median of episodes. It is taken as growing with time.
        """
        most = len(self.velocities)
        if self.growth(most) <= growth:
            return most
        low, high = 1, most  # the window may be low, and not high
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if self.growth(middle) <= growth else (low, middle)
        return low

    def growth(self, steps: int) -> float:
        """Median norm of the derivative of a unit direction of the velocity after ``steps`` in that at the start."""
        after = self.velocities[steps - 1]
        direction = torch.randn(after.shape, generator=self.generator, dtype=after.dtype)
        along = (after / self.spread * direction / direction.norm(dim=1, keepdim=True)).sum()
        (derivative,) = torch.autograd.grad(along, self.start, retain_graph=True)
        return float((derivative * self.spread).norm(dim=1).nan_to_num(torch.inf).median())

    def _step(self, q: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        noise = torch.randn(EPISODES, self.mdp.actions, generator=self.generator, dtype=torch.float64)
        q, v, u = self.mdp.act(q, v, torch.tanh(NOISE * noise))
        for _ in range(self.mdp.repeat):
            q, v = self.mdp.move(self.robots.step, q, v, u)
        return q, v
