"""A log that obeys q' = q (+) dt v', and a stand-in for the parts of a scene that the checks look at."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from cmbrl import Transitions

MakeLog = Callable[..., Transitions]


@pytest.fixture
def make_log() -> MakeLog:
    """``make_log(lengths=(5, 3), nq=2, nu=1)``: slides that drift at random, one episode per length."""

    def make(
        lengths: tuple[int, ...] = (5, 3), nq: int = 2, nu: int = 1, dt: float = 0.01, **about: object
    ) -> Transitions:
        rng = np.random.default_rng(0)
        parts = []
        for length in lengths:
            v = rng.standard_normal((length + 1, nq)).cumsum(axis=0)
            q = rng.standard_normal(nq) + dt * v.cumsum(axis=0)
            parts.append((q[:-1], v[:-1], rng.standard_normal((length, nu)), q[1:], v[1:]))
        q, v, u, q_next, v_next = (np.concatenate(part) for part in zip(*parts, strict=True))
        episode = np.repeat(np.arange(len(lengths)), lengths)
        return Transitions(q=q, v=v, u=u, q_next=q_next, v_next=v_next, dt=dt, episode=episode, **about)

    return make


@pytest.fixture
def slides() -> SimpleNamespace:
    """A scene of two slides and one motor."""
    return SimpleNamespace(
        name="slides",
        nq=2,
        nv=2,
        nu=1,
        joint_names=["left", "right"],
        actuator_names=["motor"],
        core=SimpleNamespace(jnt_type=np.zeros(2, np.int32), jnt_qadr=np.arange(2), jnt_vadr=np.arange(2)),
        difference=lambda q_from, q_to: q_to - q_from,
    )
