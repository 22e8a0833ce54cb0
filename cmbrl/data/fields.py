"""The fields of a log as a plain dictionary: what readers return and writers take."""

from __future__ import annotations

from typing import Any, TypedDict

import numpy as np

ROWS = ("q", "v", "u", "q_next", "v_next")  #: the arrays with one row per transition, besides ``episode``


class Fields(TypedDict, total=False):
    """The arguments of :class:`~cmbrl.data.transitions.Transitions`, which documents and checks them."""

    q: np.ndarray
    v: np.ndarray
    u: np.ndarray
    q_next: np.ndarray
    v_next: np.ndarray
    dt: float
    episode: np.ndarray
    joint_names: tuple[str, ...]
    actuator_names: tuple[str, ...]
    source: dict[str, Any]
    recording: np.ndarray
