"""The speed table: as tables, as JSON, as a picture."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cmbrl.bench.study import Cell, Table
from cmbrl.bench.timing import Spread

# Ratios to mj_step that are aimed at: scene -> (what, at least).
AIMS = {
    "hopper rk4": (("jacobian", 12.0),),
    "hopper euler": (("jacobian", 4.0),),
    "cheetah": (("jacobian", 3.0),),
    "cube": (("jacobian", 1.0),),
    "cube rigid": (("jacobian", 1.0),),
    "g1 feet": (("jacobian", 1.0), ("vjp", 1.0)),
    "g1": (("jacobian", 1.0),),
}
CANDIDATE_AIM = 3.0


@dataclass(frozen=True)
class SpeedRow:
    """One scene under one smoothing: seconds per physics step on one core, ratios peer/ours (above 1: we win)."""

    scene: str
    smoothing: str
    peer: str  # MuJoCo's integrator
    time_step: float  # [s], of both
    integrator: str  # ours
    contacts: float  # MuJoCo's, on average
    seconds: dict[str, Spread]
    ratios: dict[str, Spread]
    iterations: float  # of our solver, on average
    failures: int  # states that our solver did not solve


@dataclass(frozen=True)
class BatchRow:
    """Wall seconds per physics step by batch size, on one thread and on several; ``gain``: of their fastest turns.

    Wall time suffers from other work on the machine, which can only add to it: the fastest turn says most.
    """

    scene: str
    kind: str
    batch: int
    one_thread: Spread
    threads: Spread
    gain: float


@dataclass(frozen=True)
class CandidateRow:
    """Seconds per candidate and state (`cmbrl.bench.studies.speed.candidates`)."""

    scene: str
    candidates: int
    one_by_one: Spread
    states_packed: Spread
    candidates_packed: Spread
    gain: Spread  # one by one over candidates packed
    gain_over_states: Spread  # states packed over candidates packed


@dataclass(frozen=True)
class SpeedTable:
    """All that one run measured."""

    rows: list[SpeedRow]
    scaling: list[BatchRow]
    candidates: list[CandidateRow]
    machine: str  # processor, instruction set, versions
    isa: str
    batch: int
    states: int
    repeats: int
    seed: int
    threads: int

    def tables(self) -> list[Table]:
        """Three: against MuJoCo, by batch and threads, candidates; medians, [lowest, highest] of the repeats."""
        return [self._main(), self._batches(), self._candidates()]

    def _main(self) -> Table:
        heads = ["scene", "MuJoCo", "contacts", "mj_step", "mjd_FD", "kappa", "forward", "+jacobian", "+vjp"]
        rows: list[list[Cell]] = []
        for row in self.rows:
            s = row.seconds
            differences = s.get("mjd_transitionFD")
            rows.append(
                [
                    row.scene,
                    f"{row.peer} {1e3 * row.time_step:.3g} ms",
                    round(row.contacts, 1),
                    _us(s["mj_step"].median),
                    "refused" if differences is None else _us(differences.median),
                    row.smoothing,
                    *(_us(s[kind].median) for kind in ("forward", "jacobian", "vjp", "torch")),
                    *(_ratio(row.ratios[f"mj_step/{kind}"]) for kind in ("forward", "jacobian", "vjp")),
                    None if differences is None else f"{row.ratios['mjd_transitionFD/jacobian'].median:.0f}",
                    ", ".join(f"{kind} {least:g}: {self._met(row, kind, least)}" for kind, least in AIMS[row.scene]),
                ]
            )
        failed = sum(row.failures for row in self.rows)
        note = f"ratios are MuJoCo / ours, above 1: ours is faster. {self.machine}"
        if failed:
            note += f"; our solver failed on {failed} of {self.states * len(self.rows)} states"
        title = (
            f"us per physics step on one core (batch {self.batch}, {self.states} visited states, median of "
            f"{self.repeats})"
        )
        columns = [*heads, "torch vjp", "step/forward", "step/jacobian", "step/vjp", "FD/jacobian", "aim"]
        return Table(title, columns, rows, note)

    @staticmethod
    def _met(row: SpeedRow, kind: str, least: float) -> str:
        return "met" if row.ratios[f"mj_step/{kind}"].median >= least else "missed"

    def _batches(self) -> Table:
        rows: list[list[Cell]] = [
            [r.scene, r.kind, r.batch, _us(r.one_thread.low), _us(r.threads.low), round(r.gain, 2)]
            for r in self.scaling
        ]
        columns = ["scene", "what", "batch", "1 thread", f"{self.threads} threads", "gain"]
        note = "fastest turn: other work on the machine counts"
        return Table("us of wall time per physics step (kappa 1e-4 J)", columns, rows, note)

    def _candidates(self) -> Table:
        columns = ["scene", "candidates", "one by one", "states packed", "candidates packed"]
        rows: list[list[Cell]] = []
        for r in self.candidates:
            costs = [_us(x.median) for x in (r.one_by_one, r.states_packed, r.candidates_packed)]
            met = "met" if r.gain.median >= CANDIDATE_AIM else "missed"
            gains = [_ratio(r.gain), _ratio(r.gain_over_states)]
            rows.append([r.scene, r.candidates, *costs, *gains, f"{CANDIDATE_AIM:g}: {met}"])
        title = "us per parameter candidate and state, one core (kappa 1e-4 J)"
        return Table(title, [*columns, "gain", "over states packed", "aim"], rows)

    def to_json(self) -> dict[str, Any]:
        """Plain data; seconds."""
        aims = {scene: dict(aim) for scene, aim in AIMS.items()}
        return {**asdict(self), "aims": aims, "candidate_aim": CANDIDATE_AIM}

    def plot(self, path: str | os.PathLike[str]) -> Path:
        """Draws the main table; ``path``: an image, or a folder, which gets ``speed.png``. Returns the file."""
        from cmbrl.bench.studies.speed.plots import plot  # matplotlib loads only when something is drawn

        file = Path(path) if Path(path).suffix else Path(path) / "speed.png"
        plot(self, file)
        return file


def _us(seconds: float) -> float:
    return float(f"{1e6 * seconds:.3g}")


def _ratio(ratio: Spread) -> str:
    return f"{ratio.median:.2f} [{ratio.low:.2f}, {ratio.high:.2f}]"
