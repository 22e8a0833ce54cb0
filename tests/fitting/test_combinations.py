"""What joints feel of bodies together, against the mass matrix of MuJoCo, and where a log tells it."""

from __future__ import annotations

import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.outcome.combinations import combinations
from cmbrl.fitting.search.space import Space
from cmbrl.scene import Scene

ARM = """<mujoco><worldbody><body><joint name="a" axis="0 1 0" armature=".1"/>
<geom type="capsule" size=".05" fromto="0 0 0 .4 0 0" mass="2"/>
<body name="link" pos=".4 0 0"><joint name="b" axis="0 1 0"/>
<geom type="capsule" size=".04" fromto="0 0 0 .3 0 .1" mass="1"/></body></body></worldbody>
<actuator><motor name="m" joint="b"/></actuator></mujoco>"""


@pytest.fixture
def arm(tmp_path: Path) -> cmbrl.ComplementarityModel:
    (tmp_path / "arm.xml").write_text(ARM, encoding="utf-8")
    return cmbrl.ComplementarityModel(Scene.from_mjcf(tmp_path / "arm.xml"))


def test_sums_are_told_where_bodies_are_flat(arm: cmbrl.ComplementarityModel) -> None:
    """A log that tells the inertia and the first moment at b, and nothing else of that link."""
    space = Space.of(arm.scene.parameters, arm.parameters)
    pose, z = np.array([0.3, -0.2]), np.zeros(len(space))
    own = np.array([".link" in n for n in space.names])
    prior = np.linalg.inv(space.precision)
    covariance = np.where(np.outer(own, own), prior, 0.0)
    flat = own.copy()
    nothing = combinations(arm, space, z, covariance, flat, pose)
    assert nothing == ([], None)  # the log tells nothing at all
    names = ["gravity's torque at b", "inertia felt by b"]
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_forward(model, data)
    mass = np.zeros((2, 2))
    mujoco.mj_fullM(model, data, mass)
    turns = []
    for turn in (0.0, np.pi / 2):
        data.qpos[:] = np.add(pose, [0.0, turn])
        mujoco.mj_forward(model, data)
        turns.append(data.qfrc_bias[1])
    felt = [np.hypot(*turns), mass[1, 1]]
    # a covariance without the two directions that the log tells
    slope = np.array([[np.log(_felt(arm, space, pose, k, s)) for s in (1e-4, -1e-4)] for k in np.flatnonzero(own)])
    told = (slope[:, 0] - slope[:, 1]).T / 2e-4  # (2, own)
    left = prior[np.ix_(own, own)]
    for _ in range(2):
        for row in told:
            along = left @ row
            left = left - (1 - 1e-4) * np.outer(along, along) / (row @ along)
    covariance[np.ix_(own, own)] = left
    found = {row["name"]: row for row in combinations(arm, space, z, covariance, flat, pose)[0]}
    assert set(names) <= set(found)
    for name, value in zip(names, felt, strict=True):
        assert found[name]["value"] == pytest.approx(value, rel=1e-6)
        assert found[name]["nominal"] == found[name]["value"]
        assert 0.9 < found[name]["low"] / value < 1.0 < found[name]["high"] / value < 1.1


def test_the_unit_of_force_is_that_beside_which_bodies_are_known_best(arm: cmbrl.ComplementarityModel) -> None:
    """All masses, inertias, a motor and a rotor are known up to one factor, the rotor by 10 % worse than that."""
    space = Space.of(arm.scene.parameters, arm.parameters)
    pose, z = np.array([0.3, -0.2]), np.zeros(len(space))
    mass, motor, rotor = (space.names.index(name) for name in ("mass.link", "gear.m", "armature.a"))
    bodies = np.isin(space.groups, ["mass", "inertia"])
    shared = bodies | np.isin(np.arange(len(z)), [motor, rotor])
    one = np.where(shared, 1.0 / space.sd, 0.0)
    covariance = 0.05**2 * np.outer(one, one)
    covariance[rotor, rotor] += (0.1 / space.sd[rotor]) ** 2
    covariance[mass, mass] += (0.02 / space.sd[mass]) ** 2
    z[shared] = np.log(2.0) / space.sd[shared]  # twice the file's
    rows, reference = combinations(arm, space, z, covariance, bodies, pose, [rotor, mass, motor])
    assert reference == "gear.m"
    (link,) = [row for row in rows if row["name"] == "gravity's torque at b"]
    assert link["value"] == pytest.approx(link["nominal"])
    assert np.log(link["high"] / link["low"]) == pytest.approx(2 * 1.96 * 0.02, rel=0.05)
    alone, none = combinations(arm, space, z, covariance, bodies, pose)
    assert none is None
    (link,) = [row for row in alone if row["name"] == "gravity's torque at b"]
    assert link["value"] == pytest.approx(2.0 * link["nominal"])
    assert np.log(link["high"] / link["low"]) == pytest.approx(2 * 1.96 * np.hypot(0.05, 0.02), rel=0.05)
    worse, reference = combinations(arm, space, z, covariance, bodies, pose, [rotor])
    assert reference == "armature.a"
    (link,) = [row for row in worse if row["name"] == "gravity's torque at b"]
    assert np.log(link["high"] / link["low"]) == pytest.approx(2 * 1.96 * 0.1, rel=0.05)


def _felt(arm: cmbrl.ComplementarityModel, space: Space, pose: np.ndarray, k: int, step: float) -> list[float]:
    """The largest torque of gravity at b, and the inertia about it, with parameter k moved."""
    z = np.zeros(len(space))
    z[k] = step
    poses = np.array([pose, np.add(pose, [0.0, np.pi / 2])])
    dynamics = arm.smooth_dynamics(poses, np.zeros((2, 2)), space.theta(z))
    return [float(np.hypot(*dynamics["bias"][:, 1])), float(dynamics["M"][0, 1, 1])]


def test_a_log_that_tells_nothing_is_no_overflow(tmp_path: Path) -> None:
    """Of three rows intervals are wider than numbers reach; numpy warned of that."""
    file = tmp_path / "axis.xml"
    file.write_text(
        '<mujoco><worldbody><body name="carriage"><joint name="axis" type="slide" axis="1 0 0" range="-.1 .4"/>'
        '<geom type="box" size=".1 .1 .1" mass="70" contype="0" conaffinity="0"/></body></worldbody>'
        '<actuator><motor name="drive" joint="axis" gear="35.15" ctrlrange="-10 10"/></actuator></mujoco>'
    )
    log = PositionLog(
        time=0.001 * np.arange(3), position=np.array([[7.45e-6], [14.3e-6], [21.85e-6]]),
        command=np.array([[89.23], [92.26], [95.70]]), joint_names=("axis",), command_kind="torque",
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        assert cmbrl.fit(cmbrl.ComplementarityModel(Scene.from_mjcf(file)), log).parameters
