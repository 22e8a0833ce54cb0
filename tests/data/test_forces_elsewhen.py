"""Torques of another time are told by what motion explains of them; those of their time, or random ones, are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl import Scene, Transitions, UserError
from cmbrl.data import read_trajectories
from cmbrl.data.plausible import forces_elsewhen, motion
from cmbrl.data.position_log import PositionLog

from .robots import JOINTS, arm_file, torque_log

DT = 0.005


@pytest.fixture(scope="module")
def steered(tmp_path_factory: pytest.TempPathFactory) -> tuple[np.ndarray, np.ndarray, np.ndarray, Path]:
    """Positions, velocities and controls (T, 3) of an arm whose controller follows sums of sines by its torques."""
    file = arm_file(tmp_path_factory.mktemp("steered"), servo=False)
    model = mujoco.MjModel.from_xml_path(str(file))
    data, rng, time = mujoco.MjData(model), np.random.default_rng(0), DT * np.arange(2400)
    rate, phase = rng.uniform(0.15, 1.2, (3, 4)), rng.uniform(0.0, 6.3, (3, 4))
    goal = 0.3 * np.sin(2 * np.pi * rate * time[:, None, None] + phase).sum(axis=2)
    rows = []
    for each in goal:
        control = np.clip(np.array([12.0, 8.0, 3.0]) * (each - data.qpos) - 0.3 * data.qvel, -1.0, 1.0)
        rows.append((data.qpos + 1e-4 * rng.normal(size=3), data.qvel + 5e-3 * rng.normal(size=3), control))
        data.ctrl[:] = control
        mujoco.mj_step(model, data, nstep=round(DT / model.opt.timestep))
    q, v, u = (np.array(column) for column in zip(*rows, strict=True))
    return q, v, u, file


def of_states(q: np.ndarray, v: np.ndarray, u: np.ndarray, scene: Scene) -> Transitions:
    return read_trajectories(q, [len(q)], DT, v, u, scene.difference)


@pytest.mark.parametrize("by", [600, -400])
def test_controls_of_another_time(by: int, steered: tuple[np.ndarray, np.ndarray, np.ndarray, Path]) -> None:
    q, v, u, file = steered
    scene = Scene.from_mjcf(file)
    of_states(q, v, u, scene).check(scene)
    words = r"u of 'shoulder' and \d more go with how joints move .* of another time or episode\? --command-offset {}"
    with pytest.raises(UserError, match=words.format({600: r"(3|2\.9)", -400: r"-(2|1\.9)"}[by])):
        of_states(q, v, np.roll(u, by, axis=0), scene).check(scene)


def test_torques_of_another_time_beside_positions_alone(
    steered: tuple[np.ndarray, np.ndarray, np.ndarray, Path],
) -> None:
    q, _, u, file = steered
    scene, time = Scene.from_mjcf(file), DT * np.arange(len(q))
    log = PositionLog(time=time, position=q, command=3.0 * u, command_kind="torque", joint_names=JOINTS)
    log.check(scene)
    with pytest.raises(UserError, match=r"torque of 'shoulder' and \d more go with how joints move .* another time"):
        replace(log, command=np.roll(3.0 * u, 600, axis=0)).check(scene)


def test_random_controls_and_those_of_another_motion_tell_no_time(
    steered: tuple[np.ndarray, np.ndarray, np.ndarray, Path],
) -> None:
    q, v, _, file = steered
    scene, rng = Scene.from_mjcf(file), np.random.default_rng(1)
    smooth = np.sin(2 * np.pi * rng.uniform(0.15, 1.2, 3) * DT * np.arange(len(q))[:, None])
    for log in (torque_log(file), of_states(q, v, rng.uniform(-1, 1, q.shape), scene), of_states(q, v, smooth, scene)):
        assert list(forces_elsewhen.forces_elsewhen(motion.of_transitions(log.fields(), scene), scene)) == []
