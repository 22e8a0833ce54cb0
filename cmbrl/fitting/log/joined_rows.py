"""Rows of a fast log of positions, taken together: a fit predicts seconds, and pays by rows.

Half a second ahead is 500 rows at 1 kHz, and the rows that a fit may predict are then a few windows, which lie in a
small part of the log. Longer rows tell as much: within 4 ms a joint does what the mean of its commands makes it do. So
several rows become one. Its command is their mean, which pushes by as much as they do together; the states at its ends
are those of the log, with velocities that all rows tell. The model steps as finely as its file says.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cmbrl.data.transitions import Transitions

LONGEST = 4e-3  #: [s] that rows taken together may last: a period of most controllers of joints
_ROUNDING = 1.05  # by which those of a clock that is a little slow may last longer


def rows_to_join(log: Transitions) -> int:
    """How many rows of ``log`` are one: as many as last no longer than ``LONGEST``; 1 where an episode is shorter."""
    count = int(LONGEST * _ROUNDING / log.dt)
    shortest = np.diff([*_begins(log), len(log)]).min()
    return count if 1 < count <= shortest else 1


def joined_rows(log: Transitions, count: int) -> Transitions:
    """``log`` with every ``count`` rows of an episode as one; what is left at the end of an episode goes."""
    if count == 1:
        return log
    begins = _begins(log)
    lengths = np.diff([*begins, len(log)])
    since = np.arange(len(log)) - np.repeat(begins, lengths)
    first = np.flatnonzero((since % count == 0) & (since + count <= np.repeat(lengths, lengths)))
    last = first + count - 1
    command = log.u[first[:, None] + np.arange(count)].mean(axis=1)
    return replace(log.select(first), u=command, q_next=log.q_next[last], v_next=log.v_next[last], dt=count * log.dt)


def _begins(log: Transitions) -> np.ndarray:
    """First rows of the episodes."""
    return np.flatnonzero(np.concatenate([[True], (np.diff(log.episode) != 0) | (np.diff(log.recording) != 0)]))
