"""The tables of the bank: verdicts at one step size, the order of the error in h, counts, what is not expressible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cmbrl.bench.studies.stability.case import WORDS, BankScene
from cmbrl.bench.studies.stability.cells import ABSENT, FAIL, NEAR, PASS, Cell
from cmbrl.bench.study import Cell as Entry
from cmbrl.bench.study import Table

Cells = dict[tuple[str, str, float], Cell]  #: by label, simulator, h
GLYPHS = {PASS: "pass", NEAR: "near", FAIL: "FAIL"}
UNEXPRESSED = ("F23, mass 0", "F26")  #: scenes of the bank that our model cannot express; text.toml says why


@dataclass(frozen=True)
class Results:
    """The scenes, the names of the simulators, all finished cells, and whether the run was quick."""

    scenes: Sequence[BankScene]
    names: Sequence[str]
    cells: Cells
    quick: bool

    def step(self, scene: BankScene) -> float:
        """The step that the main table shows [s]."""
        return scene.shown_step(scene.sizes(self.quick))

    def shown(self, scene: BankScene, name: str) -> Cell:
        """The cell at that step."""
        return self.cells[scene.label, name, self.step(scene)]

    def swept(self, label: str, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Steps and errors (n,) of a scene under a simulator, ascending in h; errors may be infinite."""
        found = sorted((h, c.error) for (scene, simulator, h), c in self.cells.items()
                       if (scene, simulator) == (label, name) and c.error is not None)  # fmt: skip
        return np.array([h for h, _ in found]), np.array([e for _, e in found])


def verdicts(results: Results) -> Table:
    """Scene x simulator at the shown step: verdict, error."""
    rows: list[list[Entry]] = [
        [s.name, results.step(s), s.tolerance(results.step(s)), *(_verdict(results.shown(s, n)) for n in results.names)]
        for s in results.scenes
    ]
    return Table("Failure bank", ["scene", "h [s]", "tolerance", *results.names], rows, WORDS("tables.verdicts"))


def counts(results: Results) -> Table:
    """How many scenes each simulator passes, at the shown step and at every step."""
    rows: list[list[Entry]] = []
    for name in results.names:
        shown = [results.shown(s, name).verdict for s in results.scenes]
        everywhere = [c.verdict for c in results.cells.values() if c.simulator == name and c.verdict != ABSENT]
        found = [shown.count(v) for v in (PASS, NEAR, FAIL, ABSENT)]
        rows.append([name, *found, everywhere.count(PASS), len(everywhere)])
    columns = ["simulator", PASS, NEAR, FAIL, ABSENT, "passes at all steps", "of"]
    return Table("Counts at the shown step, and over all steps that were run", columns, rows)


def sweep(results: Results, sizes: Sequence[float]) -> Table:
    """How the first simulator does at each of ``sizes``, and at how many of them each simulator passes."""
    first, *others = results.names
    rows: list[list[Entry]] = []
    for scene in results.scenes:
        found = [[results.cells.get((scene.label, name, h)) for h in sizes] for name in results.names]
        if sum(c is not None for c in found[0]) < 2:
            continue
        passed: list[Entry] = []
        for cells in found[1:]:
            run = [c.verdict for c in cells if c and c.verdict != ABSENT]
            passed.append(f"{run.count(PASS)} of {len(run)}" if run else None)
        rows.append([scene.name, *(None if c is None else _verdict(c, 0, partial="") for c in found[0]), *passed])
    title = f"The same from {1 / max(sizes):g} to {1 / min(sizes):,.0f} Hz: {first}"
    return Table(title, ["scene", *(f"{h:g} s" for h in sizes), *others], rows, WORDS("tables.sweep", first=first))


def costs(results: Results) -> Table:
    """Microseconds per physics step."""
    rows: list[list[Entry]] = []
    for scene in results.scenes:
        seconds = [results.shown(scene, name).seconds for name in results.names]
        if any(seconds):
            rows.append([scene.name, *(None if s is None else 1e6 * s for s in seconds)])
    return Table("Cost [us per step]", ["scene", *results.names], rows, WORDS("tables.costs"))


def orders(results: Results) -> Table:
    """How the error falls with h: slope of log error over log h for the scenes that expect one."""
    rows: list[list[Entry]] = [
        [s.name, s.order, *(slope_of(*results.swept(s.label, name)) for name in results.names)]
        for s in results.scenes
        if s.order is not None
    ]
    return Table("Order of the error in h", ["scene", "expected", *results.names], rows, WORDS("tables.orders"))


def slope_of(h: np.ndarray, error: np.ndarray) -> float | None:
    """Order of an error (n,) in h (n,); None with fewer than two finite errors of at least 1e-12."""
    good = np.isfinite(error) & (error > 1e-12)
    return float(np.polyfit(np.log(h[good]), np.log(error[good]), 1)[0]) if good.sum() > 1 else None


def truths(results: Results) -> Table:
    """What each scene must do, what breaks there, and what is missing."""
    rows: list[list[Entry]] = [[s.name, s.kind, *map(s.words, ("truth", "breaks", "note"))] for s in results.scenes]
    for label in UNEXPRESSED:
        title, why = (WORDS(f"unexpressed.{label}.{part}") for part in ("title", "why"))
        rows.append([f"{label} {title}", "-", "-", "-", why])
    return Table("Scenes and their truths", ["scene", "kind", "truth", "what breaks", "note"], rows)


def reasons(results: Results) -> Table:
    """Why a simulator cannot express a scene, or one of its cases."""
    found = [(s.name, name, results.shown(s, name).why) for s in results.scenes for name in results.names]
    rows = [row for row in found if row[2]]
    return Table("Not expressible", ["scene", "simulator", "first such case, and why"], rows)


def _verdict(cell: Cell, digits: int = 1, partial: str = "°") -> Entry:
    if cell.error is None:
        return None
    return f"{GLYPHS[cell.verdict]} {cell.error:.{digits}e}" + partial * cell.partial
