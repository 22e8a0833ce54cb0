"""A scene whose derivative is known in closed form, and three ways to differentiate it: ours, differences, MuJoCo's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cmbrl.bench.peers.mujoco import compiled
from cmbrl.bench.peers.ours import scene_of
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import ComplementarityModel

Array = NDArray[np.float64]
Start = Callable[[Tensor, float], tuple[Tensor, Tensor, Tensor]]
Output = Callable[[Tensor, Tensor], Tensor]
STEPS = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)  #: of the differences, in the parameter's own unit


@dataclass(frozen=True, kw_only=True)
class Case:
    """A scalar outcome of one simulation as a function of parameters p (n,), with d outcome / d p."""

    label: str  #: of the scene ("G1")
    title: str  #: what happens
    outcome: str
    names: tuple[str, ...]  #: of the parameters
    mjcf: str  #: text; ``{contact}`` marks where geoms get ``mujoco_contact`` as attributes in MuJoCo
    at: tuple[float, ...]  #: the parameters (n,) at which to differentiate
    start: Start  #: parameters (B, n) and the kappa [J] of the model -> q, v, u; the control is held throughout
    output: Output  #: final q, v -> outcome (B,)
    time_step: float  #: [s]
    steps: int
    truth: tuple[float, ...]  #: true derivative (n,)
    upper: tuple[float, ...] | None = None  #: any value from ``truth`` to this is one (a kink)
    softened: Callable[[float], Array] | None = None  #: kappa [J] -> derivative of the softened law in closed form
    restitution: float = 0.0  #: of all contacts
    leapfrog: bool = False  #: integrate by shifted positions (exact for constant forces)
    tolerance: float = 1e-3  #: relative to the larger of 1 and the truth
    in_mujoco: bool = True  #: whether MuJoCo can express the scene
    mujoco_contact: str = ""
    remark: str = ""  #: what the scene shows
    weakness: str = ""  #: why our derivative misses the truth, if it does

    @property
    def name(self) -> str:
        """Unique among all cases."""
        return f"{self.label} {self.title}, {self.outcome}"

    def model(self, smoothing: Smoothing) -> ComplementarityModel:
        """Rigid contact with the case's restitution, no pruning; one control step is the whole simulation."""
        scene = scene_of(self.mjcf.replace("{contact}", ""), "rigid")
        theta = scene.parameter_vector()
        theta[[p.group == "restitution" for p in scene.parameters]] = self.restitution
        return ComplementarityModel(
            scene, self.steps, self.time_step, smoothing, "leapfrog" if self.leapfrog else "semi-implicit", theta,
            prune=np.inf, path_tolerance=1e-12,
        )  # fmt: skip

    def value(self, model: ComplementarityModel, p: Tensor) -> Tensor:
        """Outcomes (B,) of parameters p (B, n), differentiable."""
        kappa = float(model.smoothing.resolve(model.scene, model.time_step)["kappa"])
        return self.output(*model.step(*self.start(p, kappa)))

    def derivative(self, model: ComplementarityModel) -> Array:
        """Ours (n,): one backward pass by the implicit function theorem."""
        p = torch.tensor([self.at], dtype=torch.float64, requires_grad=True)
        (gradient,) = torch.autograd.grad(self.value(model, p).sum(), p)
        return np.asarray(gradient[0].numpy())

    def differences(self, model: ComplementarityModel) -> Array:
        """Central differences (n,) of the same model, at the same kappa."""

        def values(points: Array) -> Array:
            with torch.no_grad():
                return np.asarray(self.value(model, torch.from_numpy(points)).numpy())

        return central_differences(values, np.array(self.at))

    def mujoco_differences(self) -> Array | None:
        """Central differences (n,) of MuJoCo at the same time step; None where it cannot express the scene."""
        if not self.in_mujoco:
            return None
        model = compiled(self.mjcf.replace("{contact}", self.mujoco_contact), "rk4" if self.leapfrog else None)
        model.opt.timestep = self.time_step
        data = mujoco.MjData(model)

        def values(points: Array) -> Array:
            ends = []
            for q, v, u in zip(*self.start(torch.from_numpy(points), 0.0), strict=True):
                mujoco.mj_resetData(model, data)
                data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, u
                mujoco.mj_step(model, data, nstep=self.steps)
                ends.append((torch.tensor(data.qpos), torch.tensor(data.qvel)))
            return np.asarray(self.output(*(torch.stack(x) for x in zip(*ends, strict=True))).numpy())

        return central_differences(values, np.array(self.at))


def central_differences(values: Callable[[Array], Array], at: Array) -> Array:
    """(n,) of a scalar, per coordinate at the step for which the 4-point and the 2-point value agree best."""
    out = np.empty(len(at))
    offsets = np.array([[-2.0], [-1.0], [1.0], [2.0]])
    for k, unit in enumerate(np.eye(len(at))):
        best = np.inf
        for step in STEPS:
            f = values(at + step * offsets * unit)
            two = (f[2] - f[1]) / (2 * step)
            four = (4 * two - (f[3] - f[0]) / (4 * step)) / 3
            doubt = abs(four - two) + 1e-14 * (1 + np.abs(f).max()) / step
            if doubt < best:
                best, out[k] = doubt, four
    return out


def position(k: int) -> Output:
    """The outcome that is coordinate k of the final configuration."""
    return lambda q, v: q[:, k]


def velocity(k: int) -> Output:
    """The outcome that is coordinate k of the final velocity."""
    return lambda q, v: v[:, k]


def stacked(p: Tensor, *columns: Tensor | float) -> Tensor:
    """(B, len(columns)) of columns of p and constants, for p (B, n)."""
    return torch.stack([torch.as_tensor(c, dtype=p.dtype).expand(len(p)) for c in columns], dim=1)
