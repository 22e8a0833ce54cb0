"""What the study of smoothing does, fixed before its first judged run: arms, settings tried, seeds, sizes, verdicts.

The question and what counts as an answer are in ``text.toml``; the report begins with them. The scales overlap: a
constant kappa of 1 J acts over 1.4 mm on the ball, 1 kJ over 4 cm; a Gaussian of 10 cm has 1.6 kJ at contact.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

from cmbrl.bench.studies.throws.cells import TASKS

HARD, CONSTANT, GAUSSIAN, PUBLISHED = "hard", "constant", "Gaussian", "published (ABS)"
FAMILIES = (HARD, CONSTANT, GAUSSIAN, PUBLISHED)
AIM = 0.05  #: [m] from the goal: a hit
EQUAL = 0.05  #: differences within this count as none: share of hits, or of the rival's mean distance
REACHED = 0.05  #: where no arm has this share of hits, distances are judged instead


@dataclass(frozen=True)
class Arm:
    """A softening as ``--derivative`` takes it, in the simulation too if ``both``, and the learning rate of Adam."""

    softening: str
    both: bool = False
    rate: float = 0.1

    @property
    def label(self) -> str:
        """Unique."""
        return f"{self.softening}{', both' * self.both}, rate {self.rate:g}"


@dataclass(frozen=True)
class Size:
    """Of descents: updates of a decision by Adam, throws per update, random launches per seed."""

    updates: int
    throws: int = 2
    launches: int = 12


def settings() -> dict[str, list[Arm]]:
    """Family -> what is tried of it."""
    constants = [f"barrier:kappa=1e{k}" for k in range(-6, 4)]
    lengths = ("3e-5", "1e-4", "3e-4", "1e-3", "1e-2", "1e-1")
    gaussians = [f"gaussian:length={x},derivative={how}" for x, how in product(lengths, ("exact", "stop"))]
    peaks = ("1e-6", "1e-5", "1e-4", "1e-3", "1e-2", "1", "1e2")
    published = [f"abs:peak={peak},reach={reach}" for peak, reach in product(peaks, ("1e-2", "1e-1"))]
    soft = {CONSTANT: constants, GAUSSIAN: gaussians, PUBLISHED: published}
    return {HARD: [Arm("exact")]} | {
        family: [Arm(softening, both) for both, softening in product((False, True), names)]
        for family, names in soft.items()
    }


@dataclass(frozen=True)
class Plan:
    """Sizes of the study.

    rungs: of successive halving; after each but the last, one in ``keep`` of every family goes on. The first is long
    enough to cross the range of launches, since soft settings start slowly: after 12 updates the order was that of
    hardness in two scenes. rates: of Adam, on the last rung; on the others 0.1. judged: the runs that count. timed:
    descents that tell what an update costs; equal seconds are those of the cheapest arm's judged run. longer: updates
    of the check of convergence.
    """

    tasks: tuple[str, ...] = tuple(TASKS)
    tried: dict[str, list[Arm]] = field(default_factory=settings)
    rungs: tuple[Size, ...] = (Size(30, launches=24), Size(60, launches=24))
    keep: int = 5
    rates: tuple[float, ...] = (0.1, 0.3)
    choosing: tuple[int, ...] = (110, 111, 112)  #: seeds
    judged: Size = field(default_factory=lambda: Size(200, launches=16))
    seeds: tuple[int, ...] = tuple(range(300, 310))  #: fresh
    longer: int = 400
    longer_seeds: int = 5
    timed: Size = field(default_factory=lambda: Size(4, launches=16))
    turns: int = 3  #: of arms whose seconds are measured


QUICK = Plan(
    tried={HARD: [Arm("exact")], CONSTANT: [Arm("barrier:kappa=1e-2"), Arm("barrier:kappa=1")],
           GAUSSIAN: [Arm("gaussian:length=1e-2,derivative=stop")], PUBLISHED: [Arm("abs:peak=1,reach=1e-1")]},
    rungs=(Size(2, launches=2), Size(4, launches=2)), rates=(0.1,), choosing=(100,),
    judged=Size(6, launches=4), seeds=(200, 201, 202), longer=8, longer_seeds=1,
    timed=Size(1, launches=1), turns=1,
)  # fmt: skip
