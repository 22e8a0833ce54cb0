"""Activations of a scene's actuators from one control step to the next; the core derives those within a step itself.

The controls of a step are commands (nu) and then the activations at its start (na). ``next`` tells those at its end:
what ``cmbrl.scene.forces.activation`` says, in every physics step, with commands and activations within their bounds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from cmbrl.scene import Scene
from cmbrl.scene.forces.activation import Dynamics

_LEAST = 1e-15  # s, MuJoCo's smallest time constant


@dataclass(frozen=True, eq=False)
class Activations:
    """``actuator`` (na,): whose they are. ``time`` (na,): time constants [s]; ``column`` (na,): in theta, or -1."""

    step: float
    substeps: int
    rk4: bool  # steps of RK4, which take the mean rate of four stages
    actuator: Tensor
    dynamics: tuple[Dynamics, ...]
    time: Tensor
    column: tuple[int, ...]
    control: tuple[Tensor, Tensor]
    limits: tuple[Tensor, Tensor]

    @classmethod
    def of(cls, scene: Scene, step: float, substeps: int, theta: np.ndarray, rk4: bool = False) -> Activations | None:
        """Those of ``scene`` in steps of ``substeps`` times ``step`` [s], at theta (np,); None if it has none."""
        core, layout = scene.core, scene.layout
        if not core.nstate:
            return None
        own = torch.from_numpy(core.state_act.astype(np.int64))
        index = {p.name: k for k, p in enumerate(scene.parameters)}
        names = [scene.actuator_names[k] for k in own.tolist()]
        column = tuple(index.get(f"time_constant.{name}", -1) for name in names)
        file = [core.P[layout.actuator(k, "time")] for k in own.tolist()]
        return cls(
            step,
            substeps,
            rk4,
            own,
            tuple(Dynamics(k) for k in core.state_kind.tolist()),
            torch.tensor([theta[c] if c >= 0 else x for c, x in zip(column, file, strict=True)], dtype=torch.float64),
            column,
            _bounds(core.act_ctrl[core.state_act]),
            _bounds(core.state_range),
        )

    def __len__(self) -> int:
        return len(self.dynamics)

    def next(self, controls: Tensor, theta: Tensor | None = None) -> Tensor:
        """Activations (B, na) after a step from ``controls`` (B, nu + na) at theta (np,) or (B, np); differentiable."""
        command = torch.clamp(controls[:, self.actuator], *self.control)
        now = controls[:, controls.shape[1] - len(self) :]
        integrates = torch.tensor([k == Dynamics.INTEGRATOR for k in self.dynamics])
        share = self._share(theta)
        for _ in range(self.substeps):
            moved = torch.where(integrates, self.step * command, share * (command - now))
            now = torch.clamp(now + moved, *self.limits)
        return now

    def along(self, episode: np.ndarray, control: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Controls (N, nu + na) of a log's rows ``control`` (N, nu), with their activations, as ``slopes_along``."""
        nothing = np.zeros((*control.shape, 0))
        return self.slopes_along(episode, control, nothing, times)[0]

    def slopes_along(
        self, episode: np.ndarray, control: np.ndarray, slope: np.ndarray, times: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Controls (N, nu + na) of a log's rows with their activations, 0 at the first row of an episode.

        control (N, nu), and its derivatives slope (N, nu, n) in psi, whose last columns are the time constants
        ``times`` (nt,); returns the derivatives (N, nu + na, n) too.
        """
        firsts = np.flatnonzero(np.r_[True, np.diff(episode) != 0])
        lengths = np.diff(np.append(firsts, len(episode)))
        own, nu, n = self.actuator.numpy(), control.shape[1], slope.shape[2]
        command = np.clip(control[:, own], *(bound.numpy() for bound in self.control))
        of_command = slope[:, own] * (command == control[:, own])[..., None]
        rows = np.concatenate([control, np.zeros((len(control), len(self)))], axis=1)
        slopes = np.concatenate([slope, np.zeros((len(slope), len(self), n))], axis=1)
        of_times = [k for k, c in enumerate(self.column) if c >= 0]
        clocks = np.arange(n - len(of_times), n)
        move = self._move(times)
        for step in range(lengths.max() - 1):
            here = firsts[lengths > step + 1] + step
            after, by_now, by_command, by_time = move(rows[here, nu:], command[here])
            rows[here + 1, nu:] = after
            if n:
                moved = by_now[..., None] * slopes[here, nu:] + by_command[..., None] * of_command[here]
                moved[:, of_times, clocks] += by_time[:, of_times]
                slopes[here + 1, nu:] = moved
        return rows, slopes

    def _move(self, times: np.ndarray) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, ...]]:
        """``next`` at the time constants ``times`` (nt,) that are parameters, for arrays, with its derivatives.

        From activations and commands within their bounds (B, na) to what follows, and what that gains with each of
        them and with the time constant.
        """
        theta = np.zeros(max(self.column) + 1)
        theta[[k for k in self.column if k >= 0]] = times
        clock = torch.from_numpy(theta).requires_grad_()
        shares = self._share(clock)
        share, by_clock = shares.detach().numpy(), np.zeros(len(self))
        for k, column in enumerate(self.column):
            if column >= 0:
                by_clock[k] = torch.autograd.grad(shares[k], clock, retain_graph=True)[0][column].item()
        integrates = np.array([k == Dynamics.INTEGRATOR for k in self.dynamics])
        share, by_clock = (np.where(integrates, 0.0, x) for x in (share, by_clock))
        step, substeps = self.step, self.substeps
        low, high = (bound.numpy() for bound in self.limits)
        if (share <= 1.0).all() and (low <= 0.0).all() and (high >= 0.0).all():
            # None passes its command on the way, nor a limit and back: one step is as good as all of them.
            left, step, substeps = (1.0 - share) ** (substeps - 1), substeps * step, 1
            share, by_clock = 1.0 - left * (1.0 - share), self.substeps * left * by_clock
        gain = np.where(integrates, step, share)

        def moved(now: np.ndarray, command: np.ndarray) -> tuple[np.ndarray, ...]:
            by_now, by_command, by_time = np.ones_like(now), np.zeros_like(now), np.zeros_like(now)
            for _ in range(substeps):
                after = now + gain * command - share * now
                by_time = (1.0 - share) * by_time + by_clock * (command - now)
                by_command = (1.0 - share) * by_command + gain
                now = np.clip(after, low, high)
                free = now == after
                by_now, by_command, by_time = free * (1.0 - share) * by_now, free * by_command, free * by_time
            return now, by_now, by_command, by_time

        return moved

    def _share(self, theta: Tensor | None) -> Tensor:
        """Of the way to the command that a filter goes in a physics step: (na,) or (B, na)."""
        time = self.time
        if theta is not None and max(self.column) >= 0:
            told = torch.tensor([k >= 0 for k in self.column])
            time = torch.where(told, theta[..., [max(k, 0) for k in self.column]], time)
        rate = self.step / time.clamp(min=_LEAST)
        exact = (Dynamics.FILTEREXACT,) if self.rk4 else (Dynamics.FILTEREXACT, Dynamics.FILTER_RK4)
        share = torch.where(torch.tensor([k in exact for k in self.dynamics]), -torch.expm1(-rate), rate)
        return share * _mean_rate(rate) if self.rk4 else share


def _mean_rate(rate: Tensor) -> Tensor:
    """Of the stages of an RK4 step, in parts of the first one's; ``rate`` is step over time constant."""
    second = 1.0 - 0.5 * rate
    third = 1.0 - 0.5 * rate * second
    return (1.0 + 2.0 * second + 2.0 * third + 1.0 - rate * third) / 6.0


def _bounds(pairs: np.ndarray) -> tuple[Tensor, Tensor]:
    low, high = torch.from_numpy(np.reshape(pairs, (-1, 2))).clone().T.contiguous()
    return low, high
