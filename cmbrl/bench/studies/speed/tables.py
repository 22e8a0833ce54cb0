"""Tables of the speed study: medians over turns with [lowest, highest]."""

from __future__ import annotations

from typing import Any

from cmbrl.bench.studies.speed.growth import SIZES, exponents
from cmbrl.bench.study import Cell, Table
from cmbrl.bench.words import Words

WORDS = Words("cmbrl.bench.studies.speed")
NAMES = {
    "mj_step": "mj_step", "mjd_transitionFD": "mjd_FD", "forward": "step", "vjp": "+VJP", "jacobian": "+Jacobian",
}  # fmt: skip
COSTS = ("alone", "states_packed", "candidates_packed")


def tables(values: dict[str, Any]) -> list[Table]:
    """Times against MuJoCo's, their ratios, times by batch and threads, candidates, single environments."""
    return [_times(values), _ratios(values), _batches(values), _candidates(values), *_environments(values)]


def _times(values: dict[str, Any]) -> Table:
    rows: list[list[Cell]] = []
    for row in values["rows"]:
        us = {kind: _us(spread["median"]) for kind, spread in row["seconds"].items()}
        rows.append(
            [
                row["scene"], row["smoothing"], f"{row['peer']} {1e3 * row['time_step']:.3g} ms",
                round(row["contacts"], 1), us["mj_step"], us.get("mjd_transitionFD", "refused"),
                *(us[kind] for kind in ("forward", "jacobian", "vjp", "torch")),
            ]
        )  # fmt: skip
    failed, total = sum(row["failures"] for row in values["rows"]), values["states"] * len(values["rows"])
    note = [WORDS("tables.times.note"), values["machine"] + "."]
    note += [WORDS("tables.times.failed", failed=failed, total=total)] if failed else []
    columns = ["scene", "kappa", "MuJoCo", "contacts", "mj_step", "mjd_FD", "step", "+Jacobian", "+VJP", "torch VJP"]
    return Table(WORDS("tables.times.title", **values), columns, rows, " ".join(note))


def _ratios(values: dict[str, Any]) -> Table:
    kinds = ("mj_step/forward", "mj_step/jacobian", "mj_step/vjp", "mjd_transitionFD/jacobian")
    rows: list[list[Cell]] = [
        [row["scene"], row["smoothing"], *(_ratio(row["ratios"].get(kind)) for kind in kinds)] for row in values["rows"]
    ]
    columns = ["scene", "kappa", "mj_step / step", "mj_step / Jacobian", "mj_step / VJP", "mjd_FD / Jacobian"]
    return Table(WORDS("tables.ratios.title"), columns, rows, WORDS("tables.ratios.note"))


def _batches(values: dict[str, Any]) -> Table:
    rows: list[list[Cell]] = [
        [r["scene"], r["kind"], r["batch"], _us(r["one_thread"]["low"]), _us(r["threads"]["low"]), round(r["gain"], 2)]
        for r in values["scaling"]
    ]
    columns = ["scene", "what", "batch", "1 thread", f"threads={values['threads']}", "gain"]
    return Table(WORDS("tables.batches.title"), columns, rows, WORDS("tables.batches.note"))


def _candidates(values: dict[str, Any]) -> Table:
    rows: list[list[Cell]] = [
        [r["scene"], r["candidates"], *(_us(r[cost]["median"]) for cost in COSTS),
         _ratio(r["gain"]), _ratio(r["gain_over_states"])]
        for r in values["candidates"]
    ]  # fmt: skip
    columns = ["scene", "candidates", *(cost.replace("_", " ") for cost in COSTS), "gain", "gain over states packed"]
    return Table(WORDS("tables.candidates.title"), columns, rows, WORDS("tables.candidates.note"))


def _environments(values: dict[str, Any]) -> list[Table]:
    """None where neither robot was asked for."""
    rows: list[list[Cell]] = [
        [*r["ids"], _us(r["ours"]["low"]), _us(r["theirs"]["low"]), _ratio(r["ratio"])] for r in values["environments"]
    ]
    columns = ["ours", "Gymnasium's", "ours [us]", "Gymnasium's [us]", "ratio"]
    text = WORDS("tables.environments.title"), WORDS("tables.environments.note")
    return [Table(text[0], columns, rows, text[1])] if rows else []


def growth_tables(values: dict[str, Any]) -> list[Table]:
    """One of each of what grows, ending with the exponents; none of what was not asked for."""
    found = []
    for what in SIZES:
        rows = [row for row in values["growth"] if row["what"] == what]
        if not rows:
            continue
        kinds = list(rows[0]["seconds"])
        cells: list[list[Cell]] = [[row["size"], *(_us(row["seconds"][k]["median"]) for k in kinds)] for row in rows]
        powers = exponents(rows)
        cells.append(["exponent", *(round(powers[k], 2) for k in kinds)])
        title, note = WORDS(f"tables.growth.{what}"), WORDS("tables.growth.note")
        found.append(Table(title, [what, *(NAMES[k] for k in kinds)], cells, note))
    return found


def robot_tables(values: dict[str, Any]) -> list[Table]:
    """Microseconds and ratios by robot, and how many of them are faster than MuJoCo."""
    known = [row for row in values["rows"] if "refused" not in row]
    kinds = ("mj_step", "forward", "vjp", "jacobian", "mjd_transitionFD")
    cells: list[list[Cell]] = []
    for row in values["rows"]:
        if "refused" in row:
            cells.append([row["scene"], *[None] * 13])
            continue
        us = [_us(row["seconds"][k]["median"]) if k in row["seconds"] else None for k in kinds]
        us.append(_us(row["laws"]["seconds"]["forward"]["median"]))
        times = [_of_turns(row, k) for k in ("mj_step/forward", "mj_step/vjp", "mjd_transitionFD/jacobian")]
        times.append(_of_turns(row["laws"], "mj_step/forward"))
        cells.append([row["scene"], row["nv"], row["candidates"], round(row["contacts"], 1), *us, *times])
    faster = {k: sum(row["ratios"][f"mj_step/{k}"]["median"] >= 1 for row in known) for k in ("forward", "vjp")}
    laws = sum(row["laws"]["ratios"]["mj_step/forward"]["median"] >= 1 for row in known)
    note = [WORDS("tables.robots.note", count=len(cells), laws=laws, **faster), values["machine"] + "."]
    note += [f"Not modelled: {row['refused']}." for row in values["rows"] if "refused" in row]
    ratios = ["mj_step / step", "mj_step / VJP", "mjd_FD / Jacobian", "mj_step / laws"]
    columns = ["robot", "nv", "candidates", "contacts", *(NAMES[k] for k in kinds), "laws", *ratios]
    return [Table(WORDS("tables.robots.title", **values), columns, cells, "\n".join(note))]


def _of_turns(row: dict[str, Any], kind: str) -> float | None:
    return round(row["ratios"][kind]["median"], 2) if kind in row["ratios"] else None


def _us(seconds: float) -> float:
    return float(f"{1e6 * seconds:.3g}")


def _ratio(spread: dict[str, float] | None) -> str | None:
    return None if spread is None else f"{spread['median']:.2f} [{spread['low']:.2f}, {spread['high']:.2f}]"
