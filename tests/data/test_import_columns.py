"""What columns are: joints and quantities by their names, units, mappings and their mistakes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.data.importing.columns.targets import Target, match
from cmbrl.models.source import load_source
from cmbrl.scene import Scene

from .robots import arm_file


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene.from_mjcf(arm_file(tmp_path_factory.mktemp("columns"), servo=True))


@pytest.mark.parametrize(
    ("column", "target"),
    [
        ("elbow", Target("elbow", "position")),
        ("elbow_pos", Target("elbow", "position")),
        ("Elbow.vel", Target("elbow", "velocity")),
        ("joint_states.effort.elbow", Target("elbow", "torque")),
        ("tau_elbow", Target("elbow", "torque")),
        ("elbow_cmd", Target("elbow", "command")),
        ("action.elbow.pos", Target("elbow", "command")),
        ("observation.state.elbow.pos", Target("elbow", "position")),
        ("cmd.torque.elbow", Target("elbow", "torque")),
        ("elbow_pos_deg", Target("elbow", "position", np.pi / 180)),
        ("elbow_deg", Target("elbow", "position", np.pi / 180)),
        ("elbow_rpm", Target("elbow", "velocity", np.pi / 30)),
        ("elbow_speed_rpm", Target("elbow", "velocity", np.pi / 30)),
        ("ctrl.elbow", Target("elbow", "control")),
        ("time", Target("", "time")),
        ("timestamp_ms", Target("", "time", 1e-3)),
        ("Time [ms]", Target("", "time", 1e-3)),
        ("time (s)", Target("", "time", 1.0)),
        ("%time", Target("", "time", 1e-9)),
        ("elbow_actual", Target("elbow", "position")),
        ("actual.velocities.elbow", Target("elbow", "velocity")),
        ("episode_index", Target("", "episode")),
        ("elbow_temperature", None),
        ("elbow_cmd_vel", None),  # a commanded velocity is neither a velocity nor a target of the position
        ("elbow_acc", None),
        ("elbowroom", None),
        ("elbow_mystery", None),
        ("base.qw", None),  # nothing floats
    ],
)
def test_columns_are_known_by_their_names(column: str, target: Target | None, scene: Scene) -> None:
    assert match([column], {}, scene).get(column) == target


def test_a_floating_base_is_known_by_its_letters() -> None:
    robot = load_source("cube_toss").scene
    found = match(["qw", "mocap.x", "odom.wx", "cube.vz", "other.x", "x_error"], {}, robot)
    assert {column: target.quantity for column, target in found.items()} == {
        "qw": "qw", "mocap.x": "x", "odom.wx": "wx", "cube.vz": "vz",
    }  # fmt: skip
    assert match(["p"], {"p": "base.x:mm"}, robot)["p"] == Target("cube", "x", 1e-3)


BODIES = """<mujoco><worldbody>
<body><joint name="shoulder" type="ball"/><geom size=".1"/>
<body><joint name="elbow"/><geom size=".1" pos=".2 0 0"/></body></body>
<body name="cube" pos="1 0 0"><freejoint name="cube_joint"/><geom size=".1"/></body>
<body name="lid" pos="2 0 0"><freejoint name="lid"/><geom size=".1"/></body></worldbody>
<actuator><motor name="turn" joint="shoulder" gear="1 0 0"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("column", "target"),
    [
        ("shoulder_qw", Target("shoulder", "qw")),
        ("observation.shoulder.quat.qx", Target("shoulder", "qx")),
        ("shoulder.wz", Target("shoulder", "wz")),
        ("shoulder_x", None),  # which a ball joint does not have
        ("cube.x", Target("cube_joint", "x")),
        ("lid/pose/position/z", Target("lid", "z")),
        ("lid_error_x", None),
        ("elbow", Target("elbow", "position")),
        ("qw", None),  # of which body?
    ],
)
def test_ball_joints_and_several_bodies_are_known_by_their_names(
    column: str, target: Target | None, tmp_path: Path
) -> None:
    (tmp_path / "bodies.xml").write_text(BODIES)
    assert match([column], {}, Scene.from_mjcf(tmp_path / "bodies.xml")).get(column) == target


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"a": "elbo.position"}, "no joint 'elbo': did you mean 'elbow'"),
        ({"a": "elbow.positon"}, "joint 'elbow' has no 'positon': did you mean 'position'"),
        ({"a": "elbow.position:grad"}, "'grad' is no unit of this angle: did you mean 'rad'"),
        ({"a": "elbow.position:mm"}, "'mm' is no unit of this angle"),
        ({"a": "elbow.velocity:deg/s+3"}, r"'deg/s\+3' is no unit of this angular speed"),
        ({"a": "elbow.position:counts"}, "counts have no unit: give what one count is, such as 0.17578deg"),
        ({"a": "elbow.torque:-2raw"}, "counts have no unit: give what one count is, such as 0.01N m"),
        ({"a": "elbow.position:0deg"}, "give a factor other than 0"),
        ({"a": "elbow.position:1e999"}, "give a factor other than 0"),
        ({"a": "time:-1ms"}, "time goes forwards: give a positive factor"),
        ({"a": "episode:2"}, "episodes have no unit"),
        ({"a": "elbow.position:-grad+3"}, "'grad' is no unit of this angle"),
        ({"a": "elbow.torque:N"}, "'N' is no unit of this torque"),
        ({"a": "elbow.qw"}, "joint 'elbow' has no 'qw'"),
        ({"a": "elbow"}, "give JOINT.QUANTITY:UNIT"),
        ({"a": "pump.control"}, "no actuator 'pump'"),
        ({"a": "base.x"}, "no joint 'base'"),
        ({"I2 [A]": "elbow.torque"}, "has a unit that is none of this torque: .* as elbow.torque:0.01N m"),
        ({"raw_counts": "elbow.position"}, "has a unit that is none of this angle"),
        ({"c": "elbow.position"}, "no column 'c' in the log"),
        ({"a": "elbow.position", "b": "elbow.position"}, "two columns have the same target"),
    ],
)
def test_mistakes_in_a_mapping(given: dict[str, str], told: str, scene: Scene) -> None:
    with pytest.raises(UserError, match=told):
        match(["a", "b", "I2 [A]", "raw_counts"], given, scene)


@pytest.mark.parametrize(
    ("column", "text", "factor"),
    [
        ("J2 [deg]", "elbow.position", np.pi / 180),
        ("J2 [deg]", "elbow.position:-", -np.pi / 180),
        ("J2 [deg]", "elbow.position:rad", 1.0),
        ("M2 (mNm)", "elbow.torque", 1e-3),
        ("speed 2 rpm", "elbow.velocity", 2 * np.pi / 60),
        ("clock [ms]", "time", 1e-3),
        ("second axis", "elbow.position", 2 * np.pi),
        ("second axis", "elbow.position:0.5", 0.5),
        ("second axis", "elbow.torque", 1.0),
    ],
)
def test_names_of_mapped_columns_tell_units(column: str, text: str, factor: float, scene: Scene) -> None:
    """Where a mapping has none; otherwise hinges have the unit of angles."""
    assert match([column], {column: text}, scene, angles="rev")[column].factor == pytest.approx(factor)


def test_two_columns_of_one_name_and_how_to_choose(scene: Scene) -> None:
    with pytest.raises(
        UserError, match=r"'elbow' and 'elbow_measured' both look like elbow.position; drop one by --map"
    ):
        match(["elbow", "elbow_measured"], {}, scene)
    assert list(match(["elbow", "elbow_measured"], {"elbow": "-"}, scene)) == ["elbow_measured"]
    assert list(match(["elbow", "elbow_measured"], {"elbow": "elbow.position:deg"}, scene)) == ["elbow"]


@pytest.mark.parametrize(
    ("text", "factor", "zero"),
    [
        ("elbow.position:0.17578deg", np.radians(0.17578), 0.0),
        ("elbow.position:-0.5 deg-90", np.radians(-0.5), -np.pi / 2),
        ("elbow.position:0.00307", 0.00307, 0.0),
        ("elbow.command:2e-3+.5", 2e-3, 0.5),
        ("wrist.position:.5+-percent", 0.5 * 2.5 / 100, 0.0),
        ("elbow.velocity:-.5rpm", -np.pi / 60, 0.0),
        ("elbow.velocity:-deg/s", -np.pi / 180, 0.0),
        ("elbow.torque:-3.5mN m", -3.5e-3, 0.0),
        ("time:0.5ms", 5e-4, 0.0),
    ],
)
def test_factors_of_units(text: str, factor: float, zero: float, scene: Scene) -> None:
    found = match(["a"], {"a": text}, scene)["a"]
    assert (found.factor, found.zero) == pytest.approx((factor, zero))


def test_a_share_needs_a_range() -> None:
    text = '<mujoco><worldbody><body><joint name="wheel"/><geom size=".1"/></body></worldbody></mujoco>'
    with pytest.raises(UserError, match="joint 'wheel' has no range in the file to be a share of"):
        match(["a"], {"a": "wheel.position:percent"}, Scene.from_mjcf(text))
