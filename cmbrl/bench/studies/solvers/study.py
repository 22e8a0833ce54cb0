"""``cmbrl bench solvers``: contact solvers on the same problems, time against error."""

from __future__ import annotations

from pathlib import Path

from cmbrl.bench.figures import save
from cmbrl.bench.studies.solvers import cells, clock, derivatives, plots, tables
from cmbrl.bench.studies.solvers.kappa import kappa_curves
from cmbrl.bench.studies.solvers.problems import FAMILIES, VISITED, family, problem_set
from cmbrl.bench.studies.solvers.tables import LEVELS, WORDS, Summary
from cmbrl.bench.study import Section, Settings, Study
from cmbrl.contact.solvers import available
from cmbrl.errors import UserError
from cmbrl.jobs import Job, Runner


def run(folder: Path, settings: Settings, runner: Runner) -> Section:
    """All families of problems, or ``settings.scenes`` of them; every job takes times, so they run one at a time."""
    quick, seed = settings.quick, settings.seed
    problems = problem_set(folder, seed, quick)
    chosen = {k: p for k, p in enumerate(problems) if settings.scenes is None or family(p) in settings.scenes}
    if not chosen:
        wanted = ", ".join(settings.scenes or FAMILIES)
        raise UserError(f"no problems of {wanted}: choose another --scene or --out")
    asked = {
        "solvers": available(),
        "tolerances": cells.QUICK_TOLERANCES if quick else cells.TOLERANCES,
        "repeats": cells.QUICK_REPEATS if quick else cells.REPEATS,
    }
    jobs = [Job(f"{k:03d} {p.name}", cells.measure, {"problem": p, **asked}) for k, p in chosen.items()]
    solves = runner.run(jobs, "problem", (0.0, 0.85), alone=True)
    summary = Summary.of(cells.Cell.of(cell) for found in solves for cell in found)

    turns = derivatives.QUICK_TURNS if quick else derivatives.TURNS
    jobs = [
        Job(f"derivatives {scene}", derivatives.differentiate,
            {"scene": scene, "problem": p, "seed": seed, "turns": turns})
        for scene, p in derivatives.chosen(list(chosen.values())).items()
    ]  # fmt: skip
    products = runner.run(jobs, "derivative", (0.85, 0.9), alone=True)
    points = [derivatives.Point(**point) for found in products for point in found]

    count = clock.QUICK_STATES if quick else clock.STATES
    timed = [robot for robot in VISITED if robot in summary.families]
    jobs = [Job(f"clock {robot}", clock.clocks, {"robot": robot, "states": count, "seed": seed}) for robot in timed]
    clocks = [clock.RobotTimes(**c) for found in runner.run(jobs, "robot", (0.9, 0.98), alone=True) for c in found]
    (curves,) = runner.run([Job("kappa", kappa_curves)], "kappa", (0.98, 1.0))

    pictures = {
        "work_precision.png": plots.precision(summary, "exact"),
        "profile.png": plots.profile(summary),
        "relaxed.png": plots.precision(summary, "convex"),
        "kappa.png": plots.kappa(curves),
        "gradients.png": plots.derivatives(points),
    }
    for file, picture in pictures.items():
        save(picture, folder / file)
    shown = [
        *(tables.solved(summary, level) for level in LEVELS), tables.worst(summary), tables.relaxed(summary),
        tables.core_against_core(clocks), tables.derivatives(points),
    ]  # fmt: skip
    values = {
        "problems": len(chosen), "solvers": summary.laws, "clocks": clocks, "gradients": points,
        "kappa against closed forms": curves["worst"],
    }  # fmt: skip
    return Section(WORDS("title"), WORDS("method"), shown, WORDS.figures(), values)


STUDY = Study("solvers", "contact solvers on the same problems: time against error", run, FAMILIES)
