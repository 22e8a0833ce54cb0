"""A gripper's second finger has no column: the file ties it to the first, and an import follows the tie."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl import Scene, Transitions, UserError
from cmbrl.data.estimation import estimated
from cmbrl.data.importing import Options, import_logs
from cmbrl.data.position_log import PositionLog

ROWS, DT = 200, 0.01
GRIPPER = """<mujoco><compiler angle="radian"/><option timestep="0.002"/><worldbody>
<body name="arm"><joint name="lift" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02"/>
{fingers}</body></worldbody>
<equality>{ties}</equality>
<actuator><position joint="lift" kp="20" kv="1"/><position joint="left" kp="50" kv="5"/></actuator></mujoco>"""
TIES = '<joint joint1="right" joint2="left" polycoef=".01 -1 2 0 0"/><joint joint1="right" joint2="tip"/>'
FINGERS = (
    '<body name="b_{0}" pos="{1} 0 -.25"><joint name="{0}" type="slide" axis="0 1 0"/>'
    '<geom type="sphere" size=".01" contype="0" conaffinity="0"/></body>'
)


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    file = tmp_path / "gripper.xml"
    fingers = "".join(FINGERS.format(name, 0.1 * k) for k, name in enumerate(("left", "right", "tip")))
    file.write_text(GRIPPER.format(fingers=fingers, ties=TIES))
    return Scene.from_mjcf(file)


def columns(velocity: bool) -> dict[str, np.ndarray]:
    time = DT * np.arange(ROWS)
    lift, left = 0.3 * np.sin(3 * time), 0.02 + 0.01 * np.cos(4 * time)
    found = {"time": time, "lift": lift, "left": left, "lift_cmd": lift, "left_cmd": left}
    return found | ({"lift_vel": 0.9 * np.cos(3 * time), "left_vel": -0.04 * np.sin(4 * time)} if velocity else {})


def test_a_tied_joint_follows_by_the_polynomial_of_the_file(scene: Scene, tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", **columns(velocity=False))
    found = import_logs([tmp_path / "log.npz"], scene)
    assert isinstance(found.log, PositionLog)
    at = {name: found.log.position[:, k] for k, name in enumerate(found.log.joint_names)}
    np.testing.assert_allclose(at["right"], 0.01 - at["left"] + 2 * at["left"] ** 2, atol=1e-12)
    np.testing.assert_allclose(at["tip"], at["right"], atol=1e-12)
    assert "right has no column: it follows left, to which the file ties it" in found.notes
    assert "tip has no column: it follows right, to which the file ties it" in found.notes


def test_its_velocity_follows_by_the_slope(scene: Scene, tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", **columns(velocity=True))
    log = import_logs([tmp_path / "log.npz"], scene).log
    assert isinstance(log, Transitions)
    left, right = scene.joint_names.index("left"), scene.joint_names.index("right")
    np.testing.assert_allclose(log.v[:, right], (4 * log.q[:, left] - 1) * log.v[:, left], atol=1e-12)


def test_what_is_logged_does_not_follow(scene: Scene, tmp_path: Path) -> None:
    table = columns(velocity=False)
    np.savez(tmp_path / "log.npz", **table, right=0.9 * table["left"], tip=table["left"])
    found = import_logs([tmp_path / "log.npz"], scene)
    assert isinstance(found.log, PositionLog)
    np.testing.assert_allclose(found.log.position[:, found.log.joint_names.index("right")], 0.9 * table["left"])
    assert not [note for note in found.notes if "follows" in note]


def test_joints_that_nothing_tells_can_be_held(scene: Scene, tmp_path: Path) -> None:
    table = {name: column for name, column in columns(velocity=False).items() if not name.startswith("left")}
    np.savez(tmp_path / "log.npz", **table)
    with pytest.raises(UserError, match=r"no column for left.position: .*--hold left --hold right --hold tip`; "):
        import_logs([tmp_path / "log.npz"], scene)


def test_columns_that_may_be_the_commands_are_listed(scene: Scene, tmp_path: Path) -> None:
    table = columns(velocity=True)
    np.savez(tmp_path / "log.npz", **{name.replace("_cmd", "_mystery"): column for name, column in table.items()})
    with pytest.raises(UserError, match=r"log.npz: no column for actuator .*lift.command.*not used: lift_mystery"):
        import_logs([tmp_path / "log.npz"], scene, Options())


def test_a_position_log_needs_no_column_of_it_either(scene: Scene) -> None:
    """One that was written by hand, for `cmbrl fit` without an import."""
    table = columns(velocity=False)
    log = PositionLog(
        time=table["time"], position=np.column_stack([table["lift"], table["left"]]), joint_names=("lift", "left"),
        command=np.column_stack([table["lift_cmd"], table["left_cmd"]]),
    )  # fmt: skip
    found = estimated(log, scene)
    lift, left, right, tip = (scene.joint_names.index(name) for name in ("lift", "left", "right", "tip"))
    np.testing.assert_allclose(found.q[:, lift], table["lift"][:-1], atol=1e-12)
    np.testing.assert_allclose(found.q[:, right], 0.01 - found.q[:, left] + 2 * found.q[:, left] ** 2, atol=1e-12)
    np.testing.assert_allclose(found.v[:, right], (4 * found.q[:, left] - 1) * found.v[:, left], atol=1e-12)
    np.testing.assert_allclose(found.v[:, tip], found.v[:, right], atol=1e-12)
    alone = replace(log, position=log.position[:, :1], command=log.command[:, :1], joint_names=("lift",))
    with pytest.raises(UserError, match=r"joint 'left' of scene .* is not in the log"):
        estimated(alone, scene)
