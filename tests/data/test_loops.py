"""Joints that no log tells, because closed loops do: a gripper's links behind its one encoder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl.data.estimation import estimated
from cmbrl.data.importing import import_logs
from cmbrl.data.importing.build import configurations
from cmbrl.data.loop_gaps import gaps, slope
from cmbrl.data.loops import closed, closing, to_hold
from cmbrl.data.position_log import PositionLog
from cmbrl.errors import UserError
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

FOUR_BAR = """<mujoco><option gravity="0 0 0"/><worldbody><body name="crank"><joint name="crank" axis="0 1 0"/>
<geom type="capsule" size=".01" fromto="0 0 0 0 0 .1" mass=".1"/>
<body name="rod" pos="0 0 .1"><joint name="rod" axis="0 1 0"/>
<geom type="capsule" size=".01" fromto="0 0 0 .3 0 .1" mass=".1"/></body></body>
<body name="rocker" pos=".3 0 0"><joint name="rocker" axis="0 1 0"/>
<geom type="capsule" size=".01" fromto="0 0 0 0 0 .2" mass=".1"/></body>
<body pos="0 1 0"><joint name="free" axis="0 1 0"/><geom size=".02"/></body></worldbody>
<equality><connect body1="rod" body2="rocker" anchor=".3 0 .1"/></equality>
<actuator><position name="crank" joint="crank" kp="5" kv=".3"/></actuator></mujoco>"""
TIME = 0.01 * np.arange(400)


def log_of(crank: np.ndarray) -> PositionLog:
    position = np.stack([crank, 0.1 * np.sin(TIME)], axis=1)
    return PositionLog(
        time=TIME, position=position, command=crank[:, None], joint_names=("crank", "free"), actuator_names=("crank",)
    )


def gap(angles: np.ndarray) -> np.ndarray:
    """Distance (T,) [m] between the rod's end and the rocker's, by trigonometry, at crank, rod and rocker (T, 3)."""
    crank, rod, rocker = angles.T

    def turned(x: float, z: float, by: np.ndarray) -> np.ndarray:
        return np.stack([x * np.cos(by) + z * np.sin(by), z * np.cos(by) - x * np.sin(by)])

    return np.linalg.norm(
        turned(0.0, 0.1, crank) + turned(0.3, 0.1, crank + rod) - turned(0.0, 0.2, rocker) - [[0.3], [0.0]], axis=0
    )


def test_loops_tell_the_joints_that_they_leave_no_freedom() -> None:
    scene = Scene.from_mjcf(FOUR_BAR)
    crank, rod, rocker, free = range(4)
    assert closing(scene, [crank, free]) == [rod, rocker]
    assert closing(scene, [crank]) == [rod, rocker]
    assert closing(scene, [free]) == []


def test_a_log_of_the_crank_alone_has_all_joints() -> None:
    scene = Scene.from_mjcf(FOUR_BAR)
    log = log_of(0.5 * np.sin(2.0 * TIME))
    found = estimated(log, scene)
    np.testing.assert_allclose(gap(found.q[:, :3]), 0.0, atol=1e-8)
    rates = np.gradient(found.q[:, 2], 0.01)
    np.testing.assert_allclose(found.v[5:-5, 2], rates[5:-5], atol=2e-3)
    assert log.measured(scene).tolist() == [True, False, False, True]


def test_an_episode_of_the_crank_alone_has_all_joints() -> None:
    """As what stands on a floor is looked for, which needs every joint of a robot with loops."""
    scene, crank = Scene.from_mjcf(FOUR_BAR), 0.5 * np.sin(2.0 * TIME)
    episode = {("crank", "position"): crank[:, None], ("free", "position"): np.zeros((len(TIME), 1))}
    q = configurations(episode, scene)
    np.testing.assert_array_equal(q[:, 0], crank)
    np.testing.assert_allclose(gap(q[:, :3]), 0.0, atol=1e-8)


def test_joints_without_an_encoder_have_no_bias_to_fit() -> None:
    scene = Scene.from_mjcf(FOUR_BAR)
    evidence = Evidence.of(ComplementarityModel(scene), log_of(0.5 * np.sin(2.0 * TIME)))
    space = evidence.space
    moved = {name for name, told in zip(space.names, space.default, strict=True) if told and name.startswith("bias.")}
    assert moved == {"bias.crank", "bias.free"}


def test_a_log_whose_loops_stay_open_is_told() -> None:
    """The rocker cannot go round."""
    log = replace(log_of(2.5 * np.sin(2.0 * TIME)), joint_names=("rocker", "free"))
    expected = r"leave loops of scene .* open by up to .* mm: check their signs, .*, or log 'crank', 'rod' too"
    with pytest.raises(UserError, match=expected):
        estimated(log, Scene.from_mjcf(FOUR_BAR))


def test_what_a_loop_does_not_tell_is_asked_for() -> None:
    log = log_of(np.zeros(400))
    with pytest.raises(UserError, match="joint 'free' of scene"):
        replace(log, position=log.position[:, :1], joint_names=("crank",)).check(Scene.from_mjcf(FOUR_BAR))


def test_import_needs_no_column_for_it(tmp_path: Path) -> None:
    (tmp_path / "four_bar.xml").write_text(FOUR_BAR)
    scene, crank = Scene.from_mjcf(tmp_path / "four_bar.xml"), 0.5 * np.sin(2.0 * TIME)
    table = np.stack([TIME, crank, 0.1 * np.sin(TIME), crank], axis=1)
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="time,crank,free,crank_cmd", comments="")
    log = import_logs([tmp_path / "log.csv"], scene).log
    assert isinstance(log, PositionLog)
    assert log.joint_names == ("crank", "free")
    assert estimated(log, scene).q.shape[1] == 4


def test_import_needs_no_kind_of_log_for_rods_on_ball_joints(tmp_path: Path) -> None:
    """Such joints float no base: a log of positions holds all that was logged, and transitions do not."""
    (tmp_path / "rod.xml").write_text(ROD.replace('<joint name="hung" type="ball"/>', '<joint name="hung"/>'))
    knee = 0.5 * np.sin(2.0 * TIME)
    table = np.stack([TIME, knee, 0.0 * TIME, knee], axis=1)
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="time,knee,hung,knee_cmd", comments="")
    log = import_logs([tmp_path / "log.csv"], Scene.from_mjcf(tmp_path / "rod.xml")).log
    assert isinstance(log, PositionLog)
    assert log.joint_names == ("knee", "hung")


FOOT = """<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody><body name="shin">
<body name="crank"><joint name="crank" axis="0 1 0" range="-2.4 -.5"/>
<geom type="capsule" size=".01" fromto="0 0 0 .05 0 0" mass=".1"/>
<body name="rod" pos=".05 0 0"><joint name="rod" axis="0 1 0"/>
<geom type="capsule" size=".01" fromto="0 0 0 .3 0 0" mass=".1"/></body></body>
<body name="foot" pos=".3 0 0"><joint name="foot" axis="0 1 0" range="-2.4 -.5"/>
<geom type="capsule" size=".01" fromto="0 0 0 .05 0 0" mass=".1"/></body></body></worldbody>
<equality><connect body1="rod" body2="foot" anchor=".3 0 0"/></equality>
<actuator><motor name="foot" joint="foot"/></actuator></mujoco>"""

ROD = """<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody><body name="hip">
<body name="rod" pos="0 .1 0"><joint name="rod" type="ball"/>
<geom type="capsule" size=".01" fromto="0 0 0 .3 0 0" mass=".1"/></body>
<body name="thigh"><joint name="knee" axis="0 1 0"/>
<geom type="capsule" size=".01" fromto="0 0 0 .28 0 0" mass=".5"/>
<body name="lever" pos=".28 0 0"><joint name="lever" axis="0 0 1" stiffness="10"/>
<geom type="capsule" size=".01" fromto="0 0 0 .02 .1 0" mass=".1"/></body></body></body>
<body name="hung" pos="0 0 1"><joint name="hung" type="ball"/><geom size=".05" pos=".1 0 0"/></body></worldbody>
<equality><connect body1="rod" body2="lever" anchor=".3 0 0"/></equality>
<actuator><position name="knee" joint="knee" kp="5" kv=".3"/></actuator></mujoco>"""


def test_a_file_drawn_at_a_dead_centre_is_assembled_within_its_limits() -> None:
    """A parallelogram lies flat where all its joints are 0, which its limits forbid: two branches meet there."""
    scene = Scene.from_mjcf(FOOT)
    assert closing(scene, [2]) == [0, 1]
    q = np.zeros((50, 3))
    q[:, 2] = np.linspace(-0.6, -2.3, 50)
    crank, rod, _ = closed(scene, q, [0, 1]).T
    np.testing.assert_allclose(crank, q[:, 2], atol=1e-7)  # not the crossed branch
    np.testing.assert_allclose(rod, -crank, atol=1e-7)


def test_loops_tell_a_rod_on_a_ball_joint() -> None:
    """Its spin about its own length is nought; a ball joint that no loop holds is not told."""
    scene = Scene.from_mjcf(ROD.replace('<joint name="hung" type="ball"/>', '<joint name="hung"/>'))
    rod, knee, lever, hung = (
        next(j.vadr for j in scene.joints if j.name == n) for n in ("rod", "knee", "lever", "hung")
    )
    assert closing(scene, [knee, hung]) == [rod, rod + 1, rod + 2, lever]
    whole = Scene.from_mjcf(ROD)
    assert closing(whole, [j.vadr for j in whole.joints if j.name == "knee"]) == [
        k for j in whole.joints if j.name in ("rod", "lever") for k in j.dofs
    ]
    turn = 0.5 * np.sin(2.0 * TIME)
    log = PositionLog(
        time=TIME, position=np.stack([turn, 0.0 * turn], axis=1), command=turn[:, None],
        joint_names=("knee", "hung"), actuator_names=("knee",),
    )  # fmt: skip
    found = estimated(log, scene)
    assert np.abs(gaps(scene, found.q)).max() < 1e-8
    ahead = scene.difference(found.q, found.q_next) / log.dt
    np.testing.assert_allclose(found.v[5:-5, rod : rod + 3], ahead[5:-5, rod : rod + 3], atol=0.02)
    along = found.v[:, rod : rod + 3] @ np.array([1.0, 0.0, 0.0])  # the rod's length, in its own axes
    assert np.abs(along).max() < 0.05 * np.abs(found.v[:, rod : rod + 3]).max()
    assert log.measured(scene).tolist() == [place in (knee, hung) for place in range(scene.nv)]


def test_slopes_of_loops_agree_with_differences() -> None:
    draw, small = np.random.default_rng(0), 1e-6
    for text in (FOUR_BAR, ROD):
        scene = Scene.from_mjcf(text)
        q = scene.integrate(np.tile(scene.q0, (3, 1)), 0.3 * draw.standard_normal((3, scene.nv)))
        slopes = slope(scene, q, list(range(scene.nv)))
        for k, e in enumerate(small * np.eye(scene.nv)):
            ahead, behind = (gaps(scene, scene.integrate(q, x)) for x in (e, -e))
            np.testing.assert_allclose(slopes[:, :, k], (ahead - behind) / (2 * small), atol=1e-8)


def test_what_is_to_be_held_jams_no_loop() -> None:
    """One joint of a linkage is enough, and a spring is held before others; without loops, all that no log tells."""
    crank, _, _, free = range(4)
    assert to_hold(Scene.from_mjcf(FOUR_BAR), [crank]) == ["free"]
    assert to_hold(Scene.from_mjcf(FOUR_BAR), [free]) == ["crank"]
    sprung = FOUR_BAR.replace('<joint name="rocker"', '<joint name="rocker" stiffness="3"')
    assert to_hold(Scene.from_mjcf(sprung), [free]) == ["rocker"]
    assert to_hold(Scene.from_mjcf(FOUR_BAR.replace("connect", "weld")), [free]) == ["crank", "rod", "rocker"]
    log = replace(log_of(np.zeros(400)), position=np.zeros((400, 1)), joint_names=("free",))
    with pytest.raises(UserError, match=r"`cmbrl convert FILE.xml HELD.xml --hold crank`"):
        log.check(Scene.from_mjcf(FOUR_BAR))
