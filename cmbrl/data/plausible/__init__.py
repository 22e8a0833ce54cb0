"""Faults of a log that its own numbers show: a stuck sensor, swapped columns, signs, units, rates, two robots in one.

Everything here compares columns with each other and with what the file of the robot says for sure (limits, gravity,
the sign of motors), never with masses or friction, which a fit is to find; only whether torques hold any weight at all
needs them, up to a factor. A check that is sure raises, others warn.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import TYPE_CHECKING

from cmbrl.data.fields import Fields
from cmbrl.data.plausible import (
    alone,
    base,
    commands,
    early,
    elsewhen,
    flight,
    forces_elsewhen,
    frames,
    joined,
    lagging,
    limits,
    motion,
    overlap,
    ranges,
    rate,
    readings,
    slipped,
    still,
    targets,
    units,
    unlimited,
    weight,
)
from cmbrl.data.plausible.finding import Finding, trusting

if TYPE_CHECKING:
    from cmbrl.data.position_log import PositionLog
    from cmbrl.scene import Scene

__all__ = ["Finding", "check_positions", "check_transitions", "of_positions", "of_transitions", "trusting"]


def check_transitions(log: Fields, scene: Scene) -> None:
    """Raises UserError for the first sure fault of transitions, warns of likely ones, or of all: :func:`trusting`."""
    for finding in of_transitions(log, scene):
        finding.tell()


def check_positions(log: PositionLog, scene: Scene) -> None:
    """The same for a position log."""
    for finding in of_positions(log, scene):
        finding.tell()


def of_transitions(log: Fields, scene: Scene) -> Iterator[Finding]:
    """All faults of transitions, the most telling first."""
    yield from units.clock(log["dt"])
    yield from ranges.of_transitions(log, scene)
    found = motion.of_transitions(log, scene)
    yield from targets.as_forces(found, scene)
    yield from forces_elsewhen.forces_elsewhen(found, scene)
    yield from _of_motion(found)
    yield from still.turned(log["q"], found.blocks, scene)
    yield from readings.angular(log, scene)
    yield from frames.angular(log, scene)
    yield from flight.free_fall(log["q"], found.blocks, log["dt"], scene)
    yield from frames.unexplained(log, scene)
    yield from weight.untold(found, scene)
    yield from overlap.of_transitions(log, scene)
    yield from alone.of_transitions(log, scene)


def of_positions(log: PositionLog, scene: Scene) -> Iterator[Finding]:
    """All faults of a position log, the most telling first."""
    yield from units.clock(log.dt)
    yield from base.of_positions(log, scene)
    yield from ranges.of_positions(log, scene)
    found = motion.of_positions(log, scene)
    yield from targets.as_forces(found, scene)
    yield from forces_elsewhen.forces_elsewhen(found, scene)
    yield from _of_motion(found)
    yield from weight.untold(found, scene)
    yield from overlap.of_positions(log, scene)
    yield from alone.of_positions(log, scene)


def _of_motion(found: motion.Motion) -> Iterator[Finding]:
    answers = found.answers()
    return chain(
        units.of_commands(found, answers),
        limits.beyond_limits(found),
        limits.mirrored(found),
        limits.past_stops(found),
        still.stuck(found),
        units.turns(found),
        unlimited.unlimited(found),
        joined.joined(found),
        slipped.slipped(found),
        units.velocities(found),
        rate.off(found),
        lagging.late(found),
        elsewhen.elsewhen(found, answers),
        commands.servos(found, answers),
        commands.forces(found, answers),
        early.early(found),
        joined.offsets(found),
        commands.saturation(found),
    )
