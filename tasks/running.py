"""What the decision processes of Gymnasium's running robots share.

q begins with x; in the plane it is x, z, pitch and the joints' angles, v its rates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from cmbrl.mdp import Total, inside, uniform

Test = Callable[[Tensor, Tensor], Tensor]
Reset = Callable[[int, torch.Generator], tuple[Tensor, Tensor]]
SLOPE = 50.0  # of training barriers, per m and per rad: our choice


def reward(dt: float, cost: float, healthy: Test | None = None) -> Total:
    """Forward speed, minus ``cost`` times |action|^2, plus 1 where ``healthy``; with what Gymnasium reports of a step.

    By name (B,): x [m], its rate [m/s], and the parts of the reward.
    """

    def info(q: Tensor, v: Tensor, action: Tensor, q_next: Tensor, v_next: Tensor) -> dict[str, Tensor]:
        x = q_next[:, 0]
        speed = (x - q[:, 0]) / dt
        told = {"x_position": x, "x_velocity": speed}
        if healthy is not None:
            told["reward_survive"] = healthy(q_next, v_next).double()
        return told | {"reward_forward": speed, "reward_ctrl": -cost * action.square().sum(dim=1)}

    parts = ("reward_forward", "reward_ctrl")
    return Total(info, parts if healthy is None else ("reward_survive", *parts))


def observe_clipped(q: Tensor, v: Tensor) -> Tensor:
    """(B, nq - 1 + nv): all of q but x, velocities clipped at +-10."""
    return torch.cat([q[:, 1:], v.clamp(-10.0, 10.0)], dim=1)


def barrier(height: float, pitch: float) -> Test:
    """Training's: (B,), falls where a planar robot is below ``height`` [m], or tilted by more than ``pitch`` [rad]."""

    def of_state(q: Tensor, v: Tensor) -> Tensor:
        return -SLOPE * ((q[:, 2].abs() - pitch).clamp(min=0.0) + (height - q[:, 1]).clamp(min=0.0))

    return of_state


def upright(start: Sequence[float], bottom: Tensor, top: Tensor, noise: float = 5e-3) -> tuple[Test, Test, Reset]:
    """(healthy, terminated, reset) of a planar robot that falls.

    It is healthy where ``bottom`` < (q, v) < ``top``, each (nq + nv,), and not where a state is not finite. A reset
    puts it at rest at ``start`` (nq,), each coordinate and velocity off by up to ``noise``.
    """

    def healthy(q: Tensor, v: Tensor) -> Tensor:
        return inside(q, v, bottom, top)

    def terminated(q: Tensor, v: Tensor) -> Tensor:
        return ~healthy(q, v)

    def reset(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        at = torch.tensor(start, dtype=torch.float64)
        return at + uniform(count, len(at), noise, generator), uniform(count, len(at), noise, generator)

    return healthy, terminated, reset
