"""Readings that stand alone, and such that repeat the last one, in logs that no import has cleaned of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.contradicted import contradicted
from cmbrl.data.fields import Fields
from cmbrl.data.plausible.finding import Finding
from cmbrl.data.splitting import follows
from cmbrl.data.stale import filled, stale_rows
from cmbrl.data.stray import LONGEST, stray
from cmbrl.scene.records import JointKind

_OFTEN = 0.01  # of the rows: a late message now and then does no harm

if TYPE_CHECKING:
    from cmbrl.data.position_log import PositionLog
    from cmbrl.scene import Scene


def of_transitions(log: Fields, scene: Scene) -> Iterator[Finding]:
    """Positions of hinges and slides, velocities and controls of transitions."""
    goes_on = follows(log)
    ends = np.flatnonzero(~goes_on) + 1
    for joint in (each for each in scene.joints if each.kind != JointKind.BALL):
        name = scene.coordinate_names[joint.vadr]
        yield from _of(f"q of {name!r}", log["q"][:, joint.qadr], ends, turns=joint.kind == JointKind.HINGE)
    moved = scene.difference(log["q"], log["q_next"])
    for k, name in enumerate(scene.coordinate_names):
        yield from _of(f"v of {name!r}", log["v"][:, k], ends, moved=moved[:, k] / log["dt"])
    for k, name in enumerate(scene.actuator_names):
        yield from _of(f"u of {name!r}", log["u"][:, k], ends, commanded=True)
    single = [joint for joint in scene.joints if joint.kind != JointKind.BALL]
    names, places = [scene.coordinate_names[joint.vadr] for joint in single], [joint.qadr for joint in single]
    episode = np.concatenate([[0], np.cumsum(~goes_on)])
    yield from _repeating("q", names, log["q"][:, places], episode, "import the log as positions")


def of_positions(log: PositionLog, scene: Scene) -> Iterator[Finding]:
    """Positions, places of the base and commands of a position log."""
    ends, hinges = np.flatnonzero(np.diff(log.episode)) + 1, {j.vadr for j in scene.joints if j.kind == JointKind.HINGE}
    for k, (name, place) in enumerate(zip(log.joint_names, log.coordinates(scene).tolist(), strict=True)):
        yield from _of(f"joint_position of {name!r}", log.position[:, k], ends, turns=place in hinges)
    for k, name in enumerate("xyz" if log.base is not None and log.place_told else ""):
        yield from _of(f"{name} of base_position", log.base[:, k], ends)  # type: ignore[index]
    for k, name in enumerate(log.command_names):
        yield from _of(f"the command of {name!r}", log.command[:, k], ends, commanded=True)
    yield from _repeating("joint_position", log.joint_names, log.position, log.episode, "such rows are filled in")


def _repeating(
    what: str, names: Sequence[str], columns: np.ndarray, episode: np.ndarray, then: str
) -> Iterator[Finding]:
    """Columns (T, n) whose sensors are slower than the log."""
    shares = stale_rows(columns, episode).mean(axis=0)
    slow = [k for k in np.argsort(-shares, kind="stable").tolist() if shares[k] >= _OFTEN]
    if slow:
        others, share = f" (and of {len(slow) - 1} more)" if len(slow) > 1 else "", 100 * shares[slow[0]]
        yield Finding(
            f"{what} of {names[slow[0]]!r}{others} repeats its last reading in {share:.0f} % of the rows, while the "
            f"joint moves on: a sensor slower than the log; {then}",
            sure=False,
        )


def _of(
    column: str,
    x: np.ndarray,
    ends: np.ndarray,
    turns: bool = False,
    commanded: bool = False,
    moved: np.ndarray | None = None,
) -> Iterator[Finding]:
    """What stands alone in a column (T,) whose episodes begin at ``ends`` besides 0. ``turns``: it may go round.

    ``moved`` (T,), of a velocity: what its position moves by in a row, over the time step. It has to contradict.
    """
    for first, end in pairwise([0, *ends.tolist(), len(x)]):
        part = np.unwrap(x[first:end]) if turns else x[first:end]
        lone = stray(part, commanded)
        if moved is not None and lone.any():
            mended = filled(part[:, None], lone[:, None])[:, 0]
            lone = contradicted(lone, part, mended, moved[first : end - 1], 1.0)
        if lone.any():
            row = first + int(np.argmax(lone))
            yield Finding(
                f"{column} is {x[row]:.4g} in row {row}, after {x[row - 1]:.4g}, and back within {LONGEST} samples, "
                "as no motion is: a lost reading? `cmbrl import` fills such in",
                sure=False,
            )
            return
