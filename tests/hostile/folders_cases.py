"""Damages a folder many times, by seed, and counts what comes of it; also by hand, with one line a fault:

python -m tests.hostile.folders_cases 100 "fit, error" "minari, load"
"""

from __future__ import annotations

import random
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from .folders_mutators import NothingToDo, transplant
from .folders_victims import VICTIMS
from .judge import FAULTS, RIGHT, WRONG, Outcome, outcome


@dataclass(frozen=True)
class Case:
    """One damaged folder: what was done to it and what came of using it."""

    victim: str
    seed: int
    damage: str
    outcome: Outcome

    def __str__(self) -> str:
        return f"{self.victim} #{self.seed}: {self.damage}: {self.outcome.kind}: {self.outcome.told}"


def cases(name: str, seeds: range, place: Path) -> Iterator[Case]:
    """The cases ``seeds`` of the victim ``name``; ``place`` is a folder to work in."""
    victim = VICTIMS[name]
    good, other, work = place / "good", place / "other", place / "work"
    for folder, seed in ((good, 0), (other, 1)):
        if not folder.exists():
            folder.mkdir(parents=True)
            victim.make(folder, seed)
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(good, work)
    expected = outcome(lambda: victim.use(work))
    assert expected.kind == RIGHT, expected
    mutators = (*victim.mutators, transplant(other / "victim"))
    for seed in seeds:
        rng = random.Random(seed)
        shutil.rmtree(work)
        shutil.copytree(good, work)
        try:
            damage = f"{(mutate := mutators[seed % len(mutators)]).__name__}: {mutate(work / 'victim', rng)}"
        except NothingToDo:
            continue
        found = outcome(lambda: victim.use(work))
        if found.kind == RIGHT:
            found = Outcome(RIGHT) if found.told == expected.told else Outcome(WRONG, str(found.told)[:100])
        yield Case(name, seed, damage, found)


def faults(found: list[Case]) -> list[str]:
    """One text a case that is neither right nor refused in one line."""
    return [str(case) for case in found if case.outcome.kind in FAULTS]


def main(count: int, names: list[str]) -> None:
    import torch

    torch.set_num_threads(1)
    for name in names or VICTIMS:
        with tempfile.TemporaryDirectory() as place:
            found = list(cases(name, range(count), Path(place)))
        counts = Counter(case.outcome.kind for case in found)
        print(f"{name}: {len(found)} cases: {', '.join(f'{n} {kind}' for kind, n in sorted(counts.items()))}")
        print("".join(f"  {line}\n" for line in faults(found)), end="", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
