"""What came out of a sweep: a table of its runs, the arms against each other with intervals, and learning curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.cli.sweep.plan import Arm, Plan
from cmbrl.table import Cell, Table

Results = Mapping[str, Sequence[dict[str, Any]]]  #: of the cells, by arm
RESAMPLES = 10_000  #: of the bootstrap over seeds


def runs(plan: Plan, arm: Arm, results: Sequence[dict[str, Any]]) -> Table:
    """A line a seed, then median, lowest and highest of every number."""
    lines = [_numbers(one) for one in results]
    names = list(dict.fromkeys(name for line in lines for name in line))
    rows: list[list[Cell]] = [
        [seed, *(line.get(name) for name in names)] for seed, line in zip(arm.seeds, lines, strict=True)
    ]
    for name, measure in (("median", np.median), ("lowest", np.min), ("highest", np.max)):
        known = [[x for line in lines if isinstance(x := line.get(key), int | float)] for key in names]
        rows.append([name, *(float(measure(x)) if x else None for x in known)])
    title = f"{plan.command}, {len(arm.seeds)} seeds"
    return Table(f"{arm.name}: {title}" if arm.name else title, ["seed", *names], rows)


def comparison(plan: Plan, results: Results) -> Table:
    """Every arm's mean with its interval, and its difference from the first arm over the seeds that both have."""
    first = plan.arms[0]
    base = _scores(first, results[first.name])
    rows: list[list[Cell]] = []
    for arm in plan.arms:
        own = _scores(arm, results[arm.name])
        both = sorted(own.keys() & base.keys())
        gain = np.array([own[seed] - base[seed] for seed in both])
        apart = "" if arm is first or not len(gain) else f"{gain.mean():+.4g} {_interval(gain)}"
        values = np.array(list(own.values()))
        mean = f"{values.mean():.4g} {_interval(values)}" if len(values) else "none finished"
        more = _means([_numbers(one) for one in results[arm.name]])
        rows.append([arm.name, len(arm.seeds), mean, apart, *(more.get(name) for name in _shared(results))])
    columns = ["arm", "seeds", "return: mean [95 %]", f"difference to {first.name} [95 %]", *_shared(results)]
    note = "Return in the real system where it was tried there, else in training. Intervals: bootstrap over seeds."
    return Table("arms", columns, rows, note)


def text(plan: Plan, results: Results) -> str:
    """Question, what would count as an answer, the arms' comparison, and every run."""
    told = [f"Question: {plan.question}"] * bool(plan.question) + [f"An answer: {plan.answer}"] * bool(plan.answer)
    compared = [comparison(plan, results).text()] if len(plan.arms) > 1 else []
    return "\n\n".join([*told, *compared, *(runs(plan, arm, results[arm.name]).text() for arm in plan.arms)])


def plot(plan: Plan, results: Results, file: Path) -> None:
    """Learning curves over samples and over processor time: every run thin, the median of an arm bold."""
    from cmbrl.bench.figures import legend_below, panels, save

    figure, ((left, right),) = panels(1, 2, 11.0, 4.8, sharey=True)
    for k, arm in enumerate(plan.arms):
        curves = [one["curve"] for one in results[arm.name] if one.get("curve", {}).get("return")]
        for axes, along in ((left, samples), (right, _seconds)):
            lines = [(along(curve), _numbers_of(curve["return"])) for curve in curves]
            for line in lines:
                axes.plot(*line, lw=0.5, alpha=0.5, color=f"C{k}")
            if lines:
                axes.plot(*_median(lines), lw=2.0, color=f"C{k}", label=arm.name or plan.command)
    left.set(xlabel="model steps and real transitions", ylabel="return of training episodes")
    right.set(xlabel="processor time [s]")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    legend_below(figure, ncols=2)
    save(figure, file)


def _numbers_of(values: Sequence[float | None]) -> np.ndarray:
    return np.array([np.nan if x is None else x for x in values], dtype=float)


def samples(curve: Mapping[str, Sequence[float | None]]) -> np.ndarray:
    """What a run had seen of model and real system together: algorithms that act in either one compare by it."""
    seen = [np.nan_to_num(_numbers_of(curve[name])) for name in ("steps", "transitions") if name in curve]
    return np.sum(seen, axis=0) if seen else _numbers_of(curve["iteration"])


def _seconds(curve: Mapping[str, Sequence[float | None]]) -> np.ndarray:
    """Of processors: runs side by side slow each other down. Runs of earlier versions have the wall clock only."""
    return _numbers_of(curve.get("processor_seconds", curve["seconds"]))


def _median(lines: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Over runs, where all of them are."""
    at = np.linspace(0.0, min(along[-1] for along, _ in lines), 80)
    return at, np.median([np.interp(at, along, _filled(values)) for along, values in lines], axis=0)


def _filled(values: np.ndarray) -> np.ndarray:
    """Gaps take the value before them; those at the start the first one."""
    known = np.flatnonzero(np.isfinite(values))
    if not len(known):
        return np.zeros_like(values)
    last = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), known[0]))
    filled: np.ndarray = values[last]
    return filled


def _numbers(one: dict[str, Any]) -> dict[str, Cell]:
    """What a table shows of a run."""
    found: dict[str, Cell] = dict(one["result"])
    for where, judged in one.get("judged", {}).items():
        found[f"{where} return"] = judged["return"]["mean"]
        shown = {name: value for name, value in judged.items() if isinstance(value, int | float)}
        found |= {f"{where} {name.removeprefix('mean_')}": value for name, value in shown.items()}
    return found


def _shared(results: Results) -> list[str]:
    """Numbers that all arms have besides their returns."""
    names = [_means([_numbers(one) for one in cells]) for cells in results.values()]
    return [name for name in names[0] if "return" not in name and all(name in other for other in names)]


def _means(lines: Sequence[dict[str, Cell]]) -> dict[str, float]:
    known: dict[str, list[float]] = {}
    for line in lines:
        for name, value in line.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                known.setdefault(name, []).append(float(value))
    return {name: float(np.mean(values)) for name, values in known.items() if name != "iteration"}


def _scores(arm: Arm, results: Sequence[dict[str, Any]]) -> dict[int, float]:
    """Return by seed; a run that diverged has none."""
    found = {}
    for seed, one in zip(arm.seeds, results, strict=True):
        value = _numbers(one).get("real return", one["result"].get("return"))
        if isinstance(value, int | float):
            found[seed] = float(value)
    return found


def _interval(values: np.ndarray) -> str:
    """95 % of the mean, by the percentile bootstrap; nothing for fewer than three values."""
    if len(values) < 3:
        return ""
    rng = np.random.default_rng(0)
    means = values[rng.integers(len(values), size=(RESAMPLES, len(values)))].mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return f"[{low:.4g}, {high:.4g}]"
