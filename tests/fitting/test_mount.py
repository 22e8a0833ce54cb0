"""A robot that is mounted otherwise than in its file; robots that are mounted alike and differ in all else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import cmbrl
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.mount import MountCheck

from .arm_log import followed

ARM = """<mujoco><option timestep=".002" {gravity}/><worldbody><body pos="0 0 1"><joint name="a" axis="0 1 0"
armature=".02"/><geom type="capsule" size=".03" fromto="0 0 0 0 0 -.4" mass="{mass}"/><body pos="0 0 -.4">
<joint name="b" axis="{axis}" armature=".01"/><geom type="capsule" size=".02" fromto="0 0 0 .1 0 -.3" mass="1"/></body>
</body></worldbody><actuator><position joint="a" kp="{kp}" kv="{kv}"/><position joint="b" kp="{kp}" kv="{kv}"/>
</actuator></mujoco>"""


def arm(gravity: str = "", mass: float = 2.0, kp: float = 40.0, kv: float = 2.0, axis: str = "1 0 0") -> str:
    return ARM.format(gravity=f'gravity="{gravity}"' if gravity else "", mass=mass, kp=kp, kv=kv, axis=axis)


def check(file: str, log: PositionLog) -> MountCheck:
    return MountCheck(Evidence.of(cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(file)), log), 0.5, 0)


@pytest.mark.parametrize(
    ("gravity", "axis", "told"),
    [
        (
            "0 0 9.81",
            "1 0 0",
            "gravity were 0 0 9.81 and not the file's 0 0 -9.81 .*: is the robot mounted upside down",
        ),
        ("9.81 0 0", "1 0 0", "gravity were 9.81 0 0 and not the file's 0 0 -9.81 .*: is the robot mounted on a wall"),
        (
            "0 0 9.81",
            "0 1 0",
            "gravity were 0 0 9.81 and not the file's 0 0 -9.81 .*: is the robot mounted upside down",
        ),
    ],
)
def test_another_mount_ends_the_fit(gravity: str, axis: str, told: str) -> None:
    log = followed(arm(gravity, mass=2.4, kp=45, axis=axis), 1000)
    with pytest.raises(cmbrl.UserError, match=told):
        cmbrl.fit(cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(arm(axis=axis))), log)


@pytest.mark.parametrize(
    ("other", "axis"),
    [
        ({"mass": 4.0}, "1 0 0"),
        ({"mass": 0.8}, "0 1 0"),
        ({"kp": 15.0}, "1 0 0"),
        ({"kp": 150.0, "kv": 12.0}, "0 1 0"),
        ({"gravity": "1.7 0 -9.66"}, "1 0 0"),  # ten degrees: a tilt that a fit finds
    ],
)
def test_other_masses_gains_and_tables_are_no_other_mount(other: dict, axis: str) -> None:
    assert check(arm(axis=axis), followed(arm(axis=axis, **other), 1000)).finding() is None


def test_a_driver_that_compensates_gravity_is_no_other_mount() -> None:
    found = check(arm(), followed(arm("0 0 -.01"), 1000)).finding()
    assert found is None


def test_offsets_of_encoders_are_no_sure_other_mount() -> None:
    log = followed(arm(), 1000)
    found = check(arm(), replace(log, position=log.position + np.array([0.2, -0.15]))).finding()
    assert found is None or not found.sure
