"""Pictures: bias and mismatch against kappa; estimators across jumps against bundle size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from cmbrl.bench.figures import legend_below, panels
from cmbrl.bench.studies.gradient_scenes.cells import KAPPAS, MATCH, Bundle, Row

FLOOR = 1e-12  #: smaller errors are drawn here
MARKERS = "osv^D*P"
SCENES = {
    "G1": "bounce", "G2": "two balls", "G3": "oblique hit", "G4": "box out of reach", "G5": "Heaviside step",
    "G6": "ramp", "G7": "ball over a wall", "G8": "pushed block", "G9": "make or break", "G10": "billiard",
    "G11": "double pendulum", "G12": "ball into target", "G13": "sticking block", "G14": "cube on four corners",
    "G15": "block at its threshold", "G16": "connect", "G17": "weld", "G18": "friction loss",
    "G19": "box on a corner", "G20": "parallel capsules", "G21": "servo, implicit",
}  #: names of scenes in legends  # fmt: skip


def bias(rows: Sequence[Row]) -> Figure:
    """Distance to the truth (left) and to finite differences (right) against kappa: the worst derivative of a scene.

    Cases whose hard derivative misses the truth have dashed curves of their own.
    """
    figure, ((left, right),) = panels(1, 2, 12, 5.7)
    curves: dict[str, list[Row]] = {}
    for row in rows:
        name = f"{row.title}: misses the truth" if row.misses else SCENES[row.label]
        curves.setdefault(f"{row.label} {name}", []).append(row)
    names = [f"kappa {kappa:.0e}" for kappa in KAPPAS]
    scenes = list(dict.fromkeys(row.label for row in rows))
    for label, held in curves.items():
        k = scenes.index(held[0].label)
        look = {"color": colormaps["tab20"](k), "marker": MARKERS[k % len(MARKERS)], "ms": 4, "lw": 1.2,
                "ls": "--" if held[0].misses else "-", "label": label}  # fmt: skip
        left.plot(KAPPAS, [max(*(r.bias(r.ours[name]) for r in held), FLOOR) for name in names], **look)
        right.plot(KAPPAS, [max(*(r.mismatch(name) for r in held), FLOOR) for name in names], **look)
    left.set(title="bias: |softened - true|", ylabel="relative to the larger of 1 and the derivative")
    right.set(title="mismatch: |ours - finite differences at the same kappa|")
    right.axhline(MATCH, color="0.6", ls=":", lw=1)
    right.annotate(
        "passes below", (KAPPAS[0], MATCH), (0, 3), textcoords="offset points", fontsize="small", color="0.4"
    )
    for axes in (left, right):
        axes.set(xscale="log", yscale="log", xlabel="kappa [J]", ylim=(FLOOR / 2, None))
        axes.grid(alpha=0.3)
    legend_below(figure)
    return figure


def across_jumps(bundles: Sequence[Bundle]) -> Figure:
    """One panel a jump: root mean square error of first and zeroth order, and the error they report (dashed)."""
    names = list(dict.fromkeys(b.title for b in bundles))
    figure, (grid,) = panels(1, len(names), 3.1 * len(names), 3.4, sharey=True)
    for axes, name in zip(grid, names, strict=True):
        for order, colour in (("first order", "#d62728"), ("zeroth order", "#1f77b4")):
            mine = [b for b in bundles if b.title == name and b.order == order]
            sizes, reported = [b.size for b in mine], [b.reported if b.reported > 0 else np.nan for b in mine]
            axes.plot(sizes, [b.rms for b in mine], color=colour, marker=".", label=order)
            axes.plot(sizes, reported, color=colour, ls="--", lw=1, label=f"{order}, as reported")
            if np.isnan(reported).all():
                axes.annotate(
                    f"{order} reports 0", (0.05, 0.06), xycoords="axes fraction", fontsize="small", color=colour
                )
        axes.set(xscale="log", yscale="log", xlabel="bundle size")
        axes.set_title(name, fontsize="medium")
        axes.grid(alpha=0.3)
    grid[0].set_ylabel("error of the gradient")
    legend_below(figure)
    return figure
