"""What a sweep runs: one configuration, or several that differ in a few options (arms), each under its seeds."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cmbrl.cli.configuration import read_configuration
from cmbrl.errors import UserError
from cmbrl.text import shortened

MOST = 100_000  #: seeds of one arm
COMMANDS = ("train", "fit")
OWN = {"command", "seed", "out", "resume", "threads", "json"}  # decided by the sweep
_ABOUT = ("question", "answer", "arms", "seeds", "judge")


@dataclass(frozen=True)
class Arm:
    """Options of ``command`` and seeds; ``name`` is empty where there is only one arm."""

    name: str
    options: Mapping[str, Any]
    seeds: Sequence[int]

    @property
    def folder(self) -> str:
        """Name of its folder in that of the sweep."""
        return re.sub(r"[^a-z0-9.=-]+", "_", self.name.lower()).strip("_")


@dataclass(frozen=True)
class Plan:
    """``question`` and ``answer`` say what the arms are for, and what would count as an answer.

    judge: episodes in the real system and in the model that each trained policy is tried in; 0: none.
    """

    command: str
    arms: Sequence[Arm]
    question: str = ""
    answer: str = ""
    judge: int = 0

    @classmethod
    def read(cls, file: Path, given: Sequence[int] | None, only: Sequence[str] | None = None) -> Plan:
        """The plan in a YAML or JSON file; ``given`` seeds replace its own. ``only``: names of arms; None for all.

        Raises UserError for a file that is none, for arms that share a folder or are not in it, and where no seeds are
        given.
        """
        options = dict(read_configuration(file))
        command = options.get("command")
        if command not in COMMANDS:
            raise UserError(f"{file}: no `command: train` or `command: fit` in it: add the line that says which to run")
        about = {name: options.pop(name, None) for name in _ABOUT}
        for name in ("question", "answer"):
            if not isinstance(about[name] or "", str):
                raise UserError(f"{file}: {name} is not a text")
        judge = about["judge"] or 0
        if not isinstance(judge, int) or not 0 <= judge <= 10_000 or (judge and command != "train"):
            raise UserError(f"{file}: judge: give a number of episodes, for `command: train`")
        arms = about["arms"] or {"": {}}
        if not isinstance(arms, dict) or not all(isinstance(a, dict | None) for a in arms.values()):
            raise UserError(f"{file}: arms: give a mapping of names to the options in which they differ")
        own = {name: value for name, value in options.items() if name not in OWN}
        found = []
        for name, changes in arms.items():
            more = dict(changes or {})
            if fixed := [option for option in more if option in OWN]:
                raise UserError(f"{file}: {name}: {fixed[0]!r} is decided by the sweep: leave it out of the arm")
            chosen = given or _seeds_of(file, more.pop("seeds", about["seeds"]))
            found.append(Arm(str(name), _merged(own, more), chosen))
        folders = [arm.folder for arm in found]
        if len(set(folders)) < len(folders) or (len(found) > 1 and "" in folders):
            raise UserError(f"{file}: arms: give each a name of its own, of letters and digits")
        if unknown := [name for name in only or () if name not in [arm.name for arm in found]]:
            has = "; ".join(arm.name for arm in found if arm.name) or "none"
            raise UserError(f"{file}: no arm {shortened(unknown[0])!r}; its arms: {has}")
        found = [arm for arm in found if only is None or arm.name in only]
        return cls(command, found, about["question"] or "", about["answer"] or "", judge)


def seeds(text: str) -> list[int]:
    """``A:B`` or a list of whole numbers, each once."""
    try:
        first, colon, last = text.partition(":")
        found = range(int(first), int(last)) if colon else [int(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{shortened(text)!r} is neither A:B nor a list of whole numbers") from None
    if colon and found and found[-1] - found[0] >= MOST:
        raise argparse.ArgumentTypeError(f"{shortened(text)!r}: give at most {MOST} seeds")
    if not found or len(set(found)) < len(found) or min(found) < 0 or max(found) >= 2**31:
        raise argparse.ArgumentTypeError(
            f"{shortened(text)!r}: give at least one seed, each once, from 0 to 2147483647"
        )
    return list(found)


def _seeds_of(file: Path, held: Any) -> list[int]:
    if held is None:
        raise UserError(f"{file}: has no seeds: add `seeds: 0:10`, or give --seeds")
    if not isinstance(held, str | list):  # YAML reads a plain 3:6 as a number to the base 60
        raise UserError(f"{file}: seeds: write them as '3:6' in quotes, or as a list")
    try:
        return seeds(",".join(map(str, held)) if isinstance(held, list) else held)
    except argparse.ArgumentTypeError as error:
        raise UserError(f"{file}: seeds: {error}") from None


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """``changes`` over ``base``; hyperparameters (``set``) one by one."""
    both = {**base, **changes}
    if isinstance(base.get("set"), dict) and isinstance(changes.get("set"), dict):
        both["set"] = {**base["set"], **changes["set"]}
    return both
