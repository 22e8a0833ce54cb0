"""Bundled Contact Gradients (BCG): near stiff contact, a few perturbed branches are stepped side by side and averaged.

Aditya et al., "Bundled Contact Gradients" (arXiv 2609.30951), after their project page; no code was released. Where a
contact carries more than ``trigger``, B branches start at offsets of the contacting chains and share the action; their
mean is the next state. Its sensitivities are the mean of the branches', with the offsets taken as constants.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cmbrl.errors import UserError
from cmbrl.gradients.offsets import ContactOffsets
from cmbrl.models.around import Around
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.manifold import Coordinates
from cmbrl.models.native_step.result import SolverWarning


@dataclass(frozen=True)
class BundleConfig:
    """Defaults are the paper's, except for duration and trigger.

    A bundle lasts ``duration`` (the paper: 40 ms), but at least two control steps: over a single one, branches would
    only be averaged where they start. ``length`` gives it in control steps instead.
    """

    branches: int = 10
    length: int | None = None  #: control steps of a bundle; overrides duration
    trigger: float | None = None
    """Normal force, mean over a control step, that starts a bundle [N]. None: 1.2 times the scene's weight, the same
    ratio as the paper's 400 N for its robot."""
    position: float = 0.01  #: standard deviation of each Cartesian component [m]
    velocity: float = 0.02  #: [m/s]
    damping: float = 1e-4  #: of the pseudo-inverse
    duration: float = 0.016  #: of a bundle [s]

    def steps(self, dt: float) -> int:
        """Control steps of ``dt`` [s] in a bundle."""
        return max(2, round(self.duration / dt)) if self.length is None else self.length


@dataclass(frozen=True)
class _Branches:
    """Running bundles: rows (R,) of the batch, control steps left (R,), branch states (R, B, ...), which of them are
    alive (R, B), and the mean state (R, ...) that the last step returned."""

    rows: Tensor
    left: Tensor
    q: Tensor
    v: Tensor
    alive: Tensor
    mean_q: Tensor
    mean_v: Tensor

    def select(self, keep: Tensor) -> _Branches | None:
        fields = (self.rows, self.left, self.q, self.v, self.alive, self.mean_q, self.mean_v)
        return _Branches(*(x[keep] for x in fields)) if keep.any() else None


class BundledContactModel(Around):
    """``model`` with contact-triggered bundles: a ``Model`` with a memory.

    Between steps it keeps the branches of every row of the batch. If a row's position is not the one that the last step
    returned, it has been restarted and its bundle is dropped. A change of the velocity is passed on to the branches.
    Bundles are also dropped where the graph has been cut. A row costs one step; a row that starts a bundle 1 + B (a
    plain step finds the force); a row that continues one B. ``lost`` counts broken branches, ``steps`` model steps.

    Raises UserError for fewer than one branch or step, a duration that is not positive, or negative noise or damping.
    """

    def __init__(self, model: ComplementarityModel, config: BundleConfig | None = None, seed: int = 0) -> None:
        c = self.config = config or BundleConfig()
        self.length = c.steps(model.dt) if c.duration > 0 else 0  #: of a bundle, in control steps
        if min(c.branches, self.length) < 1 or min(c.position, c.velocity) < 0 or not c.damping > 0:
            raise UserError(f"{c}: give at least one branch and step, no negative noise, and some damping")
        weight = 9.81 * model.scene.total_mass
        self.trigger = 1.2 * weight if c.trigger is None else c.trigger
        self.model, self.coordinates = model, Coordinates.from_scene(model.scene)
        self.offsets = ContactOffsets(model, c.position, c.velocity, c.damping)
        self.steps = self.bundles = self.lost = 0
        self._rng = np.random.default_rng(seed)
        self._kept: _Branches | None = None

    @property
    def name(self) -> str:
        """The model's name with the size of the bundle."""
        return f"{self.model.name}, BCG of {self.config.branches}"

    def forget(self) -> None:
        """Drops all running bundles."""
        self._kept = None

    def state(self) -> dict[str, Any]:
        """What the next step depends on after bundles are dropped."""
        return {"rng": self._rng.bit_generator.state, "counts": [self.steps, self.bundles, self.lost]}

    def restore(self, state: dict[str, Any]) -> None:
        """Continues from what ``state`` returned."""
        self.forget()
        self._rng.bit_generator.state = state["rng"]
        self.steps, self.bundles, self.lost = state["counts"]

    def step(self, q: Tensor, v: Tensor, u: Tensor, theta: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """(q', v') of shapes (B, nq), (B, nv), float64; differentiable in q, v, u and parameters theta.

        A row is NaN if none of its branches stays finite.
        """
        kept = self._follow(q, v)
        single = torch.ones(len(q), dtype=torch.bool)
        if kept:
            single[kept.rows] = False
        free = single.nonzero()[:, 0]
        details: dict[str, np.ndarray] = {}
        q_next, v_next = self._model_step(q[free], v[free], u[free], _rows(theta, free), details)
        started = self._start(q, v, theta, free, details["impulse"][..., 0] / self.dt)
        parts = [part for part in (kept, started) if part]
        if not parts:
            self._kept = None
            return q_next, v_next
        bundle = self._advance(_joined(parts), u, theta)
        self._kept = bundle.select((bundle.left > 0) & bundle.alive.any(dim=1))
        plain = torch.ones(len(free), dtype=torch.bool)
        if started:
            plain[torch.isin(free, started.rows)] = False
        rows = torch.cat([free[plain], bundle.rows])
        order = torch.argsort(rows)
        return (
            torch.cat([q_next[plain], bundle.mean_q])[order],
            torch.cat([v_next[plain], bundle.mean_v])[order],
        )

    def _follow(self, q: Tensor, v: Tensor) -> _Branches | None:
        """Branches of the rows that continue where the last step left them, moved with the velocity."""
        kept = self._kept
        if kept is None or int(kept.rows.max()) >= len(q) or (kept.q.requires_grad and not q.requires_grad):
            return None
        kept = kept.select((q[kept.rows] == kept.mean_q).all(dim=1))
        if kept is None:
            return None
        pull_q, pull_v = (q[kept.rows] - kept.mean_q)[:, None], (v[kept.rows] - kept.mean_v)[:, None]
        return replace(kept, q=kept.q + pull_q, v=kept.v + pull_v)  # pull_q is zero: it carries the gradient

    def _start(self, q: Tensor, v: Tensor, theta: Tensor | None, free: Tensor, force: np.ndarray) -> _Branches | None:
        """Branches of the rows in ``free`` in which a contact carries more than the trigger; force (R, nc)."""
        load = np.where(force > self.trigger, force, 0.0)
        found = np.flatnonzero(load.any(axis=1)) if load.size else np.empty(0, dtype=int)
        if not len(found):
            return None
        rows, count = free[torch.from_numpy(found)], self.config.branches
        here = (q[rows].detach().numpy(), v[rows].detach().numpy())
        parameters = _rows(theta, rows)
        theta_array = None if parameters is None else parameters.detach().numpy()
        dq, dv = self.offsets.draw(*here, load[found], theta_array, count, self._rng)
        spread_q = q[rows][:, None].expand(-1, count, -1)
        self.bundles += len(rows)
        return _Branches(
            rows, torch.full_like(rows, self.length), self.coordinates.integrate(spread_q, torch.from_numpy(dq)),
            v[rows][:, None] + torch.from_numpy(dv), torch.ones(len(rows), count, dtype=torch.bool), q[rows], v[rows],
        )  # fmt: skip

    def _advance(self, b: _Branches, u: Tensor, theta: Tensor | None) -> _Branches:
        """One control step of all branches, and their mean."""
        bundles, count = b.alive.shape
        shared = u[b.rows][:, None].expand(-1, count, -1)
        parameters = _rows(theta, b.rows)
        if parameters is not None and parameters.ndim == 2:
            parameters = parameters.repeat_interleave(count, dim=0)
        states = [
            torch.where(b.alive[..., None], x, m.detach()[:, None]) for x, m in ((b.q, b.mean_q), (b.v, b.mean_v))
        ]
        inputs = [x.flatten(0, 1) for x in (*states, shared)]
        finite = torch.ones(bundles * count, dtype=torch.bool)
        for x in inputs:
            if x.requires_grad:  # a lost branch has a zero message; its broken derivative would turn it into NaN
                x.register_hook(lambda g: torch.where(finite[:, None], g, 0.0))
        q, v = self._model_step(inputs[0], inputs[1], inputs[2], parameters)
        finite &= torch.isfinite(q.detach()).all(dim=1) & torch.isfinite(v.detach()).all(dim=1)
        q, v = q.unflatten(0, (bundles, count)), v.unflatten(0, (bundles, count))
        alive = b.alive & finite.view(bundles, count)
        self.lost += int((b.alive & ~alive).sum())
        mean_q, mean_v = mean_state(self.coordinates, q, v, alive)
        return _Branches(b.rows, b.left - 1, q, v, alive, mean_q, mean_v)

    def _model_step(
        self, q: Tensor, v: Tensor, u: Tensor, theta: Tensor | None, details: dict[str, np.ndarray] | None = None
    ) -> tuple[Tensor, Tensor]:
        self.steps += len(q)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SolverWarning)  # counted in ``failures``
            return self.model.step(q, v, u, theta, details)


def mean_state(coordinates: Coordinates, q: Tensor, v: Tensor, alive: Tensor) -> tuple[Tensor, Tensor]:
    """(R, nq), (R, nv): arithmetic mean of the living branches (R, B, ...), alive (R, B); NaN where none is.

    Quaternions are brought to the sign of the first branch alive, averaged, and made unit again.
    """
    mask = alive[..., None]
    share = torch.where(mask, 1.0 / alive.sum(dim=1)[:, None, None].double(), 0.0)
    share = torch.where(alive.any(dim=1)[:, None, None], share, torch.nan)
    q, v = torch.where(mask, q, 0.0), torch.where(mask, v, 0.0)
    mean_v = (share * v).sum(dim=1)
    first = alive.int().argmax(dim=1)
    weights = share.expand_as(q).clone()
    for a in coordinates.ball_q:
        quaternion = q[..., a : a + 4].detach()
        reference = quaternion[torch.arange(len(q)), first][:, None]
        weights[..., a : a + 4] *= torch.where((quaternion * reference).sum(dim=-1, keepdim=True) < 0, -1.0, 1.0)
    mean_q = (weights * q).sum(dim=1)
    for a in coordinates.ball_q:
        length = mean_q[:, a : a + 4].norm(dim=1, keepdim=True)
        mean_q = torch.cat([mean_q[:, :a], mean_q[:, a : a + 4] / length, mean_q[:, a + 4 :]], dim=1)
    return mean_q, mean_v


def _rows(theta: Tensor | None, rows: Tensor) -> Tensor | None:
    """Parameters of some rows; one vector (np,) is shared by all."""
    return theta if theta is None or theta.ndim == 1 else theta[rows]


def _joined(parts: list[_Branches]) -> _Branches:
    names = ("rows", "left", "q", "v", "alive", "mean_q", "mean_v")
    return _Branches(*(torch.cat([getattr(part, name) for part in parts]) for name in names))
