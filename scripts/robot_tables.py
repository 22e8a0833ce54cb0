"""The tables of docs/robots.md, between its two marks, from what `cmbrl info` and `cmbrl check` said of each robot."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cmbrl.runs import environment

BEGIN, END = "<!-- tables: scripts/robots.py -->\n", "<!-- end of tables -->\n"
LIMIT = 0.05
COMMON = ("friction", "integrator", "capsules", "boxes")  # kinds of differences that the page tells once, for all
_SORTS = (  # words of `cmbrl info`, and a short name
    ("of its hull's", "hulls"),
    ("a flat side touches", "flat sides"),
    ("it stands on feet inside its rim", "rims"),
    ("touches other shapes as a", "{kind} stand-ins"),
    ("whatever a fit makes", "drag"),
    ("couple branches", "tendons"),
    ("solved or not", "MuJoCo stops early"),
)
_LICENSES = (  # words of a licence, and its name
    ("Apache License", "Apache 2.0"),
    ("Permission is hereby granted, free of charge", "MIT"),
    ("either the name", "BSD 3-clause"),
    ("Redistribution and use", "BSD 2-clause"),
)

Robot = Mapping[str, Any]


def page(text: str, robots: Mapping[str, Robot], folders: Mapping[str, Path]) -> str:
    """``text`` with the counts and tables of ``robots`` between its marks."""
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    good = {name: robot for name, robot in robots.items() if "why" not in robot}
    blocks = [
        "\n".join(textwrap.fill(count, 130, subsequent_indent="  ", break_on_hyphens=False) for count in _counts(good)),
        _table(("robot", "nv", "candidates", "modelled in another way, or left out", "licence"),
               [_what(name, robot, folders[name]) for name, robot in good.items()]),
        _table(("robot", "MuJoCo's laws: air, place", "floor", "default: air, place", "floor", "what differs",
                "derivative", "step", "with gradient"),
               [_measured(name, robot) for name, robot in good.items()]),
        *(f"{name}: {robot['why']}" for name, robot in robots.items() if "why" in robot),
        _made(robots),
    ]  # fmt: skip
    return before + BEGIN + "\n" + "\n\n".join(blocks) + "\n\n" + END + after


def _values(robot: Robot) -> dict[str, float]:
    return {check["name"]: check["value"] for check in robot["checks"]}


@dataclass(frozen=True)
class Steps:
    """Errors of steps under one choice of laws: in the air or in place, and on the floor."""

    air: float
    floor: float | None

    @property
    def worst(self) -> float:
        """The larger one."""
        return max(self.air, self.floor or 0.0)


def _steps(robot: Robot, law: str = "") -> Steps:
    """Under the default's laws; or with ", convex" under MuJoCo's."""
    found = _values(robot)
    air = found.get(f"step in place{law}", found.get(f"step above the floor{law}", float("nan")))
    return Steps(air, found.get(f"step on the floor{law}"))


def _counts(robots: Mapping[str, Robot]) -> Iterator[str]:
    values, count = [_values(robot) for robot in robots.values()], len(robots)
    default, nearest = ([_steps(robot, law) for robot in robots.values()] for law in ("", ", convex"))
    walkers = sum(steps.floor is not None for steps in default)

    def below(errors: Iterable[float | None]) -> int:
        return sum(error is not None and error <= LIMIT for error in errors)

    def slowest(name: str) -> int:
        return sum(value[name] < 1 for value in values)

    worst = max(value[name] for value in values for name in ("mass matrix", "bias force", "smooth force"))
    yield (
        f"- Mass matrix, bias force and all that acts without constraints (actuators, springs, dampers, fluids) are "
        f"MuJoCo's within {worst:.0e} of the largest entry, for every robot."
    )
    rows = [value["contact rows"] for value in values if "contact rows" in value]
    yield (
        f"- Contact rows, of {len(rows)} robots that touch something under random controls: the median is MuJoCo's "
        f"within 1e-9 for {sum(row <= 1e-9 for row in rows)}, within {max(rows):.0e} for the others."
    )
    worst = max(value["derivatives, worst"] for value in values)
    for steps, of in ((nearest, "under MuJoCo's laws"), (default, "by default")):
        air, floor, both = (below(getattr(s, name) for s in steps) for name in ("air", "floor", "worst"))
        yield (
            f"- One step {of}: error below {LIMIT} for {air} of {count} in the air or in place, for {floor} of "
            f"{walkers} on the floor; both together for {both}."
        )
    yield (
        f"- Near the home pose (`cmbrl check`), faster than `mj_step`: {slowest('time of a step')} of {count}; with "
        f"the vector-Jacobian product {slowest('time with gradient')}."
    )
    yield f"- The worst derivative of any robot is {worst:.1e} off finite differences."
    flagged = {name: value["wild states flagged"] for name, value in zip(robots, values, strict=True)}
    some = [f"{name} {share:.1e}" for name, share in flagged.items() if share]
    right = sum(value["wild states wrong"] == 0 for value in values)
    yield (
        f"- Wild states: {right} of {count} robots have none that is wrong or not finite, and {count - len(some)} none "
        f"whose solve fails and says so{'; shares of the others: ' if some else ''}{', '.join(some)}."
    )


def _what(name: str, robot: Robot, folder: Path) -> list[str]:
    info = robot["info"]
    return [name, str(info["nv"]), str(info["candidates"]), "; ".join(_approximations(info)), licence(folder)]


def _measured(name: str, robot: Robot) -> list[str]:
    found, default, nearest = _values(robot), _steps(robot), _steps(robot, ", convex")
    reasons = [re.sub(r"^step [^,]*, ", "", key) for key in found if re.match(r"step [^,]*, with", key)]
    times = [f"{found[key]:.2f}" for key in ("time of a step", "time with gradient")]
    errors = ["" if x is None else f"{x:.2g}" for x in (nearest.air, nearest.floor, default.air, default.floor)]
    return [name, *errors, ", ".join(dict.fromkeys(reasons)), f"{found['derivatives, worst']:.0e}", *times]


def _approximations(info: Mapping[str, Any]) -> Iterator[str]:
    """Differences of one sort as one: how many they are, and the largest size."""
    groups: dict[str, list[float]] = {}
    for found in info["differences"]:
        if found["kind"] not in COMMON:
            name = next((name for words, name in _SORTS if words in found["why"]), found["why"])
            sizes = [float(x) for x in re.findall(r"(\d[\d.e-]*) mm", found["why"])]
            groups.setdefault(name.format(kind=found["kind"]), []).append(max(sizes, default=0))
    for name, sizes in groups.items():
        yield f"{name}: {len(sizes)}" + (f", {max(sizes):g} mm" if max(sizes) else "")


def licence(folder: Path) -> str:
    """Name of the licence in a robot's folder."""
    text = " ".join((folder / "LICENSE").read_text(errors="replace").split())
    return next((name for words, name in _LICENSES if words in text), "see its folder")


def _table(columns: tuple[str, ...], rows: list[list[str]]) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "/") for cell in line) + " |" for line in lines)


def _made(robots: Mapping[str, Robot]) -> str:
    here = environment()
    states, wild = (max(robot[key] for robot in robots.values()) for key in ("states", "wild"))
    parts: dict[str, list[str]] = {}  # by commit, or several
    for part in next(iter(robots.values()))["commits"]:
        commits = " and ".join(sorted({robot["commits"][part][:7] for robot in robots.values()}))
        parts.setdefault(commits, []).append(part)
    made = "; ".join(f"{', '.join(names)} at commit {commits}" for commits, names in parts.items())
    return textwrap.fill(
        f"Made by scripts/robots.py: {states:,} states and {wild:,} wild states a robot; {made}; one thread of "
        f"{here['hardware']['processor']}; mujoco {here['versions']['mujoco']}.",
        130,
    )
