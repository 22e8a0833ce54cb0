"""Forces at joints are MuJoCo's, and so is a step; its derivatives are exact."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.bench.studies.derivatives.differences import measure
from cmbrl.contact import Barrier, Gaussian
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.info.report import describe

from .one_step import FLYING, INTEGRATORS, ROOTS, TWO_LINKS, assert_exact, assert_like_mujoco, states, write


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("axis", ["0 1 0", "0 0 1"])
def test_sum_of_actuators_is_clamped(integrator: str, axis: str, tmp_path: Path) -> None:
    """Two actuators on one joint, in range or not; where they are clamped, velocity gains remain implicit."""
    world = TWO_LINKS.format(body="", joint='actuatorfrcrange="-2 3"', axis=axis)
    rest = """<actuator><position joint="shoulder" kp="3" kv=".6" gear="1.5"/><motor joint="shoulder" gear="2"/>
    <velocity joint="elbow" kv="2.5" forcerange="-4 1.5"/></actuator>"""
    file = write(tmp_path, integrator, world, rest)
    assert_like_mujoco(file)
    assert_exact(file, {"q", "v", "u", "gear", "damping"})
    assert_exact(file, {"gear"}, implicit_springs=True)
    scene, model = Scene.from_mjcf(file), mujoco.MjModel.from_xml_path(str(file))
    q, v, u = states(scene, 40)
    data, clamped = mujoco.MjData(model), 0
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.ctrl[:] = q[k], v[k], u[k]
        mujoco.mj_forward(model, data)
        clamped += int(np.isin(data.qfrc_actuator, (-2, 3)).sum())
    assert 10 < clamped < 70


HANGING = """<body gravcomp=".8" pos="0 0 .5">{root}<geom type="box" size=".1 .05 .03" pos=".02 .03 .01"/>
<body pos=".2 0 0" gravcomp="-.4"><geom size=".05" pos="0 .1 0"/></body>
<body pos=".3 0 0"><joint name="b" type="ball" pos=".05 0 0"/><geom size=".07" pos=".1 .1 0"/>
<body gravcomp="1.5" pos="0 .2 .1" quat="1 .2 .3 .4"><joint name="s" type="slide" axis="1 1 0"/>
<joint name="h" axis="0 1 2" actuatorgravcomp="true" actuatorfrcrange="-1.5 2"/>
<geom type="capsule" size=".04 .1" pos=".1 0 0"/></body></body></body>"""


@pytest.mark.parametrize("root", ["<freejoint/>", '<joint name="r" type="ball"/>', '<joint name="r" axis="0 1 1"/>'])
def test_gravity_compensation(root: str, tmp_path: Path) -> None:
    """Of welded parts together, of ball joints, and as the force of an actuator that its joint clamps."""
    rest = '<option gravity="1 2 -9"/><actuator><motor joint="h"/></actuator>'
    file = write(tmp_path, "implicitfast", HANGING.format(root=root), rest)
    assert_like_mujoco(file)
    assert_exact(file, {"q", "mass", "com_x", "com_y", "gravity", "gear"})
    assert Scene.from_mjcf(file).core.nlift == 2


@pytest.mark.parametrize("actuator", ["", '<actuator><motor joint="elbow"/></actuator>'])
@pytest.mark.parametrize("flag", ["", 'gravity="disable"', 'spring="disable" damper="disable"', 'actuation="disable"'])
def test_gravity_compensation_in_the_plane(flag: str, actuator: str, tmp_path: Path) -> None:
    """What MuJoCo's flags switch off; compensation that counts as an actuator's goes with the actuators."""
    world = TWO_LINKS.format(body='gravcomp=".7"', joint='actuatorgravcomp="true"', axis="0 1 0")
    file = write(tmp_path, "Euler", world, f"<option><flag {flag}/></option>{actuator}")
    assert Scene.from_mjcf(file).planar
    assert_like_mujoco(file)
    if not flag:
        assert_exact(file, {"q", "mass", "com_x", "gravity"})


def test_compensation_follows_the_fitted_mass(tmp_path: Path) -> None:
    """A body that carries its own weight stays where it is, whatever it weighs and wherever its centre of mass is."""
    body = '<body gravcomp="1"><freejoint/><geom size=".1"/>{}</body>'.format(
        '<body pos=".2 0 0" gravcomp="1"><geom size=".1"/></body>'
    )
    scene = Scene.from_mjcf(write(tmp_path, "Euler", body))
    theta = scene.parameter_vector()
    for k, p in enumerate(scene.parameters):
        theta[k] = {"mass": 1.7, "gravity": 1.3, "com_y": 0.05}.get(p.group, theta[k])
    r = ComplementarityModel(scene, parameters=theta).predict(scene.q0[None], np.zeros((1, 6)), np.zeros((1, 0)))
    assert np.abs(r.v_next).max() < 1e-14


@pytest.mark.parametrize("root", ROOTS)
def test_actuators_on_sites_and_on_ball_and_free_joints(root: str, tmp_path: Path) -> None:
    """Wrenches that turn with a body, and moment arms of several coordinates; clamped by control, force and joint."""
    rest = """<actuator><motor site="s" gear="1 2 3 .1 .2 .3" ctrlrange="-1 .5"/><motor joint="ball" gear="1 2 3"/>
    <general site="t" gear="3 -1 2 0 .1 0" gainprm="2" biastype="affine" biasprm=".3 5 0" forcerange="-.8 1.5"/>
    <motor joint="hinge"/><motor joint="root" gear="1 2 3 4 5 6"/></actuator>"""
    rest = rest if "root" in root else rest.replace('<motor joint="root" gear="1 2 3 4 5 6"/>', "")
    file = write(tmp_path, "implicitfast", FLYING.format(root=root), rest)
    assert_like_mujoco(file)
    assert_exact(file, {"q", "v", "u", "gear"})
    assert_exact(file, {"gear"}, integrator="midpoint")


def test_site_in_the_plane(tmp_path: Path) -> None:
    world = TWO_LINKS.format(body="", joint="", axis="0 1 0").replace(
        '<body pos=".3 0 0">', '<body pos=".3 0 0"><site name="s" pos=".1 .2 .3" euler="20 30 40"/>'
    )
    file = write(tmp_path, "Euler", world, '<actuator><motor site="s" gear="1 2 3 .1 .2 .3"/></actuator>')
    assert Scene.from_mjcf(file).planar
    assert_like_mujoco(file)
    assert_exact(file, {"q", "u", "gear"})
    assert "s on body fore" not in describe(Scene.from_mjcf(file))
    assert "on body fore" in describe(Scene.from_mjcf(file))


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_springs_of_ball_and_free_joints(integrator: str, tmp_path: Path) -> None:
    world = """<body><joint name="f" type="free" stiffness="3"/><geom type="box" size=".1 .05 .03" pos=".02 .03 .01"/>
    <body pos=".3 0 0"><joint name="b" type="ball" pos=".05 0 0" stiffness="2" damping=".1"/>
    <geom size=".07" pos=".1 .1 0"/>
    </body></body>"""
    file = write(tmp_path, integrator, world)
    assert_like_mujoco(file)
    assert_exact(file, {"q", "v", "stiffness", "damping"})
    assert_exact(file, {"stiffness"}, implicit_springs=True)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_springs_and_dampers_of_higher_powers(integrator: str, tmp_path: Path) -> None:
    world = """<body><joint type="slide" axis="1 0 0" stiffness="3 2 5" damping=".1 .2 .4" springref=".2"/>
    <geom size=".1"/><body pos=".3 0 0"><joint axis="0 0 1" stiffness="0 1 2" springref="30"/>
    <geom size=".1" pos=".1 0 0"/><body><joint type="ball" damping=".1 .3 .2"/>
    <geom type="box" size=".1 .05 .03" pos=".1 0 0"/></body></body></body>"""
    file = write(tmp_path, integrator, world)
    assert Scene.from_mjcf(file).core.npower == 5
    assert_like_mujoco(file)
    assert_exact(file, {"q", "v", "stiffness", "damping"})
    assert_exact(file, {"stiffness", "damping"}, implicit_springs=True)


@pytest.mark.parametrize(("medium", "joint"), [('density="500" viscosity="1"', ""), ("", 'damping="1 3 5"')])
def test_bounces_with_forces_that_are_implicit(medium: str, joint: str, tmp_path: Path) -> None:
    """Impulses that act late in the step ask for the derivative of the mass matrix with its implicit forces."""
    file = tmp_path / "scene.xml"
    file.write_text(
        f"""<mujoco><option integrator="implicitfast" timestep=".01" {medium}/><worldbody>
    <geom type="plane" size="5 5 .1"/><body pos="0 0 .3"><freejoint/><geom type="box" size=".1 .05 .2" mass="1"/>
    <body pos=".1 0 .2"><joint axis="0 1 0" {joint}/><geom size=".05" pos=".2 0 0"/></body></body>
    </worldbody></mujoco>""",
        encoding="utf-8",
    )
    scene = Scene.from_mjcf(file, contact_law="rigid")
    row = measure(scene, "kappa 1e-4", 20, restitution=0.5)
    assert row["median"] <= 1e-6, row
    assert row["worst_column"] <= 1e-5, row


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_actuators_of_tendons_count_in_what_a_joint_clamps(integrator: str, tmp_path: Path) -> None:
    world = """<body><joint name="a" axis="0 1 0" actuatorfrcrange="-.5 .6" damping=".1"/>
    <geom type="capsule" size=".04" fromto="0 0 0 .4 0 0"/><body pos=".4 0 0"><joint name="b" axis="0 0 1"/>
    <geom type="capsule" size=".04" fromto="0 0 0 .3 0 0"/></body></body>"""
    rest = """<tendon><fixed name="t"><joint joint="a" coef="1"/><joint joint="b" coef="-.7"/></fixed></tendon>
    <actuator><position tendon="t" kp="2" kv=".3"/><velocity joint="a" kv=".4" gear="1.5"/><motor joint="b"/>
    </actuator>"""
    file = write(tmp_path, integrator, world, rest)
    assert_like_mujoco(file)
    assert_exact(file, {"q", "v", "u", "gear"})
    assert_exact(file, {"gear"}, implicit_springs=True)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_limits_of_ball_joints(integrator: str, tmp_path: Path) -> None:
    """On the angle of the rotation: MuJoCo's step where they act, derivatives with an axis that turns."""
    world = """<body><joint name="r" axis="0 1 1"/><geom size=".1" pos=".1 0 0"/><body pos=".3 0 0">
    <joint name="b" type="ball" pos=".05 0 0" range="0 60" margin=".05"/>
    <geom type="box" size=".1 .05 .2" pos=".1 .1 0"/>
    <body pos=".1 0 .2"><joint type="ball"/><geom type="box" size=".1 .05 .03" pos=".2 0 0"/></body></body></body>"""
    file = write(tmp_path, integrator, world)
    scene, model = Scene.from_mjcf(file), mujoco.MjModel.from_xml_path(str(file))
    assert "b [-1.047, 1.047]" in describe(scene)
    data = assert_like_mujoco(file, tolerance=1e-8)
    held = 0
    for q, v, _ in zip(*states(scene, 40), strict=True):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        held += data.nefc
    assert 10 < held < 40
    for smoothing in (Barrier(1e-4), Gaussian(length=0.01, floor=1e-6)):
        assert_exact(file, {"q", "v"}, smoothing=smoothing, path_tolerance=1e-12)


def test_margins_of_limits(tmp_path: Path) -> None:
    """A limit that acts at a distance is not left out because it is not reached yet."""
    world = '<body><joint range="-60 60" margin=".1"/><geom type="box" size=".1 .05 .2" pos=".1 .1 0"/></body>'
    file = write(tmp_path, "implicitfast", world)
    scene, model = Scene.from_mjcf(file), mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    for angle in (0.9, 0.96, 1.0, 1.04, 1.06):
        q, v = np.array([[angle]]), np.array([[0.7]])
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = angle, 0.7
        mujoco.mj_step(model, data)
        ours = ComplementarityModel(scene).predict(q, v, np.zeros((1, 0))).v_next
        np.testing.assert_allclose(ours[0], data.qvel, rtol=0, atol=1e-8)
