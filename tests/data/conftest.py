"""Logs that several tests read: drifting slides, recorded tasks, and an arm with servos or motors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cmbrl import Transitions
from cmbrl.data.position_log import PositionLog
from cmbrl.models.source import load_source
from cmbrl.registry import load_task
from cmbrl.scene import Scene

from .robots import arm_file, position_log, torque_log

MakeLog = Callable[..., Transitions]
Recorded = Callable[[str], tuple[Transitions, Scene]]


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


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    """``recorded(task)``: 1,500 transitions of a task under random actions, and its scene."""
    known: dict[str, tuple[Transitions, Scene]] = {}

    def record(name: str) -> tuple[Transitions, Scene]:
        pytest.importorskip("pymunk" if name.startswith("ball") else "gymnasium")
        if name not in known:
            task = load_task(name)
            known[name] = task.record(1500, 0, "random", None, None), load_source(name).scene
        return known[name]

    return record


@pytest.fixture(scope="module")
def servo(tmp_path_factory: pytest.TempPathFactory) -> tuple[PositionLog, Scene]:
    file = arm_file(tmp_path_factory.mktemp("servo"), servo=True)
    return position_log(file), Scene.from_mjcf(file)


@pytest.fixture(scope="module")
def motor(tmp_path_factory: pytest.TempPathFactory) -> tuple[Transitions, Scene]:
    file = arm_file(tmp_path_factory.mktemp("motor"), servo=False)
    return torque_log(file), Scene.from_mjcf(file)
