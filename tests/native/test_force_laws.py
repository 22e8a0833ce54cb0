"""DC motors and PID controllers without a state, with one control or several: MuJoCo's steps, right derivatives."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.info.report import describe
from cmbrl.scene.source.mjcf import act_addresses

from .free_steps import assert_steps_are_mujocos, states

ARM = """<mujoco><option timestep=".005" integrator="{integrator}"/><worldbody><body>
<joint name="a" axis="0 1 0" damping=".3"/><geom type="capsule" size=".04" fromto="0 0 0 .4 0 0"/>
<body pos=".4 0 0"><joint name="b" axis="0 0 1" armature=".02"/><geom type="capsule" size=".03" fromto="0 0 0 .3 0 0"/>
<body pos=".3 0 0"><joint name="ball" type="ball"/><geom type="box" size=".1 .04 .05" pos=".1 0 0"/></body>
</body></body>
</worldbody><tendon><fixed name="t"><joint joint="a" coef="1"/><joint joint="b" coef="-.5"/></fixed>
<fixed name="ranged" actuatorfrcrange="-.5 .7"><joint joint="a" coef="1"/><joint joint="b" coef="2"/></fixed></tendon>
<actuator>{actuators}</actuator></mujoco>"""
MOTOR = 'resistance="2" motorconst=".3"'
CASES = {
    "voltage": f'<dcmotor joint="a" {MOTOR} gear="20"/><dcmotor tendon="t" nominal="12 2 30" gear="3"/>',
    "torque limit": f'<dcmotor joint="a" {MOTOR} gear="3" saturation=".2 0 0" armature=".01" damping=".1"/>',
    "range of a tendon": '<motor tendon="ranged" gear="2"/>',
    "nonlinear damping": '<motor joint="a" gear="2" damping=".1 .2 .05"/><motor joint="ball" damping=".1 .2 .05"/>',
    "cogging": f'<dcmotor joint="a" {MOTOR} gear="3" cogging=".1 5 .4"/><dcmotor tendon="t" {MOTOR} cogging="1 3 0"/>',
    "controller": f'<dcmotor joint="a" {MOTOR} gear="2" input="pos vel ff voltage" controller="5 0 .4 0 0 0" '
    'ctrlrange="-1 1"/><motor joint="b"/>',
    "two torque limits": f'<dcmotor joint="b" {MOTOR} input="pos vel" controller="5 0 .4 0 0 0" saturation="2 0 0"/>'
    '<pid joint="a" kp="9" kv=".3" input="pos vel ff" forcerange="-5 5" gear="1.5"/>',
    "pid on a ball joint": '<pid joint="ball" gear="1 .5 .3" kp="9" kv=".3"/>',
    "velocity and force alone": '<pid joint="b" kp="9" kv=".3" input="vel ff"/><pid joint="a" kv=".7" input="ff"/>',
}


def scene_of(tmp_path: Path, actuators: str, integrator: str) -> tuple[Scene, mujoco.MjModel]:
    path = tmp_path / "robot.xml"
    path.write_text(ARM.format(integrator=integrator, actuators=actuators), encoding="utf-8")
    return Scene.from_mjcf(path), mujoco.MjModel.from_xml_path(str(path))


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
@pytest.mark.parametrize("case", CASES)
def test_steps_are_those_of_mujoco(tmp_path: Path, case: str, integrator: str) -> None:
    scene, model = scene_of(tmp_path, CASES[case], integrator)
    assert_steps_are_mujocos(ComplementarityModel(scene), model, 30)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
@pytest.mark.parametrize("case", CASES)
def test_derivatives(tmp_path: Path, case: str, integrator: str) -> None:
    scene, _ = scene_of(tmp_path, CASES[case], integrator)
    row = compare(ComplementarityModel(scene), *states(scene, 8), 30)
    assert {"q", "v", "u"} <= set(row["kinds"])
    assert row["worst"] <= 1e-6, row


def test_controls_are_named_by_their_actuator(tmp_path: Path) -> None:
    scene, model = scene_of(tmp_path, '<pid name="hip" joint="a" kp="9"/>', "Euler")
    assert scene.actuator_names == ("hip_0", "hip_1")
    assert scene.nu == model.nu
    assert "hip_1 on a" in describe(scene)


@pytest.mark.parametrize(
    ("motor", "why"),
    [
        (
            f'<dcmotor name="m" joint="a" {MOTOR} inductance=".01 0" lugre="9 .1 .2 .3 .1"/>',
            "a dcmotor with inductance and lugre",
        ),
        (f'<dcmotor name="m" joint="a" {MOTOR} input="none"/>', "without an input"),
        (f'<dcmotor name="m" joint="a" {MOTOR} input="pos" controller="5 0 0 0 0 9"/>', "a largest voltage"),
        ('<pid name="m" joint="a" kp="1" ki="2"/>', "a pid with ki"),
    ],
)
def test_motors_with_a_state_are_refused(tmp_path: Path, motor: str, why: str) -> None:
    with pytest.raises(UserError, match=why):
        scene_of(tmp_path, motor, "Euler")


def test_a_current_that_follows_at_once_is_near_one_that_follows_fast(tmp_path: Path) -> None:
    """On request: with an electrical time constant of 0.1 ms, the arm's motion over 0.5 s is that of MuJoCo."""
    path = tmp_path / "robot.xml"
    motor = f'<dcmotor joint="a" {MOTOR} gear="9" inductance="0 .0001"/>'
    text = ARM.format(integrator="implicitfast", actuators=motor).replace('timestep=".005"', 'timestep=".001"')
    path.write_text(text, encoding="utf-8")
    scene, model = Scene.from_mjcf(path, "actuator_dynamics"), mujoco.MjModel.from_xml_path(str(path))
    assert "actuator_dynamics" in {x.kind for x in scene.left_out}
    data, ours = mujoco.MjData(model), ComplementarityModel(scene)
    data.ctrl[:] = 3.0
    q, v = scene.q0[None], np.zeros((1, scene.nv))
    for _ in range(500):
        mujoco.mj_step(model, data)
        r = ours.predict(q, v, np.full((1, 1), 3.0))
        q, v = r.q_next, r.v_next
    np.testing.assert_allclose(q[0], data.qpos, atol=0.01)


def test_activations_after_actuators_of_several_controls(tmp_path: Path) -> None:
    """Controls are counted, not actuators: the filter's activation comes from its own place."""
    filtered = '<general name="slow" joint="b" dyntype="filterexact" dynprm=".1" gainprm="4"/>'
    scene, model = scene_of(tmp_path, f'<pid name="hip" joint="a" kp="9"/><motor joint="b"/>{filtered}', "Euler")
    assert scene.actuator_names == ("hip_0", "hip_1", "b", "slow")
    assert act_addresses(model, scene.core.state_act).tolist() == [0]
    assert_steps_are_mujocos(ComplementarityModel(scene), model, 5)
