"""Perturbed real systems: each kind does what it says, and nothing else changes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.cli import main
from cmbrl.envs.perturbation import Perturbation, perturbed
from cmbrl.registry import load_task
from cmbrl.system import MujocoSystem, System

BALL = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="9 9 1" friction="1"/>
<body pos="0 0 0.1"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="2"/>
<body pos="0 0 0.2"><joint name="j" type="slide" axis="0 0 1"/><geom size="0.02" mass="0.1"/></body></body></worldbody>
<actuator><motor joint="j"/></actuator></mujoco>"""
HOPPER = load_task("hopper")


@pytest.fixture
def make(tmp_path: Path):  # type: ignore[no-untyped-def]
    (tmp_path / "box.xml").write_text(BALL)
    return lambda: MujocoSystem(tmp_path / "box.xml", frame_skip=5)


def rest(robot: System) -> np.ndarray:
    return np.array([0, 0, 0.1, 1, 0, 0, 0, 0.1])


def run(robot: System, steps: int, u: float = 0.0, speed: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    v = np.zeros(7)
    v[0] = speed
    robot.reset(rest(robot), v)
    for _ in range(steps):
        q, v = robot.step(np.array([u]))
    return q, v


def test_nothing_changes_nothing(make) -> None:  # type: ignore[no-untyped-def]
    ours, plain = perturbed(make, Perturbation())(), make()
    for a, b in zip(run(ours, 30, 0.5, 1.0), run(plain, 30, 0.5, 1.0), strict=True):
        np.testing.assert_array_equal(a, b)


def test_friction_decides_how_far_a_box_slides(make) -> None:  # type: ignore[no-untyped-def]
    """It stops after v^2 / (2 mu g)."""
    for friction in (0.2, 0.4):
        q, _ = run(perturbed(make, Perturbation(friction=friction))(), 100, speed=1.0)
        assert q[0] == pytest.approx(1.0 / (2 * friction * 9.81), rel=0.1)


ARM = """
<mujoco>
  <worldbody>
    <body><joint name="a" axis="0 0 1"/><geom size="0.1" mass="5"/>
      <body pos="0.2 0 0"><joint name="b" axis="0 1 0"/><geom size="0.1" mass="1"/>
        <body pos="0.2 0 0"><joint name="c" axis="0 1 0"/><geom size="0.1" mass="0.5"/></body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="a"/><motor joint="b"/><motor joint="c"/></actuator>
</mujoco>
"""


def test_payload_is_carried_by_the_heaviest_body(make) -> None:  # type: ignore[no-untyped-def]
    robot = perturbed(make, Perturbation(payload=3.0))()
    assert robot.robot.model.body_mass.tolist() == pytest.approx([0.0, 5.0, 0.1])  # type: ignore[attr-defined]
    assert make().model.body_mass[1] == 2.0  # others keep their own


def test_payload_is_carried_by_the_last_link_of_an_arm(tmp_path: Path) -> None:
    """Its heaviest link, which turns about the vertical, carries a payload without any effort."""
    (tmp_path / "arm.xml").write_text(ARM)
    robot = perturbed(lambda: MujocoSystem(tmp_path / "arm.xml"), Perturbation(payload=3.0))()
    assert robot.robot.model.body_mass.tolist() == pytest.approx([0.0, 5.0, 1.0, 3.5])  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("fingers", "root", "masses"),
    [
        ('<joint name="f" axis="1 0 0"/>', "", [5.0, 1.0, 3.5, 0.1]),  # a gripper without a motor of its own
        ('<joint name="f" axis="1 0 0"/>', '<joint name="r" axis="0 1 0"/>', [8.0, 1.0, 0.5, 0.1]),  # legs that swing
    ],
)
def test_fingers_without_motors_leave_a_payload_on_the_last_link(
    tmp_path: Path, fingers: str, root: str, masses: list[float]
) -> None:
    """The heaviest link of an arm with a gripper had taken it, though it turns about the vertical."""
    end = '<joint name="c" axis="0 1 0"/><geom size="0.1" mass="0.5"/>'
    text = ARM.replace(end, f'{end}<body pos="0.2 0 0">{fingers}<geom size="0.05" mass="0.1"/></body>')
    (tmp_path / "arm.xml").write_text(text.replace('<joint name="a"', f'{root}<joint name="a"'))
    robot = perturbed(lambda: MujocoSystem(tmp_path / "arm.xml"), Perturbation(payload=3.0))()
    assert robot.robot.model.body_mass[1:].tolist() == pytest.approx(masses)  # type: ignore[attr-defined]


def test_a_payload_is_on_what_moves(tmp_path: Path) -> None:
    """A heavy stand under a cart would carry it without any effect."""
    stand = '<body><geom size="0.1" mass="50"/><body><joint type="slide"/><geom size="0.1" mass="1"/></body></body>'
    (tmp_path / "cart.xml").write_text(f"<mujoco><worldbody>{stand}</worldbody></mujoco>")
    robot = perturbed(lambda: MujocoSystem(tmp_path / "cart.xml"), Perturbation(payload=3.0))()
    assert robot.robot.model.body_mass.tolist() == pytest.approx([0.0, 50.0, 4.0])  # type: ignore[attr-defined]


def test_a_push_changes_the_speed_once_in_two_seconds(make) -> None:  # type: ignore[no-untyped-def]
    robot = perturbed(make, Perturbation(push=0.5, friction=0.0), seed=3)()
    robot.reset(rest(robot), np.zeros(7))
    speeds = [np.linalg.norm(robot.step(np.zeros(1))[1][:2]) for _ in range(200)]
    jumps = np.flatnonzero(np.diff([0.0, *speeds]) > 0.3)
    assert len(jumps) == 1
    assert speeds[jumps[0]] == pytest.approx(0.5, rel=0.02)


def test_a_delayed_command_acts_later(make) -> None:  # type: ignore[no-untyped-def]
    robot, plain = perturbed(make, Perturbation(delay=0.004))(), make()
    run(robot, 1)
    run(plain, 1)
    q, v = robot.step(np.array([1.0]))
    expected = []
    for command, steps in ((0.0, 2), (1.0, 3)):
        plain.frame_skip = steps
        expected = list(plain.step(np.array([command])))
    np.testing.assert_array_equal(q, expected[0])
    np.testing.assert_array_equal(v, expected[1])


def test_a_contact_time_decides_how_deep_a_box_sinks(make) -> None:  # type: ignore[no-untyped-def]
    """At rest its compliance times its weight, which grows as the square of the time; steps get short enough for it."""
    found = {}
    for time in (0.04, 0.02, 0.002):
        robot = perturbed(make, Perturbation(contact_time=time))()
        found[time] = 0.1 - run(robot, 200)[0][2]
        assert robot.dt == make().dt
        assert 2 * robot.robot.model.opt.timestep <= time  # type: ignore[attr-defined]
    assert found[0.02] == pytest.approx(found[0.04] / 4, rel=0.3)  # impedance grows with depth, too
    assert found[0.002] == pytest.approx(found[0.02] / 100, rel=0.3)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"frction": 1.0}, "no perturbation 'frction'"),
        ({"push": -1.0}, "push"),
        ({"delay": float("nan")}, "delay"),
        ({"contact_time": 0.0}, "contact_time must be at least"),
    ],
)
def test_nonsense_is_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(UserError, match=message):
        Perturbation.of(values)


def test_what_a_robot_cannot_have_is_refused(make) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(UserError, match="longer than a control step"):
        perturbed(make, Perturbation(delay=0.02))
    assert HOPPER.system is not None
    with pytest.raises(UserError, match="free root"):
        perturbed(HOPPER.system, Perturbation(push=0.5))


def test_the_command_line_judges_a_policy_on_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_folder = str(tmp_path / "run")
    assert main(["train", "hopper", "--algorithm", "shac", "--out", run_folder, "--iterations", "1",
                 "--set=environments=2", "--set=horizon=2"]) == 0  # fmt: skip
    capsys.readouterr()
    assert main(["evaluate", run_folder, "--real", "--episodes", "2", "--perturb", "friction=0.2", "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)["in"]) == ["real"]
    assert main(["evaluate", run_folder, "--robustness", "--episodes", "1", "--json"]) == 0
    levels = json.loads(capsys.readouterr().out)["levels"]
    assert {one["perturbation"] for one in levels} == {
        "as it is",
        "friction",
        "payload",
        "delay",
        "contact_time",
    }  # no free root
    for typed in (
        ["--robustness", "--perturb", "friction=1"],
        ["--perturb", "frction=1"],
        ["--perturb", "push=x"],
        ["--robustness", "--model", "nominal"],
    ):
        assert main(["evaluate", run_folder, *typed]) == 2
