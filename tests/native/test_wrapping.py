"""Tendons around geoms: steps are MuJoCo's, derivatives those of differences; and damping that is explicit."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.info.report import describe

SHAPES = {"sphere": 'type="sphere" size=".1"', "cylinder": 'type="cylinder" size=".1 .2" euler="80 20 10"'}
SITES = {"free": "", "beside": '<site name="s" pos=".05 .2 .1"/>', "inside": '<site name="s" pos=".02 .03 .01"/>'}
QUIET = 'contype="0" conaffinity="0"'


def robot(shape: str, site: str, flag: str = "") -> str:
    """Three bodies that move in every way; a spring, a servo and a limit act along a tendon between the ends."""
    side = 'sidesite="s"' if site != "free" else ""
    return f"""<mujoco><option timestep=".002">{flag}</option>
<worldbody><body pos="0 0 1">
<joint name="ball" type="ball"/><joint name="x" type="slide" axis="1 .2 0"/>
<geom type="box" size=".1 .2 .1" mass="2" {QUIET}/>
<site name="above" pos=".1 .05 .3"/>
<body pos="0 0 -.3"><joint name="a" axis="0 1 .2"/><joint name="b" axis="1 .1 0" damping=".2"/>
<geom name="g" {SHAPES[shape]} mass="1" {QUIET}/>{SITES[site]}
<body pos="0 0 -.3"><joint name="c" axis=".3 1 0"/><joint name="d" axis="0 .1 1"/>
<geom type="box" size=".1 .1 .2" mass="1" {QUIET}/><site name="below" pos=".12 .02 -.05"/></body></body></body>
</worldbody><tendon><spatial name="t" stiffness="300" damping="3" springlength=".3" limited="true" range="0 .9">
<site site="above"/><geom geom="g" {side}/><site site="below"/></spatial></tendon>
<actuator><position name="p" tendon="t" kp="50"/></actuator></mujoco>"""


def states(scene: Scene, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    q = scene.integrate(np.tile(scene.q0, (count, 1)), 0.5 * rng.normal(size=(count, scene.nv)))
    return q, rng.normal(size=(count, scene.nv)), rng.normal(size=(count, scene.nu))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("site", SITES)
def test_steps_are_those_of_mujoco(shape: str, site: str) -> None:
    text = robot(shape, site)
    model, scene = mujoco.MjModel.from_xml_string(text), Scene.from_mjcf(text)
    data = mujoco.MjData(model)
    q, v, u = states(scene, 60)
    ours = ComplementarityModel(scene)
    found, lengths = ours.predict(q, v, u).v_next, ours.smooth_dynamics(q, v)["length"][:, -1]
    around = 0
    for k in range(len(q)):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q[k], v[k], u[k]
        mujoco.mj_forward(model, data)
        around += data.ten_wrapnum[0] > 2
        assert lengths[k] == pytest.approx(
            data.ten_length[0], rel=1e-6
        )  # MuJoCo's turning point inside errs by so much
        mujoco.mj_step(model, data)
        np.testing.assert_allclose(found[k], data.qvel, atol=(1e-6 if site == "inside" else 1e-11) * np.ptp(data.qvel))
    assert 10 <= around < len(q)
    assert "t = 1 segment, 1 around a geom, moved by" in describe(scene)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("site", SITES)
def test_derivatives_are_those_of_differences(shape: str, site: str) -> None:
    scene = Scene.from_mjcf(robot(shape, site))
    model, step = ComplementarityModel(scene), 1e-6
    q, v, u = states(scene, 40)
    jacobian = model.predict(q, v, u, jacobian=True).jacobian
    assert jacobian is not None
    worst = []
    for k in range(scene.nv):
        move = step * np.eye(scene.nv)[[k] * len(q)]
        by_q = [model.predict(scene.integrate(q, sign * move), v, u).v_next for sign in (1, -1)]
        by_v = [model.predict(q, v + sign * move, u).v_next for sign in (1, -1)]
        for column, (ahead, behind) in ((k, by_q), (scene.nv + k, by_v)):
            difference = (ahead - behind) / (2 * step)
            error = np.abs(difference - jacobian[:, scene.nv :, column]).max(axis=1)
            worst.append(error / (1 + np.abs(difference).max(axis=1)))
    assert np.median(worst) < 1e-8
    assert np.max(worst) < 1e-6


def test_joint_damping_is_explicit_where_the_file_says_so() -> None:
    implicit, explicit = (robot("sphere", "free", flag) for flag in ("", '<flag eulerdamp="disable"/>'))
    scene, model = Scene.from_mjcf(explicit), mujoco.MjModel.from_xml_string(explicit)
    q, v, u = states(scene, 10)
    found = ComplementarityModel(scene).predict(q, v, u).v_next
    data = mujoco.MjData(model)
    for k in range(len(q)):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q[k], v[k], u[k]
        mujoco.mj_step(model, data)
        np.testing.assert_allclose(found[k], data.qvel, atol=1e-11)
    other = ComplementarityModel(Scene.from_mjcf(implicit)).predict(q, v, u).v_next
    assert np.abs(found - other).max() > 1e-6
