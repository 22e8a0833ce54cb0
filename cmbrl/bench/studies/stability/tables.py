"""The tables of the bank: verdicts at one step size, the order of the error in h, counts, what is not expressible."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cmbrl.bench.studies.stability.case import Absent, BankScene
from cmbrl.bench.studies.stability.measure import ABSENT, FAIL, NEAR, PASS, Cell
from cmbrl.bench.study import Cell as Entry
from cmbrl.bench.study import Table

Cells = dict[tuple[str, str, float], Cell]  #: by label, simulator, h
GLYPHS = {PASS: "pass", NEAR: "near", FAIL: "FAIL"}


def verdicts(scenes: Sequence[BankScene], names: Sequence[str], cells: Cells, steps: dict[str, float]) -> Table:
    """Scene x simulator at the shown step: verdict, error."""
    rows: list[list[Entry]] = []
    for scene in scenes:
        h = steps[scene.label]
        entries: list[Entry] = []
        for name in names:
            cell = cells[scene.label, name, h]
            entries.append(
                None if cell.error is None else f"{GLYPHS[cell.verdict]} {cell.error:.1e}" + "°" * cell.partial
            )
        rows.append([scene.name, h, scene.tolerance(h), *entries])
    note = (
        "Error of the worst case as a share of the scene's own scale (way, free fall, weight). pass: within the "
        "scene's tolerance; near: beyond it, but within 1 %; FAIL: more, or a step given up; -: not expressible; °: "
        "some of its cases are not."
    )
    return Table("Failure bank", ["scene", "h [s]", "tolerance", *names], rows, note)


def counts(scenes: Sequence[BankScene], names: Sequence[str], cells: Cells, steps: dict[str, float]) -> Table:
    """How many scenes each simulator passes, at the shown step and at every step."""
    rows: list[list[Entry]] = []
    for name in names:
        shown = [cells[s.label, name, steps[s.label]].verdict for s in scenes]
        everywhere = [c.verdict for c in cells.values() if c.simulator == name and c.verdict != ABSENT]
        rows.append([
            name, *(shown.count(v) for v in (PASS, NEAR, FAIL, ABSENT)), everywhere.count(PASS), len(everywhere)
        ])  # fmt: skip
    columns = ["simulator", PASS, NEAR, FAIL, ABSENT, "passes at all steps", "of"]
    return Table("Counts at the shown step, and over all steps that were run", columns, rows)


def sweep(scenes: Sequence[BankScene], names: Sequence[str], cells: Cells, sizes: Sequence[float]) -> Table:
    """How the first simulator does at each of ``sizes``, and at how many of them each simulator passes."""
    rows: list[list[Entry]] = []
    for scene in scenes:
        first = [cells.get((scene.label, names[0], h)) for h in sizes]
        if sum(c is not None for c in first) < 2:
            continue
        shown = [None if c is None or c.error is None else f"{GLYPHS[c.verdict]} {c.error:.0e}" for c in first]
        passed: list[Entry] = []
        for name in names[1:]:
            run = [c for h in sizes if (c := cells.get((scene.label, name, h))) and c.verdict != ABSENT]
            passed.append(f"{sum(c.verdict == PASS for c in run)} of {len(run)}" if run else None)
        rows.append([scene.name, *shown, *passed])
    note = (
        f"Verdict and error of {names[0]} as in the first table, at every step; then at how many of these steps the "
        "others pass. -: that step was not run (a note in the last table says why), or the scene is not expressible."
    )
    return Table(f"The same from {1 / max(sizes):g} to {1 / min(sizes):,.0f} Hz: {names[0]}",
                 ["scene", *(f"{h:g} s" for h in sizes), *names[1:]], rows, note)  # fmt: skip


def costs(scenes: Sequence[BankScene], names: Sequence[str], cells: Cells, steps: dict[str, float]) -> Table:
    """Microseconds per physics step."""
    rows: list[list[Entry]] = []
    for scene in scenes:
        shown = [cells[scene.label, name, steps[scene.label]].seconds for name in names]
        if any(shown):
            rows.append([scene.name, *(None if s is None else 1e6 * s for s in shown)])
    note = (
        "Processor time of one thread, one state, many steps a call. PGS and the relaxation are driven from Python, "
        "step by step: their cost is an upper bound. The first case of a scene."
    )
    return Table("Cost [us per step]", ["scene", *names], rows, note)


def orders(scenes: Sequence[BankScene], names: Sequence[str], cells: Cells) -> Table:
    """How the error falls with h: slope of log error over log h for the scenes that expect one."""
    rows: list[list[Entry]] = []
    for scene in scenes:
        if scene.order is None:
            continue
        slopes: list[Entry] = [slope_of(*swept(scene.label, name, cells)) for name in names]
        rows.append([scene.name, scene.order, *slopes])
    note = "Least-squares slope over the steps with a finite error of at least 1e-12; - with fewer than two of them."
    return Table("Order of the error in h", ["scene", "expected", *names], rows, note)


def swept(label: str, name: str, cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """Steps and errors (n,) of a scene under a simulator, ascending in h; errors may be infinite."""
    found = sorted((h, c.error) for (scene, simulator, h), c in cells.items()
                   if (scene, simulator) == (label, name) and c.error is not None)  # fmt: skip
    return np.array([h for h, _ in found]), np.array([e for _, e in found])


def slope_of(h: np.ndarray, error: np.ndarray) -> float | None:
    """Order of an error (n,) in h (n,)."""
    good = np.isfinite(error) & (error > 1e-12)
    return float(np.polyfit(np.log(h[good]), np.log(error[good]), 1)[0]) if good.sum() > 1 else None


def truths(scenes: Sequence[BankScene], absent: Sequence[Absent]) -> Table:
    """What each scene must do, what breaks there, and what is missing."""
    rows: list[list[Entry]] = [[s.name, s.kind, s.truth, s.breaks, s.note] for s in scenes]
    rows += [[f"{a.label} {a.title}", "-", "-", "-", a.why] for a in absent]
    return Table("Scenes and their truths", ["scene", "kind", "truth", "what breaks", "note"], rows)


def reasons(scenes: Sequence[BankScene], names: Sequence[str], cells: Cells, steps: dict[str, float]) -> Table:
    """Why a simulator has no words for a scene, or for one of its cases."""
    rows: list[list[Entry]] = []
    for scene in scenes:
        for name in names:
            cell = cells[scene.label, name, steps[scene.label]]
            if cell.why:
                rows.append([scene.name, name, cell.why])
    return Table("Not expressible", ["scene", "simulator", "first such case, and why"], rows)
