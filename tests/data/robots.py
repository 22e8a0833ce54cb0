"""Logs of simulated robots for the checks of faults: an arm with servos or motors, and draws of such arms."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from cmbrl import Transitions
from cmbrl.data import plausible, read_trajectories
from cmbrl.data.position_log import PositionLog
from cmbrl.scene import Scene

JOINTS = ("shoulder", "elbow", "wrist")


def arm_file(folder: Path, servo: bool, rng: np.random.Generator | None = None) -> Path:
    """An arm of three links in a vertical plane; ``rng`` draws its masses, lengths, gains, friction and encoder."""

    def draw(low: float, high: float, usual: float) -> float:
        return usual if rng is None else float(rng.uniform(low, high))

    inner, after = "", ""
    for k, name in enumerate(JOINTS):
        length = draw(0.15, 0.4, 0.3)
        inner += (
            f'<body pos="0 0 {0 if k == 0 else -0.3:g}"><joint name="{name}" axis="0 1 0" range="-2.5 2.5" '
            f'damping="{draw(0.02, 1, 0.2):g}" armature="{draw(0.002, 0.03, 0.01):g}" '
            f'frictionloss="{draw(0, 0.3, 0.05):g}"/><geom type="capsule" fromto="0 0 0 0 0 {-length:g}" size=".03" '
            f'mass="{draw(0.2, 1.5, 0.5):g}" contype="0" conaffinity="0"/>'
        )
        after += "</body>"
    kp = draw(10, 100, 50)
    motors = "".join(
        f'<position name="{name}" joint="{name}" kp="{kp:g}" kv="{draw(0.5, 4, 2):g}"/>' if servo
        else f'<motor name="{name}" joint="{name}" gear="{draw(1, 5, 3):g}" ctrlrange="-1 1"/>'
        for name in JOINTS
    )  # fmt: skip
    file = folder / f"arm_{'servo' if servo else 'motor'}.xml"
    file.write_text(
        f'<mujoco model="arm"><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/>'
        f"<worldbody>{inner}{after}</worldbody><actuator>{motors}</actuator></mujoco>"
    )
    return file


def simulate(
    file: Path, command: np.ndarray, dt: float = 0.005, noise: float = 0.0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (T, n) of MuJoCo before each row of ``command`` (T, m), each held for ``dt``."""
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    q, v = np.zeros((len(command), model.nq)), np.zeros((len(command), model.nv))
    for k, row in enumerate(command):
        q[k], v[k] = data.qpos, data.qvel
        data.ctrl[:] = row
        for _ in range(round(dt / model.opt.timestep)):
            mujoco.mj_step(model, data)
    rng = np.random.default_rng(seed)
    return q + noise * rng.standard_normal(q.shape), v + 10 * noise * rng.standard_normal(v.shape)


def targets(rng: np.random.Generator, rows: int, dt: float) -> np.ndarray:
    """Chirps, steps or random walks (T, 3) as position targets."""
    t = np.arange(rows) * dt
    kind = rng.integers(3)
    if kind == 0:
        rate = rng.uniform(0.1, 3, 3)
        wave = [np.sin(2 * np.pi * (r * t + r * t**2 / t[-1]) + rng.uniform(0, 6)) for r in rate]
        return np.column_stack(wave) * rng.uniform(0.1, 0.8)
    if kind == 1:
        held = int(rng.integers(20, 200))
        return np.repeat(rng.uniform(-0.8, 0.8, (rows // held + 1, 3)), held, axis=0)[:rows]
    walk = np.cumsum(rng.standard_normal((rows, 3)), axis=0) * 0.03
    return 0.8 * np.sin(walk)


def position_log(file: Path, seed: int = 0, rows: int = 1500, noise: float = 2e-4, **other: object) -> PositionLog:
    """A log of the arm with servos under random targets, through an encoder with noise."""
    dt = 0.005
    command = targets(np.random.default_rng([seed, 1]), rows, dt)
    q, _ = simulate(file, command, dt, noise, seed)
    given = {"time": dt * np.arange(rows), "position": q, "command": command, "joint_names": JOINTS}
    return PositionLog(**{**given, **other})


def torque_log(file: Path, seed: int = 0, rows: int = 1500) -> Transitions:
    """Transitions of the arm with motors under random controls."""
    rng = np.random.default_rng([seed, 2])
    u = np.repeat(rng.uniform(-1, 1, (rows // 4 + 1, 3)), 4, axis=0)[:rows]
    q, v = simulate(file, u)
    scene = Scene.from_mjcf(file)
    return read_trajectories(q, [rows], 0.005, v, u, scene.difference)


def of_rows(q: np.ndarray, v: np.ndarray, dt: float, controls: int = 0) -> Transitions:
    """Transitions between the rows of ``q`` and ``v`` (T + 1, n), of one episode, under controls of 0."""
    u, episode = np.zeros((len(q) - 1, controls)), np.zeros(len(q) - 1, dtype=np.int64)
    return Transitions(q=q[:-1], v=v[:-1], u=u, q_next=q[1:], v_next=v[1:], dt=dt, episode=episode)


def swap(array: np.ndarray, a: int, b: int) -> np.ndarray:
    return array[:, [{a: b, b: a}.get(k, k) for k in range(array.shape[1])]]


def scale(array: np.ndarray, columns: int | slice, factor: float) -> np.ndarray:
    scaled = array.copy()
    scaled[:, columns] *= factor
    return scaled


def faults(log: Transitions, scene: Scene) -> list[str]:
    return [found.text for found in plausible.of_transitions(log.fields(), scene) if found.sure]
