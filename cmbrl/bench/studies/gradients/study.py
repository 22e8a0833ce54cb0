"""The study of policy gradients: what exact, smoothed and bundled estimators cost in bias, variance and time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from cmbrl.bench.studies.gradients.contenders import LENGTHS, contenders
from cmbrl.bench.studies.gradients.measure import Quality, costs, judge
from cmbrl.bench.studies.gradients.plots import against_cost, against_horizon, against_length
from cmbrl.bench.studies.gradients.systems import SYSTEMS
from cmbrl.bench.study import Cell, Figure, Progress, Section, Settings, Study, Table, with_progress

LENGTH = 1e-3  #: the smoothing length [m] at which horizons are compared
TITLE = "Policy gradients: bias, variance and cost of every estimator"
TEXT = """The gradient of the expected return of a policy on hard (rigid) simulations from noisy initial states. Its
true value is estimated by central differences of the hard return on the same initial states; its standard error is the
dotted line (at the longest horizon). Smoothing softens the derivative alone or simulation and derivative alike
("both"); a smoothing length sigma stands for noise of sigma/h on the closing speed of a contact: constant kappa =
sigma^2/(2 F h^2), the Gaussian schedule kappa(z), or a bundle of Jacobians at positions disturbed by sigma. Deviation
is the root of the variance of one sample: N samples have 1/sqrt(N) of it. Hollow markers: the bias is within twice its
standard error; arrows: beyond the axis. Parameters, policies and rewards are our choice. That the exact gradient of the
ball is biased is the friction of its impacts (see G3 in the gradient scenes). """


def run(folder: Path, settings: Settings, progress: Progress) -> Section:
    """All systems, or ``settings.scenes`` of them; finished cells are kept in ``folder/cells``."""
    names = [name for name in SYSTEMS if not settings.scenes or name in settings.scenes]
    horizons = (4, 16, 32) if settings.quick else (4, 8, 16, 32, 64, 128)
    samples, middle = (32, 32) if settings.quick else (256, 32)
    lengths = LENGTHS[1:] if settings.quick else LENGTHS
    field = list(contenders(lengths, (4,) if settings.quick else (4, 16, 64)))
    rows: list[Quality] = []
    cost: dict[str, dict[str, float]] = {}
    done, total = 0, len(names) * (len(horizons) + 1)
    for name in names:
        system = SYSTEMS[name]()
        for horizon in horizons:
            progress(done / total, f"{system.title}, horizon {horizon}")
            rows += judge(system, horizon, field, samples, settings.seed, folder / "cells")
            done += 1
        progress(done / total, f"{system.title}, cost")
        cost[name] = costs(system, middle, field, 64, 1 if settings.quick else 5)
        done += 1
    against_length(rows, names, middle, folder / "gradient_length.png")
    against_horizon(rows, names, LENGTH, folder / "gradient_horizon.png")
    against_cost(rows, names, middle, cost, folder / "gradient_cost.png")
    figures = [
        Figure("gradient_cost.png", "Cost against bias and against variance",
               "Processor time a sample, every smoothing length and bundle size a point; down and left is better."),
        Figure("gradient_length.png", "Smoothing length against bias and variance",
               f"At a horizon of {middle} control steps."),
        Figure("gradient_horizon.png", "Horizon against bias and variance",
               f"At a smoothing length of {1000 * LENGTH:g} mm: where products of Jacobians explode."),
    ]  # fmt: skip
    values = {"qualities": [asdict(r) for r in rows], "us_per_sample": cost}
    return Section(TITLE, TEXT + _findings(rows, middle), [_table(rows, cost, middle)], figures, values)


def _table(rows: Sequence[Quality], cost: dict[str, dict[str, float]], horizon: int) -> Table:
    def cells(r: Quality) -> list[Cell]:
        system = SYSTEMS[r.system]()
        kappa = next((c.kappa(system) for c in contenders() if c.name == r.contender), None)
        return [r.system, r.family, r.length, kappa, r.bundle, r.bias, r.bias_error, r.deviation, r.reference_error,
                r.steps, cost[r.system].get(r.contender), r.failed, r.unsolved]  # fmt: skip

    return Table(
        f"Estimators at a horizon of {horizon} control steps",
        ["system", "estimator", "length", "kappa [J]", "bundle", "bias", "its error", "deviation", "error of the truth",
         "steps a sample", "us a sample", "not finite", "unsolved"],
        [cells(r) for r in rows if r.horizon == horizon],
        "Bias, its standard error and the deviation of one sample relative to the norm of the true gradient.",
    )  # fmt: skip


def _findings(rows: Sequence[Quality], horizon: int) -> str:
    """Per system the estimator of least error for 64 samples, found by the same rule everywhere."""
    best = []
    for system in dict.fromkeys(r.system for r in rows):
        here = [r for r in rows if r.system == system and r.horizon == horizon]
        winner = min(here, key=lambda r: r.bias**2 + r.deviation**2 / 64)
        best.append(f"{system}: {winner.contender} (bias {winner.bias:.2g}, deviation {winner.deviation:.2g})")
    return f"Least error of 64 samples at horizon {horizon}: " + "; ".join(best) + "."


STUDY = Study("gradients", "bias, variance and cost of policy-gradient estimators", with_progress(run), tuple(SYSTEMS))
