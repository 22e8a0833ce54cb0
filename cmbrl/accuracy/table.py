"""The table of model errors, as text and as JSON."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from cmbrl.table import Cell, Table

PHYSICAL_COLUMNS = (  # column of the text table, key in Entry.physical, factor from SI
    ("position mm", "position", 1e3),
    ("angle mrad", "angle", 1e3),
    ("rotation mrad", "rotation", 1e3),
    ("velocity m/s", "position_velocity", 1.0),
    ("ang.vel. rad/s", "angle_velocity", 1.0),
    ("spin rad/s", "rotation_velocity", 1.0),
)
_LABEL = 20  # characters of a model's name in the text, so that it fits next to a stratum


@dataclass(frozen=True)
class Entry:
    """One model at one horizon in one stratum; `cmbrl.accuracy.compare` has the definitions."""

    model: str
    horizon: int  # steps
    stratum: str  # "all", "flight", "contact", "contact, moving", "contact, resting", "log NAME" of several
    windows: int
    error: float  # normalised RMSE, pooled
    median: float  # normalised, over windows
    physical: dict[str, float]  # kind of coordinate, or kind + "_velocity" -> RMSE [m, rad, m/s, rad/s]
    penetration_max_mm: float  # over predicted states: all, or some steps of each window if candidates are very many
    penetration_mean_mm: float  # mean over those states of the deepest penetration; zero without contact
    diverged: int  # windows with a prediction that is not finite
    failures: int | None  # steps whose solver did not converge, in "all" only; None: solves nothing
    step_microseconds: float | None  # processor time per step and window in a batch, in "all" only


@dataclass(frozen=True)
class Horizon:
    """What all models have in common at one horizon."""

    steps: int
    windows: dict[str, int]  # per stratum
    logged_penetration_max_mm: float  # of the logged states, from soft contact and noise
    logged_penetration_mean_mm: float


@dataclass(frozen=True)
class ErrorTable:
    """Errors of several models on one log."""

    entries: list[Entry]
    horizons: list[Horizon]
    curves: dict[str, list[float]]  # by model: error / state's std after 1, 2, ... steps of the longest windows
    contact_gap: float  # [m]
    dt: float  # [s]

    def entry(self, model: str, horizon: int, stratum: str = "all") -> Entry:
        """The entry for these; raises KeyError if there is none, because the log has no such window."""
        for found in self.entries:
            if (found.model, found.horizon, found.stratum) == (model, horizon, stratum):
                return found
        raise KeyError(f"no entry for {model!r}, {horizon} steps, {stratum!r}")

    @property
    def models(self) -> list[str]:
        """Names of the models, in order."""
        return list(dict.fromkeys(entry.model for entry in self.entries))

    def text(self) -> str:
        """A summary, then a table per horizon with a line per stratum and model; at most 100 columns wide."""
        rows: list[list[Cell]] = [
            [_shortened(m), *(self.entry(m, h.steps).error for h in self.horizons)] for m in self.models
        ]
        summary = Table(
            "normalised error by horizon (all strata)", ["model", *(_steps(h.steps) for h in self.horizons)], rows
        )
        return "\n\n".join([summary.text(), *(self._details(horizon) for horizon in self.horizons)])

    def _details(self, horizon: Horizon) -> str:
        unit = "change over a step" if horizon.steps == 1 else "state"
        touches = "contact" in horizon.windows  # otherwise all is flight, and nothing penetrates
        depth = (
            f"logged states penetrate {horizon.logged_penetration_max_mm:.2f} mm at most, "
            f"{horizon.logged_penetration_mean_mm:.3f} mm on average"
        )
        title = (
            f"{_steps(horizon.steps)} ({1e3 * horizon.steps * self.dt:g} ms): "
            f"error / standard deviation of the {unit}; {depth if touches else 'nothing touches'}"
        )
        entries = [
            entry
            for stratum in horizon.windows
            if touches or stratum != "flight"
            for entry in self.entries
            if (entry.horizon, entry.stratum) == (horizon.steps, stratum)
        ]
        columns: dict[str, list[Cell]] = {
            "stratum (windows)": [f"{e.stratum} ({e.windows})" if e.model == self.models[0] else "" for e in entries],
            "model": [_shortened(e.model) for e in entries],
            "error": [e.error for e in entries],
            "median": [e.median for e in entries],
            "diverged": [e.diverged or None for e in entries],
            "failed": [e.failures for e in entries],
            "us/step": [e.step_microseconds for e in entries],
            **{
                title: [factor * e.physical[key] if key in e.physical else None for e in entries]
                for title, key, factor in PHYSICAL_COLUMNS
            },
            "max.pen. mm": [e.penetration_max_mm if touches else None for e in entries],
            "mean pen. mm": [e.penetration_mean_mm if touches else None for e in entries],
        }
        shown = {name: cells for name, cells in columns.items() if any(cell is not None for cell in cells)}
        return Table(title, list(shown), list(zip(*shown.values(), strict=True))).text()

    def to_json(self) -> dict[str, Any]:
        """JSON types in SI units (mm where a name says so); None replaces values that are not finite."""
        return {
            "dt": self.dt,
            "contact_gap": self.contact_gap,
            "horizons": [_plain(asdict(h)) for h in self.horizons],
            "entries": [_plain(asdict(e)) for e in self.entries],
            "curves": _plain(self.curves),
        }


def _steps(count: int) -> str:
    return "1 step" if count == 1 else f"{count} steps"


def _shortened(name: str) -> str:
    """The end of a long name, which tells folders apart."""
    return name if len(name) <= _LABEL else "..." + name[-(_LABEL - 3) :]


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
