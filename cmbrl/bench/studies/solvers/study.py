"""``cmbrl bench solvers``: contact solvers on the same problems, speed against residual."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from cmbrl.bench.studies.solvers import clock, gradients, kappa
from cmbrl.bench.studies.solvers.aims import aims
from cmbrl.bench.studies.solvers.captions import CAPTIONS, TEXT
from cmbrl.bench.studies.solvers.gradients import measure_gradients
from cmbrl.bench.studies.solvers.kappa import kappa_curves
from cmbrl.bench.studies.solvers.measure import QUICK_REPEATS, QUICK_TOLERANCES, REPEATS, TOLERANCES, Cell, measure
from cmbrl.bench.studies.solvers.plots import FIGURES
from cmbrl.bench.studies.solvers.problems import FAMILIES, VISITED, family, problem_set
from cmbrl.bench.studies.solvers.summary import Summary
from cmbrl.bench.study import Figure, Progress, Section, Settings, Study, with_progress
from cmbrl.contact.problem import ContactProblem
from cmbrl.contact.solvers import Solver, available, get
from cmbrl.files import read_json, write_json

SWEEPS = 5000  # of our Gauss-Seidel, as many as the alternating-direction solvers have iterations


def _study(folder: Path, settings: Settings, progress: Progress) -> Section:
    problems = problem_set(folder, settings.seed, settings.quick)
    chosen = [p for p in problems if settings.scenes is None or family(p) in settings.scenes]
    solvers = [get(name, **({"sweeps": SWEEPS} if name == "pgs" else {})) for name in available()]
    tolerances, repeats = (QUICK_TOLERANCES, QUICK_REPEATS) if settings.quick else (TOLERANCES, REPEATS)
    cells: list[Cell] = []
    for k, problem in enumerate(chosen):
        progress(0.9 * k / len(chosen), problem.name)
        cells += _cached(folder, problem, solvers, tolerances, repeats)
    summary = Summary.of(cells)
    for file, draw in FIGURES.items():
        draw(summary, folder / file)
    progress(0.9, "derivatives")
    points = measure_gradients(chosen, settings.seed, settings.quick)
    gradients.plot(points, folder / "gradients.png")
    curves = kappa_curves()
    kappa.plot(curves, folder / "kappa.png")
    progress(0.95, "core against core")
    timed = clock.clocks(settings.seed, settings.quick, [r for r in VISITED if r in summary.families])
    tables = [aims(summary, timed), *summary.tables(), clock.table(timed), gradients.table(points)]
    values = {
        "problems": len(chosen), "solvers": summary.laws, "clocks": [asdict(c) for c in timed],
        "gradients": [asdict(p) for p in points], "kappa against closed forms": curves.worst(),
    }  # fmt: skip
    figures = [Figure(file, *caption) for file, caption in CAPTIONS.items()]
    progress(1.0, "done")
    return Section("Contact solvers on the same problems", TEXT, tables, figures, values)


def _cached(
    folder: Path, problem: ContactProblem, solvers: Sequence[Solver], tolerances: Sequence[float], repeats: int
) -> list[Cell]:
    """Cells of a problem from the folder, where a run before has measured the same."""
    asked = [problem.name, [s.name for s in solvers], list(tolerances), repeats]
    arrays = b"".join(x.tobytes() for x in (problem.M, problem.J, problem.v_free, problem.b, problem.mu, problem.R))
    key = hashlib.sha256(repr(asked).encode() + arrays).hexdigest()[:16]
    file = folder / "cells" / f"{key}.json"
    if file.is_file():
        return [Cell.from_json(held) for held in read_json(file)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # solvers on their own troubles, which the scores show
        cells = measure(problem, solvers, tolerances, repeats)
    write_json(file, [cell.to_json() for cell in cells])
    return cells


STUDY = Study("solvers", "contact solvers on the same problems: time against residual", with_progress(_study), FAMILIES)
