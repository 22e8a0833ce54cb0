"""Figures 1, 2 and 6 of the ABS paper, made again: one contact, what kappa and noise make of it.

Zhang, Jin & Wang, "Adaptive Barrier Smoothing for First-Order Policy Gradient with Contact Dynamics" (ICML 2023). The
paper's constants and axes are not available: masses, steps, kappas and noise here are our choice.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from torch import Tensor

from cmbrl.bench.studies.gradients import slips, touches
from cmbrl.bench.studies.gradients.case import Array, Case, stacked, velocity
from cmbrl.contact import Adaptive, Barrier
from cmbrl.contact.smoothing import Smoothing
from cmbrl.files import atomic_path
from cmbrl.gradients import first_order_bundle, zeroth_order_bundle
from cmbrl.models.complementarity import ComplementarityModel

HARD = Barrier(1e-13)
H = 0.01  #: [s]
POINT = """<mujoco><option gravity="0 0 0"/><worldbody><geom type="plane" size="9 9 1" condim="1"/>
<body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint name="z" type="slide" axis="0 0 1"/>
<geom size=".1" mass="1" pos="0 0 .1" condim="1"/></body></worldbody></mujoco>"""


def figure_1(path: Path) -> None:
    """Impulse of one contact against its free closing speed z: hard, constant kappa, adaptive; and kappa(z)."""
    length = 2e-3
    peak = (length / H) ** 2 / (2 * np.pi)  # of the adaptive schedule, at z = 0
    z = np.linspace(-0.8, 1.2, 401)
    laws: dict[str, tuple[Smoothing, str]] = {
        "hard": (HARD, "black"),
        f"constant kappa = {peak:.2g} J": (Barrier(peak), "#1f77b4"),
        f"constant kappa = {peak / 100:.2g} J": (Barrier(peak / 100), "#9ecae1"),
        f"adaptive, length {1000 * length:g} mm": (Adaptive(length, floor=1e-12), "#d62728"),
    }
    figure, (upper, lower) = _figure(1, 2, (6.4, 6.4))
    for label, (smoothing, colour) in laws.items():
        impulse = _falling(smoothing, steps=1).predict(*_states(0 * z, z), impulse=True).impulse
        assert impulse is not None
        gamma = impulse[:, 0, 0]
        upper.plot(z, gamma, color=colour, label=label)
        lower.plot(z, np.maximum(gamma * (z + gamma), 1e-9), color=colour)
    upper.set(ylabel="impulse [N s]", title="mass 1 kg, h = 10 ms")
    lower.set(
        xlabel="z = gap/h + free speed [m/s]", ylabel="impulse x end speed = kappa [J]", yscale="log", ylim=(1e-9, 0.1)
    )
    upper.legend(frameon=False)
    _save(figure, path)


def figure_2(path: Path) -> None:
    """Speed after an inelastic bounce and its derivative along the start x: after one step, and after twenty."""
    speed = 1.0
    laws: dict[str, tuple[Smoothing, str]] = {
        "exact": (HARD, "black"),
        "kappa = 1e-4 J": (Barrier(1e-4), "#9ecae1"),
        "kappa = 1e-3 J": (Barrier(1e-3), "#4292c6"),
        "kappa = 1e-2 J": (Barrier(1e-2), "#084594"),
        "adaptive, 1 mm": (Adaptive(1e-3, floor=1e-12), "#d62728"),
    }
    figure, panels = _figure(2, 2, (10, 6.4))
    for column, steps in enumerate((1, 20)):
        x = np.linspace(0.0, 2.2, 481) * speed * H * steps
        for label, (smoothing, colour) in laws.items():
            r = _falling(smoothing, steps).predict(*_states(x, 0 * x - speed), jacobian=True)
            assert r.jacobian is not None
            panels[0, column].plot(x, r.v_next[:, 2], color=colour, label=label)
            panels[1, column].plot(x, r.jacobian[:, 5, 2], color=colour)
        panels[0, column].set_title(f"{steps} step{'s' if steps > 1 else ''} of 10 ms at -1 m/s")
        panels[1, column].set_xlabel("start x [m]")
    panels[0, 0].set_ylabel("speed afterwards [m/s]")
    panels[1, 0].set_ylabel("d speed / d x [1/s]")
    panels[0, 0].legend(frameon=False, fontsize="small")
    _save(figure, path)


def figure_6(path: Path, samples: int = 500, seed: int = 0) -> None:
    """Derivative of a block's next position in the force that lifts (impact) or pushes (friction) it.

    Noise of the bundles: 0.1 m g on the force; the barrier's kappa s^2/2 has the same scale on the closing speed.
    """
    std = 0.1
    forces = np.linspace(0.5, 1.5, 81)
    kappa = (0.1 * std) ** 2 / 2
    figure, panels = _figure(2, 2, (10.5, 7))
    for column, (title, case) in enumerate((("impact: lifted", _lifted()), ("friction: pushed", _pushed()))):
        truth = 0.01 * (forces > 1)
        for row, axes in enumerate(panels[:, column]):
            axes.plot(forces, truth, color="black", lw=1, drawstyle="steps-mid", label="hard")
            if row == 0:
                _barriers(axes, case, forces, kappa)
            else:
                _bundles(axes, case, forces, std, samples, seed)
            axes.set_ylim(-0.004, 0.016)
        panels[0, column].set_title(title)
        panels[1, column].set_xlabel("force / (m g) or force / (mu m g)")
    for row, name in enumerate(("barrier smoothing", f"randomised smoothing, {samples} samples")):
        panels[row, 0].set_ylabel(f"d next position / d force\n{name}")
        panels[row, 0].legend(frameon=False, fontsize="small", loc="upper left")
    _save(figure, path)


def _barriers(axes: Axes, case: Case, forces: Array, kappa: float) -> None:
    for factor, colour in ((0.01, "#9ecae1"), (1.0, "#4292c6"), (100.0, "#084594")):
        model = case.model(Barrier(factor * kappa))
        axes.plot(forces, _slopes(case, model, forces), color=colour, label=f"kappa = {factor * kappa:.0e} J")


def _bundles(axes: Axes, case: Case, forces: Array, std: float, samples: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    objective = _Value(case, case.model(HARD))
    points = [np.array([f]) for f in forces]
    first = [first_order_bundle(objective, x, std, samples, rng).mean[0] for x in points]
    zeroth = [zeroth_order_bundle(objective, x, std, samples, rng).mean[0] for x in points]
    few = [first_order_bundle(objective, x, std, 5, rng).mean[0] for x in points]
    axes.plot(forces, few, color="#a1d99b", lw=1, label="first order, 5 samples")
    axes.plot(forces, zeroth, color="#9467bd", lw=1, label="zeroth order")
    axes.plot(forces, first, color="#2ca02c", label="first order")


class _Value:
    """The outcome of a case as an objective of its one parameter."""

    def __init__(self, case: Case, model: ComplementarityModel) -> None:
        self.case, self.model, self.steps = case, model, case.steps

    def __call__(self, x: Tensor) -> Tensor:
        return self.case.value(self.model, x)


def _slopes(case: Case, model: ComplementarityModel, at: Array) -> Array:
    p = torch.tensor(at[:, None], requires_grad=True)
    (slopes,) = torch.autograd.grad(case.value(model, p).sum(), p)
    return np.asarray(slopes[:, 0].numpy())


def _lifted() -> Case:
    return next(c for c in touches.cases() if c.label == "G15")


def _pushed() -> Case:
    return next(c for c in slips.cases() if c.label == "G15")


def _falling(smoothing: Smoothing, steps: int) -> ComplementarityModel:
    """A point of 1 kg above the ground, no gravity, one control step of ``steps`` steps."""

    def start(p: Tensor, kappa: float) -> tuple[Tensor, Tensor, Tensor]:
        return stacked(p, 0, 0, p[:, 0]), stacked(p, 0, 0, p[:, 1]), p[:, :0]

    case = Case(label="", title="", outcome="speed", names=(), mjcf=POINT, at=(), start=start, output=velocity(2),
                time_step=H, steps=steps, truth=())  # fmt: skip
    return case.model(smoothing)


def _states(gap: Array, speed: Array) -> tuple[Array, Array, Array]:
    q, v = np.zeros((2, len(gap), 3))
    q[:, 2], v[:, 2] = gap, speed
    return q, v, np.zeros((len(gap), 0))


def _figure(columns: int, rows: int, size: tuple[float, float]) -> tuple[Figure, Array]:
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle("masses, steps, kappa and noise are our choice", fontsize="small", color="0.4")
    panels = figure.subplots(rows, columns, sharex="col")
    for axes in np.ravel(panels):
        axes.grid(alpha=0.3)
    return figure, panels


def _save(figure: Figure, path: Path) -> None:
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)
