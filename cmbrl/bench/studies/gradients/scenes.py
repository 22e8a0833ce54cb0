"""The study of gradient scenes G1 to G15: ours hard and softened, finite differences at the same kappa, the truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from cmbrl.bench.studies.gradients import bounces, chaos, jumps, slips, touches
from cmbrl.bench.studies.gradients.case import Array, Case
from cmbrl.bench.studies.gradients.scene_plots import plot_bias, plot_jumps
from cmbrl.bench.study import Cell, Figure, Progress, Section, Settings, Study, Table, with_progress
from cmbrl.contact import Adaptive, Barrier, Exact
from cmbrl.contact.smoothing import Smoothing

KAPPAS = (1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  #: [J]
SMOOTHINGS: dict[str, Smoothing] = {
    "hard": Exact(),
    **{f"kappa {kappa:.0e}": Barrier(kappa) for kappa in KAPPAS},
    "adaptive": Adaptive(length=1e-3),
}
SHOWN = ("hard", "kappa 1e-06", "kappa 1e-04", "kappa 1e-02", "adaptive")
MATCH = 1e-4  #: |ours - differences| relative to the larger of 1 and the derivative, above which they do not agree
LABELS = tuple(f"G{k}" for k in range(1, 16))
TITLE = "Gradient scenes: derivatives through contact against closed forms"
TEXT = """Every scene of the bank is simulated by the model with rigid contact and differentiated in one backward pass.
It is judged twice, and the two errors are never merged: against finite differences of the same softened simulation,
which the implicit derivative has to match at every kappa; and against the true derivative, from which a softened one
may differ (bias). "Hard" is the default, kappa = 1e-9 m g h times 1 m/s; kappa in J; adaptive: smoothing length 1 mm.
MuJoCo is differenced at the same time step, with its default contact, or with an undamped spring for elastic bounces.
G5 and G6 are functions rather than mechanics: they judge estimators alone, G7 is their mechanical form. """


@dataclass(frozen=True)
class Row:
    """One derivative. ``ours``, ``differences`` by smoothing; ``failures``: solves that did not converge."""

    label: str
    title: str
    wrt: str
    truth: float
    upper: float
    ours: dict[str, float]
    differences: dict[str, float]
    softened: dict[str, float]
    mujoco: float | None
    tolerance: float
    remark: str
    weakness: str
    failures: int

    def mismatch(self, name: str) -> float:
        """|ours - differences| at a smoothing, relative to the larger of 1 and the derivative."""
        return abs(self.ours[name] - self.differences[name]) / max(1.0, abs(self.differences[name]))

    def bias(self, value: float) -> float:
        """Distance to the truth, or to the interval of it, relative to the larger of 1 and the truth."""
        outside = max(self.truth - value, value - self.upper, 0.0)
        return outside / max(1.0, abs(self.truth))

    @property
    def weakness_shows(self) -> bool:
        """Whether the default (hard) derivative is further from the truth than the case tolerates."""
        return self.bias(self.ours["hard"]) > self.tolerance

    @property
    def verdict(self) -> str:
        """Of the default (hard) model, and whether all smoothings match their own differences."""
        astray = [name for name in self.ours if self.mismatch(name) > MATCH]
        if self.weakness_shows:
            return f"misses the truth: {self.weakness}"
        if astray:
            reason = f": {self.weakness}" if self.weakness else ""
            return f"truth met; differs from differences at {len(astray)} of {len(self.ours)} smoothings{reason}"
        return "pass"


def all_cases() -> list[Case]:
    """In the order of the bank."""
    cases = chain(bounces.cases(), touches.cases(), slips.cases(), [jumps.over_the_wall()], chaos.cases())
    return sorted(cases, key=lambda case: int(case.label[1:]))


def measure(case: Case) -> Iterator[Row]:
    """One row for each parameter of a case."""
    ours: dict[str, Array] = {}
    differences: dict[str, Array] = {}
    softened: dict[str, Array] = {}
    failures = 0
    for name, smoothing in SMOOTHINGS.items():
        model = case.model(smoothing)
        ours[name], differences[name] = case.derivative(model), case.differences(model)
        failures += model.failures
        if case.softened and isinstance(smoothing, Barrier) and smoothing.kappa is not None:
            softened[name] = case.softened(smoothing.kappa)
    rival = case.mujoco_differences()
    for k, name in enumerate(case.names):
        yield Row(
            label=case.label,
            title=case.title,
            wrt=f"d {case.outcome}/d {name}",
            truth=case.truth[k],
            upper=case.upper[k] if case.upper else case.truth[k],
            ours=_column(ours, k),
            differences=_column(differences, k),
            softened=_column(softened, k),
            mujoco=None if rival is None else float(rival[k]),
            tolerance=case.tolerance,
            remark=case.remark,
            weakness=case.weakness,
            failures=failures,
        )


def _column(held: dict[str, Array], k: int) -> dict[str, float]:
    return {name: float(x[k]) for name, x in held.items()}


def run(folder: Path, settings: Settings, progress: Progress) -> Section:
    """All scenes, or ``settings.scenes`` of them; the estimators of jumps when G5, G6 or G7 is among them."""
    chosen = settings.scenes or LABELS
    cases = [case for case in all_cases() if case.label in chosen]
    rows: list[Row] = []
    for k, case in enumerate(cases):
        progress(k / (len(cases) + 1), f"{case.label} {case.title}")
        rows += measure(case)
    tables, figures = [], []
    if rows:
        tables.append(_table(rows))
        plot_bias(rows, KAPPAS, folder / "gradient_scenes.png")
        figures.append(
            Figure("gradient_scenes.png", "Two different errors of a softened gradient",
                   "Left: distance to the true derivative against kappa. Right: distance to finite differences of the "
                   "same softened simulation. The worst derivative of each scene; dashed: cases that miss the truth.")
        )  # fmt: skip
    judged = [jump for jump in jumps.jumps(Exact()) if jump.label in chosen]
    if judged:
        progress(len(cases) / (len(cases) + 1), "estimators across jumps")
        sizes = (10, 30, 100, 300, 1000) if settings.quick else (10, 30, 100, 300, 1000, 3000)
        repeats = 10 if settings.quick else 30
        errors, table = _estimators(judged, sizes, repeats, settings.seed)
        tables.append(table)
        plot_jumps(errors, sizes, folder / "gradient_jumps.png")
        figures.append(
            Figure("gradient_jumps.png", "First and zeroth order across a jump",
                   "Root mean square error of the bundle against its size; dashed: the error that the bundle reports.")
        )  # fmt: skip
    text = TEXT + _findings(rows)
    return Section(TITLE, text, tables, figures, {"rows": [{**asdict(row), "verdict": row.verdict} for row in rows]})


def _table(rows: Sequence[Row]) -> Table:
    def cells(row: Row) -> list[Cell]:
        truth: Cell = row.truth if row.upper == row.truth else f"[{row.truth:g}, {row.upper:g}]"
        worst = max(row.mismatch(name) for name in row.ours)
        ours = (row.ours[name] for name in SHOWN)
        return [row.label, row.title, row.wrt, truth, *ours, worst, row.mujoco, row.verdict, row.remark]

    return Table(
        "Derivatives by scene",
        ["scene", "case", "derivative", "true", *SHOWN, "worst |ours - differences|", "MuJoCo differences", "verdict",
         "what it shows"],
        [cells(row) for row in rows],
        "Columns hard to adaptive: our implicit derivative. Mismatch relative to the larger of 1 and the derivative, "
        f"over all {len(SMOOTHINGS)} smoothings; truth is met within the tolerance of the case (0.1 % as a rule).",
    )  # fmt: skip


def _estimators(
    judged: Sequence[jumps.Jump], sizes: Sequence[int], repeats: int, seed: int
) -> tuple[dict[str, dict[str, Array]], Table]:
    """Errors (sizes, 2) by scene and order, true over repeats and as the bundles report them; and the table."""
    rng = np.random.default_rng(seed)
    errors: dict[str, dict[str, Array]] = {}
    rows: list[list[Cell]] = []
    for jump in judged:
        name = f"{jump.label} {jump.title}"
        errors[name] = {}
        for size in sizes:
            runs = [jump.estimates(size, rng) for _ in range(repeats)]
            for order in runs[0]:
                means = np.array([r[order].mean[0] for r in runs])
                rms = float(np.sqrt(((means - jump.truth) ** 2).mean()))
                said = float(np.median([r[order].standard_error for r in runs]))
                errors[name].setdefault(order, np.empty((0, 2)))
                errors[name][order] = np.vstack([errors[name][order], [rms, said]])
                if size == 1000:
                    variance = float(np.mean([r[order].total_variance for r in runs]))
                    rows.append([jump.label, jump.title, order, jump.truth, float(means.mean()), rms, said, variance])
    return errors, Table(
        "Estimators across jumps, 1,000 samples",
        ["scene", "case", "estimator", "true", "mean", "rms error", "error it reports", "variance of one sample"],
        rows,
        f"Over {repeats} bundles. First order never sees the jump of G5 and reports no doubt; on ramps its variance "
        "grows like 1/width.",
    )


def _findings(rows: Sequence[Row]) -> str:
    missed = sorted({f"{r.label} ({r.title})" for r in rows if r.verdict.startswith("misses")})
    passed = sum(r.verdict == "pass" for r in rows)
    failures = sum({(r.label, r.title): r.failures for r in rows}.values())
    text = f"Of {len(rows)} derivatives {passed} pass both tests; solves that failed: {failures}."
    return text + (f" The truth is missed in {', '.join(missed)}: reasons in the table." if missed else "")


STUDY = Study(
    "gradient-scenes",
    "derivatives of G1 to G15 against closed forms and finite differences",
    with_progress(run),
    LABELS,
)
