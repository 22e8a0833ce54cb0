"""Mechanisms made of equality constraints and tendons hold together as they move."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from cmbrl.contact import Exact
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

from .tied_scenes import (
    HARD,
    OPTION,
    PLANAR,
    arm,
    equality,
    skip_if_another_law,
    write,
)


def roll(scene: Scene, steps: int, u: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """States after each of ``steps`` steps under the constant control u, from rest at q0."""
    model = ComplementarityModel(scene, smoothing=Exact())
    q, v = scene.q0[None], np.zeros((1, scene.nv))
    for _ in range(steps):
        r = model.predict(q, v, u[None])
        assert r.status[0] == SolverStatus.CONVERGED
        q, v = r.q_next, r.v_next
        yield q[0], v[0]


def mujocos_end(file: Path, steps: int, u: np.ndarray) -> np.ndarray:
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    data.ctrl[:] = u
    for _ in range(steps):
        mujoco.mj_step(model, data)
    return np.array(data.qpos)


def test_four_bar_linkage(tmp_path: Path) -> None:
    """A crank and a rocker, joined by a connect, that a motor turns: the joint stays shut, and all is as in MuJoCo."""
    skip_if_another_law("<connect")
    bar = (
        '<body name="{}" pos="{}"><joint name="{}" axis="0 1 0"/>'
        '<geom type="capsule" fromto="0 0 0 {}" size=".01" mass=".2" contype="0"/>{}</body>'
    )
    coupler = bar.format("coupler", "0 0 .1", "c", ".3 0 .2", "")
    world = bar.format("crank", "0 0 0", "crank", "0 0 .1", coupler) + bar.format("rocker", ".3 0 0", "r", "0 0 .3", "")
    rest = equality(f'<connect body1="coupler" body2="rocker" anchor=".3 0 .2" {HARD}/>')
    rest += '<actuator><motor joint="crank"/></actuator>'
    file = write(tmp_path, world, rest)
    scene, u = Scene.from_mjcf(file), np.array([0.3])
    assert scene.planar
    ends = list(roll(scene, 100, u))
    assert abs(ends[-1][0][0]) > 0.5  # the crank has turned
    pos, rot = scene.body_poses(np.array([q for q, _ in ends]))
    away = pos[:, 1] + rot[:, 1] @ [0.3, 0.2] - pos[:, 2] - rot[:, 2] @ [0.0, 0.3]
    assert np.linalg.norm(away, axis=1).max() < 1e-3
    np.testing.assert_allclose(ends[-1][0], mujocos_end(file, 100, u), atol=1e-9)


def test_hanging_chain_of_connects(tmp_path: Path) -> None:
    """30 free rods, tied to each other and to the world, let go level: joints stay shut, no energy appears."""
    n, length = 30, 0.1
    rods = "".join(
        f'<body name="r{k}" pos="{(k + 0.5) * length} 0 0"><freejoint/><geom type="capsule" size=".01" mass=".1" '
        f'fromto="{-0.5 * length} 0 0 {0.5 * length} 0 0" contype="0"/></body>'
        for k in range(n)
    )
    ties = "".join(f'<connect body1="r{k}" body2="r{k - 1}" anchor="{-0.5 * length} 0 0" {HARD}/>' for k in range(1, n))
    file = write(tmp_path, rods, equality(f'<connect body1="r0" anchor="{-0.5 * length} 0 0" {HARD}/>', ties))
    scene = Scene.from_mjcf(file)
    model = ComplementarityModel(scene)
    ends = list(roll(scene, 300, np.zeros(0)))
    q, v = (np.array(part) for part in zip(*ends, strict=True))
    pos, rot = scene.body_poses(q)
    half = np.array([0.5 * length, 0.0, 0.0])
    left, right = pos - rot @ half, pos + rot @ half
    gaps = np.linalg.norm(left[:, 1:] - right[:, :-1], axis=2).max(), np.linalg.norm(left[:, 0], axis=1).max()
    assert max(gaps) < 0.004  # the softness of MuJoCo's defaults under the pull of all rods
    M = model.smooth_dynamics(q, v)["M"]
    energy = 0.5 * np.einsum("bi,bij,bj->b", v, M, v) + 9.81 * 0.1 * pos[:, :, 2].sum(axis=1)
    assert pos[-1, -1, 2] < -0.8  # it has fallen
    assert energy.max() < 0.05  # of 44 J to fall
    assert energy.min() > -4.5


def test_mimic_gripper_holds_a_ball(tmp_path: Path) -> None:
    """A motor closes one finger, the other follows by a joint equality; a ball between them stays in the air."""
    finger = (
        '<body name="{0}" pos="{1} 0 .3"><joint name="{0}" type="slide" axis="{2} 0 0" damping="1"/>'
        '<geom type="box" size=".01 .05 .05" mass=".1" friction="1" contype="2" conaffinity="0"/></body>'
    )
    ball = (
        '<body pos="0 0 .3"><freejoint/><geom size=".03" mass=".02" friction="1" conaffinity="2" contype="0"/></body>'
    )
    rest = equality('<joint joint1="left" joint2="right"/>') + '<actuator><motor joint="right"/></actuator>'
    world = finger.format("left", "-.045", "1") + finger.format("right", ".045", "-1") + ball
    scene = Scene.from_mjcf(write(tmp_path, world, rest))
    q = np.array([q for q, _ in roll(scene, 500, np.array([4.0]))])
    assert np.abs(q[:, 0] - q[:, 1]).max() < 2e-3
    assert 0.003 < q[-1, 0] < 0.007  # shut on the ball
    assert abs(q[-1, 4] - 0.3) < 0.01


def test_weld_holds_a_body(tmp_path: Path) -> None:
    skip_if_another_law("<weld")
    geom = '<geom type="box" size=".1 .2 .05" mass="2"/>'
    body = f'<body name="f" pos=".1 .2 .3" quat="1 .2 .3 .4"><freejoint/>{geom}</body>'
    file = write(tmp_path, body, equality(f'<weld body1="f" {HARD}/>'))
    scene = Scene.from_mjcf(file)
    end = list(roll(scene, 300, np.zeros(0)))[-1][0]
    assert np.abs(end[:3] - scene.q0[:3]).max() < 1e-4
    np.testing.assert_allclose(end, mujocos_end(file, 300, np.zeros(0)), atol=1e-9)


def test_tendon_shares_its_pull_between_fingers(tmp_path: Path) -> None:
    """One tendon over two fingers: when the first is at its limit the other goes on, as in an underactuated hand."""
    finger = (
        '<body pos="0 {1} 0"><joint name="{0}" axis="0 1 0" range="-1 {2}" limited="true" armature=".01"/>'
        '<geom type="capsule" fromto="0 0 0 .1 0 0" size=".01" mass=".05" contype="0"/></body>'
    )
    rest = (
        '<tendon><fixed name="t"><joint joint="x" coef=".02"/><joint joint="y" coef=".02"/></fixed></tendon>'
        '<actuator><position tendon="t" kp="200" kv="30"/></actuator>'
    )
    world = finger.format("x", "0", "0.2") + finger.format("y", ".1", "1.5")
    text = "<compiler angle='radian'/>" + OPTION.format("implicitfast").replace("/>", ' gravity="0 0 0"/>')
    file = tmp_path / "scene.xml"
    file.write_text(f"<mujoco>{text}<worldbody>{world}</worldbody>{rest}</mujoco>", encoding="utf-8")
    scene, u = Scene.from_mjcf(file), np.array([0.02])
    q = np.array([q for q, _ in roll(scene, 3000, u)])
    early = q[: np.argmax(q[:, 0] > 0.15)]
    assert np.abs(early[:, 0] - early[:, 1]).max() < 1e-6  # they share it
    assert q[:, 0].max() < 0.21
    assert abs(q[-1].sum() - 1.0) < 0.05  # length 0.02
    assert q[-1, 1] > 0.7


def test_limits_of_a_tendon(tmp_path: Path) -> None:
    """Two joints fall until their sum is at its limit, though neither has one of its own."""
    sum_of_both = '<joint joint="a0" coef="1"/><joint joint="a1" coef="1"/>'
    rest = f'<tendon><fixed name="t" limited="true" range="-2 .5" solreflimit=".004 1">{sum_of_both}'
    scene = Scene.from_mjcf(write(tmp_path, arm(PLANAR, 2), rest + "</fixed></tendon>"))
    assert scene.line_names[scene.core.lim_line[0]] == "t"
    q = np.array([q for q, _ in roll(scene, 600, np.zeros(0))])
    assert 0.5 < q.sum(axis=1).max() < 0.53
    assert q[:, 0].max() > 0.7
