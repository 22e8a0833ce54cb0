"""The table of model errors: as text, as JSON, as a picture."""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

# column of the text table, its unit there, key in Entry.physical, factor from SI
PHYSICAL_COLUMNS = (
    ("position", "mm", "position", 1e3),
    ("angle", "mrad", "angle", 1e3),
    ("rotation", "mrad", "rotation", 1e3),
    ("velocity", "m/s", "position_velocity", 1.0),
    ("ang.vel.", "rad/s", "angle_velocity", 1.0),
    ("spin", "rad/s", "rotation_velocity", 1.0),
)


@dataclass(frozen=True)
class Entry:
    """One model at one horizon in one stratum; see `cmbrl.accuracy` for the definitions."""

    model: str
    horizon: int  # steps
    stratum: str  # "all", "flight", "contact", "contact, moving", "contact, resting"
    windows: int
    error: float  # normalised RMSE, pooled
    median: float  # normalised, over windows
    physical: dict[str, float]  # kind of coordinate, or kind + "_velocity" -> RMSE [m, rad, m/s, rad/s]
    penetration_max_mm: float  # over all states predicted on the way
    penetration_mean_mm: float  # mean over those states of the deepest penetration, zero when apart
    diverged: int  # windows whose prediction is not finite
    failures: int | None  # steps whose solver did not converge; None: solves nothing, or counted in "all"
    step_microseconds: float | None  # wall time of one step of one window in a batch; in "all" only


@dataclass(frozen=True)
class Horizon:
    """What is common to all models at one horizon."""

    steps: int
    windows: dict[str, int]  # per stratum
    logged_penetration_max_mm: float  # of the logged states: soft contact and noise of the real system
    logged_penetration_mean_mm: float


@dataclass(frozen=True)
class ErrorTable:
    """Errors of several models on one log."""

    entries: list[Entry]
    horizons: list[Horizon]
    curves: dict[str, list[float]]  # per model: error after 1, 2, ... steps of the longest windows, by the state's std
    contact_gap: float  # [m]
    dt: float  # [s]

    def entry(self, model: str, horizon: int, stratum: str = "all") -> Entry:
        """The entry of that name; raises KeyError when there is none (the log may have no such window)."""
        for found in self.entries:
            if (found.model, found.horizon, found.stratum) == (model, horizon, stratum):
                return found
        raise KeyError(f"no entry for {model!r}, {horizon} steps, {stratum!r}")

    @property
    def models(self) -> list[str]:
        """Names of the models, in the order given."""
        return list(dict.fromkeys(entry.model for entry in self.entries))

    def text(self) -> str:
        """A summary, then one block per horizon with a line per stratum and model."""
        blocks = [_aligned(self._summary_rows(), "normalised error by horizon (all strata)")]
        for horizon in self.horizons:
            steps = "1 step" if horizon.steps == 1 else f"{horizon.steps} steps"
            unit = "change over a step" if horizon.steps == 1 else "state"
            title = (
                f"{steps} ({1e3 * horizon.steps * self.dt:g} ms): error / standard deviation of the {unit}; "
                f"logged states penetrate {horizon.logged_penetration_max_mm:.2f} mm at most, "
                f"{horizon.logged_penetration_mean_mm:.3f} mm on average"
            )
            blocks.append(_aligned(self._detail_rows(horizon), title))
        return "\n\n".join(blocks)

    def _summary_rows(self) -> list[list[str]]:
        rows = [["model", *(f"{h.steps} step{'s' * (h.steps > 1)}" for h in self.horizons)]]
        for model in self.models:
            rows.append([model, *(_number(self.entry(model, h.steps).error) for h in self.horizons)])
        return rows

    def _detail_rows(self, horizon: Horizon) -> list[list[str]]:
        entries = [entry for entry in self.entries if entry.horizon == horizon.steps]
        columns = [column for column in PHYSICAL_COLUMNS if column[2] in entries[0].physical]
        heads = ["stratum (windows)", "model", "error", "median", *(f"{title} {unit}" for title, unit, _, _ in columns)]
        rows = [[*heads, "pen. max mm", "mean mm", "diverged", "failed", "us/step"]]
        for stratum, windows in horizon.windows.items():
            for entry in (entry for entry in entries if entry.stratum == stratum):
                first = entry.model == self.models[0]
                rows.append(
                    [
                        f"{stratum} ({windows})" if first else "",
                        entry.model,
                        _number(entry.error),
                        _number(entry.median),
                        *(_number(factor * entry.physical[key]) for _, _, key, factor in columns),
                        _number(entry.penetration_max_mm),
                        _number(entry.penetration_mean_mm),
                        str(entry.diverged) if entry.diverged else "-",
                        "-" if entry.failures is None else str(entry.failures),
                        _number(entry.step_microseconds),
                    ]
                )
        return rows

    def to_json(self) -> dict[str, Any]:
        """Plain data in SI units (mm where a name says so); what is not finite is None, as JSON knows no infinity."""
        return {
            "dt": self.dt,
            "contact_gap": self.contact_gap,
            "horizons": [_plain(asdict(h)) for h in self.horizons],
            "entries": [_plain(asdict(e)) for e in self.entries],
            "curves": _plain(self.curves),
        }

    def plot(self, path: str | os.PathLike[str]) -> Path:
        """Draws error against horizon and by stratum; returns the file.

        ``path``: an image (its suffix, .png, .svg or .pdf, is the format), or a folder, which gets ``error.png``.
        """
        from cmbrl.accuracy.plots import plot  # matplotlib loads only when something is drawn

        file = Path(path) if Path(path).suffix else Path(path) / "error.png"
        plot(self, file)
        return file


def _number(value: float | None) -> str:
    """Three significant digits in few characters."""
    if value is None:
        return "-"
    if not math.isfinite(value):
        return str(value)
    if value != 0 and not 1e-4 <= abs(value) < 1e5:
        return f"{value:.2g}"
    digits = 3 if value == 0 else max(0, min(6, 2 - math.floor(math.log10(abs(value)))))
    return f"{value:.{digits}f}"


def _aligned(rows: list[list[str]], title: str) -> str:
    """Rows under a title; text columns to the left, number columns to the right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    words = {k for k, head in enumerate(rows[0]) if head.startswith(("model", "stratum"))}
    lines = [title]
    for row in rows:
        cells = [
            cell.ljust(w) if k in words else cell.rjust(w) for k, (cell, w) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append(("  " + "  ".join(cells)).rstrip())
    return "\n".join(lines)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
