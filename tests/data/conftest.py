"""A log that obeys q' = q (+) dt v', and a scene for it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cmbrl import Transitions
from cmbrl.scene import Scene

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


@pytest.fixture(scope="session")
def slides(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A scene of two slides and one motor."""
    return scene_of(
        tmp_path_factory.mktemp("slides"),
        "slides",
        """<body><joint name="left" type="slide" axis="1 0 0"/><geom size=".1"/></body>
        <body pos="0 1 0"><joint name="right" type="slide" axis="1 0 0"/><geom size=".1"/></body>""",
        '<motor name="motor" joint="left"/>',
    )


def scene_of(folder: Path, name: str, bodies: str, actuators: str = "") -> Scene:
    """The scene of an MJCF with these elements."""
    file = folder / f"{name}.xml"
    file.write_text(f'<mujoco model="{name}"><worldbody>{bodies}</worldbody><actuator>{actuators}</actuator></mujoco>')
    return Scene.from_mjcf(file)
