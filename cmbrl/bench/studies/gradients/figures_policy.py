"""Figures 3 and 5b of the ABS paper, made again: variance against the horizon, bias of the half-cheetah's gradient.

The paper's policies, constants and axes are not available: what is simulated is described in ``systems.py`` and is our
choice, like every kappa and length here.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cmbrl.bench.studies.gradients.contenders import Contender
from cmbrl.bench.studies.gradients.measure import Quality, judge
from cmbrl.bench.studies.gradients.systems import SYSTEMS, System
from cmbrl.bench.study import Progress
from cmbrl.contact import Barrier
from cmbrl.files import atomic_path
from cmbrl.gradients import pathwise
from cmbrl.models.complementarity import SolverWarning

VARIANCE_KAPPAS = (1e-10, 1e-4, 1e-2, 1.0)  #: [J]
BIAS_KAPPAS = (1e-10, 1e-6, 1e-4, 1e-2)
COLOURS = ("black", "#c6dbef", "#6baed6", "#08519c")
HORIZONS = (4, 8, 16, 32, 64, 128)


def figure_3(
    path: Path, horizons: Sequence[int] = HORIZONS, samples: int = 256, progress: Progress | None = None
) -> None:
    """Variance of one sample of the pathwise gradient against the horizon; kappa in simulation and derivative."""
    names = ("ball", "hopper", "cheetah")
    figure = Figure(figsize=(12, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    for column, (axes, name) in enumerate(zip(figure.subplots(1, 3), names, strict=True)):
        system = SYSTEMS[name]()
        for k, (kappa, colour) in enumerate(zip(VARIANCE_KAPPAS, COLOURS, strict=True)):
            if progress:
                progress((column + k / len(VARIANCE_KAPPAS)) / len(names), f"{system.title}, kappa {kappa:.0e}")
            variances = [_variance(system, kappa, horizon, samples) for horizon in horizons]
            axes.plot(horizons, variances, color=colour, marker=".", label=f"{kappa:.0e} J")
        _horizon_axes(axes, horizons)
        axes.set_title(system.title)
    figure.axes[0].set_ylabel("variance of the gradient of one sample")
    figure.axes[0].legend(title="kappa", frameon=False, fontsize="small")
    _save(figure, path)


def figure_5b(
    path: Path, horizons: Sequence[int] = HORIZONS[:-1], samples: int = 256, progress: Progress | None = None
) -> list[Quality]:
    """Bias (and deviation) of the half-cheetah's gradient: constant kappa in the derivative against adaptive.

    Simulations are hard; the truth is a central difference of the hard return, its standard error is dotted. Hollow:
    the bias is within twice its own standard error. The paper's ablation has 1e-10, 1e-2 and ABS.
    """
    system = SYSTEMS["cheetah"]()
    field = [Contender("barrier", length_of(system, kappa)) for kappa in BIAS_KAPPAS]
    field += [Contender("adaptive", 1e-4), Contender("adaptive", 1e-3)]
    labels = [f"constant kappa = {kappa:.0e} J" for kappa in BIAS_KAPPAS]
    labels += ["adaptive (ABS), 0.1 mm", "adaptive (ABS), 1 mm"]
    rows: list[Quality] = []
    for k, horizon in enumerate(horizons):
        if progress:
            progress(k / len(horizons), f"{system.title}, horizon {horizon}")
        rows += judge(system, horizon, field, samples, seed=0)
    figure = Figure(figsize=(10.5, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    for contender, label, colour in zip(field, labels, (*COLOURS, "#fc9272", "#cb181d"), strict=True):
        mine = [r for r in rows if r.contender == contender.name]
        left.plot(horizons, [r.bias for r in mine], color=colour, lw=1.2, label=label)
        for r in mine:
            left.plot(r.horizon, r.bias, "o", ms=5, color=colour, mfc=colour if r.resolved else "white")
        right.plot(horizons, [r.deviation for r in mine], color=colour, marker="o", ms=4, lw=1.2)
    errors = [next(r.reference_error for r in rows if r.horizon == horizon) for horizon in horizons]
    left.plot(horizons, errors, color="0.5", ls=":", label="standard error of the truth")
    left.set(ylabel="bias / |true gradient|", title="bias")
    right.set(ylabel="deviation of one sample / |true gradient|", title="deviation")
    for axes in (left, right):
        _horizon_axes(axes, horizons)
    figure.legend(
        *left.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, fontsize="small"
    )
    _save(figure, path)
    return rows


def length_of(system: System, kappa: float) -> float:
    """Smoothing length [m] for which a constant schedule has this kappa [J]: h sqrt(2 F kappa)."""
    unit = Barrier(length=1.0).resolve(system.scene, system.settings["time_step"])["kappa"]
    return float(np.sqrt(kappa / unit))


def _variance(system: System, kappa: float, horizon: int, samples: int) -> float:
    objective = system.rollout(system.model(smoothing=Barrier(kappa)), horizon, samples)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SolverWarning)
        return pathwise(objective, system.at, samples).total_variance


def _horizon_axes(axes: Axes, horizons: Sequence[int]) -> None:
    axes.set(xscale="log", yscale="log", xlabel="horizon [control steps]")
    axes.set_xticks(horizons, [str(x) for x in horizons])
    axes.set_xticks([], minor=True)
    axes.grid(alpha=0.3)


def _save(figure: Figure, path: Path) -> None:
    figure.suptitle("policies, noise and rewards are our choice", fontsize="small", color="0.4")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)
