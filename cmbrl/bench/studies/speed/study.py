"""``cmbrl bench speed``: microseconds per step and per derivative, MuJoCo's beside ours."""

from __future__ import annotations

from pathlib import Path

from cmbrl.bench.studies.speed.measure import measure, turns
from cmbrl.bench.studies.speed.scenes import LABELS
from cmbrl.bench.study import Figure, Progress, Section, Settings, Study, with_progress

REPEATS, QUICK_REPEATS = 9, 3
STATES, QUICK_STATES = 4096, 1024


def _study(folder: Path, settings: Settings, progress: Progress) -> Section:
    repeats, states = (QUICK_REPEATS, QUICK_STATES) if settings.quick else (REPEATS, STATES)
    total, done = turns(settings.scenes, repeats), 0

    def count(new: int) -> None:
        nonlocal done
        done += new
        progress(done / total, f"turn {done} of {total}")

    batches = (64, 512) if settings.quick else (64, 512, 4096)
    result = measure(
        settings.seed, settings.scenes, states, batches=batches, threads=settings.threads, repeats=repeats,
        progress=count,
    )  # fmt: skip
    result.plot(folder / "speed.png")
    text = (
        "Our step and its derivatives against MuJoCo's on states that MuJoCo visits, per physics step and per core, "
        "as processor time of the calling thread. MuJoCo and ours take turns; a ratio is of one turn. Derivatives "
        "include the step: 'jacobian' is the full matrix, 'vjp' one cotangent through step and tape, 'torch vjp' the "
        "same by loss.backward()."
    )
    caption = "Microseconds per physics step by scene, log scale; whiskers from the lowest to the highest turn."
    figures = [Figure("speed.png", "Step and derivatives, ours and MuJoCo's", caption)]
    return Section("Speed against MuJoCo", text, result.tables(), figures, result.to_json())


STUDY = Study("speed", "steps and derivatives against MuJoCo's, as ratios of one run", with_progress(_study), LABELS)
