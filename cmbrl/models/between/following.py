"""Joints that a log does not tell, followed along it by a model.

In every row, the model steps from what the log tells, and from where it has brought the others itself:

    x_(k+1) = f_x(q_k, v_k, x_k, u_k),    x = 0 at the beginning of an episode.

That is an observer without a correction. It forgets where it began where the joint is driven against a stop again and
again, as a play is within some hundredths of a second. So the parts of a long log are followed side by side, each from
a few rows earlier.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.models.between.log_reading import LogReading
    from cmbrl.scene.records import Joint

_FORGETS = 0.1  # [s]
_ROWS = 8  # least, to forget in
_PARTS = 64  # at most, side by side


def followed(model: LogReading, log: Transitions, theta: np.ndarray, joints: Sequence[Joint]) -> Transitions:
    """``log``, the model's state and control, with the hinges and slides ``joints`` as the model has them.

    theta: (np,), the model's parameters. A prediction that is not finite begins again from 0.
    """
    ahead, count = max(_ROWS, round(_FORGETS / log.dt)), len(log)
    size = -(-count // max(1, min(_PARTS, count // (2 * ahead))))
    begins = np.arange(0, count, size)
    fresh = np.append(True, np.diff(log.episode) != 0)
    places_q, places_v = ([getattr(joint, name) for joint in joints] for name in ("qadr", "vadr"))
    states = {name: getattr(log, name).copy() for name in ("q", "v", "q_next", "v_next")}
    at, rate = np.zeros((2, len(begins), len(joints)))
    for j in range(-ahead, size):
        rows = np.clip(begins + j, 0, count - 1)
        anew = fresh[rows] | (begins + j < 0)
        at[anew], rate[anew] = 0.0, 0.0
        q, v = log.q[rows], log.v[rows]
        q[:, places_q], v[:, places_v] = at, rate
        step = model.predict(q, v, log.u[rows], theta=theta)
        at, rate = _finite(step.q_next[:, places_q]), _finite(step.v_next[:, places_v])
        if j < 0:
            continue
        own = begins + j < count
        found = {"q": q[:, places_q], "v": v[:, places_v], "q_next": at, "v_next": rate}
        for name, value in found.items():
            states[name][np.ix_(rows[own], places_q if name.startswith("q") else places_v)] = value[own]
    goes_on = np.flatnonzero(~fresh[1:])  # also from part to part: a row ends where the next one begins
    for name, places in (("q", places_q), ("v", places_v)):
        states[f"{name}_next"][np.ix_(goes_on, places)] = states[name][np.ix_(goes_on + 1, places)]
    return replace(log, **states)


def _finite(x: np.ndarray) -> np.ndarray:
    return np.nan_to_num(x, posinf=0.0, neginf=0.0)
