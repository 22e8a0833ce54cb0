"""One step of files with one element each is MuJoCo's: what once was left out, or taken in another way, unsaid."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from cmbrl.bench.check_steps import mujocos
from cmbrl.bench.states import Ranges, random_states
from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.source.robot_source import quiet

ARM = """<body><joint name="a" axis="0 1 0" damping=".2"/><geom type="capsule" fromto="0 0 0 .3 .1 0" size=".04"/>
<body pos=".3 0 .1" euler="20 30 0"><joint name="b" axis="1 0 0"/><joint name="c" axis="0 0 1" {joint}/>
<geom type="box" size=".1 .05 .03" pos=".1 0 0"/><site name="s" pos=".05 .02 .1"/><site name="t"/></body></body>"""
BOX = '<body pos="0 0 .5"><freejoint/><geom type="box" size=".1 .2 .05" pos=".03 0 0"/>{0}</body>'
FLAT = '<geom type="plane" size="3 3 .1"/>'
RUGBY = FLAT + '<body pos="0 0 .1"><freejoint/><geom type="ellipsoid" size=".1 .05 .07" euler="20 0 30"/></body>'
MOTOR = '<actuator><{0} joint="c" gear="2"/></actuator>'


def arm(option: str = "", joint: str = "", rest: str = "") -> str:
    return f"<mujoco>{option}<worldbody>{ARM.format(joint=joint)}</worldbody>{rest}</mujoco>"


def option(attributes: str, flags: str = "") -> str:
    return f"<option {attributes}><flag {flags}/></option>"


def only(worldbody: str, attributes: str = "") -> str:
    return f"<mujoco><option {attributes}/><worldbody>{worldbody}</worldbody></mujoco>"


FAST, RK4 = 'integrator="implicitfast"', 'timestep=".008" integrator="RK4"'
RANGE = 'range="-.2 .2" solreflimit=".003 1"'
FILTER = 'general dyntype="{0}" dynprm=".02" biastype="affine" gainprm="5" biasprm="0 -5 -.1"'
FILES = {
    "RK4": arm(option(RK4), "stiffness='5'", MOTOR.format('velocity kv="2"')),
    "RK4 with contact": only(RUGBY, RK4),
    "RK4 with a filter": arm(option(RK4), "", MOTOR.format(FILTER.format("filter"))),
    "RK4 with an exact filter": arm(option(RK4), "", MOTOR.format(FILTER.format("filterexact") + ' actearly="true"')),
    "RK4 with an integrator": arm(option(RK4), "", MOTOR.format('intvelocity kp="5" actrange="-.01 .01"')),
    "implicit": arm(option('integrator="implicit"'), "", MOTOR.format('velocity kv="2"')),
    "a lone body": only(BOX.format(""), FAST),
    "a loaded body": only(BOX.format('<body pos=".3 0 0"><geom size=".1"/></body>'), FAST),
    "short time constants": arm(option('timestep=".004"', 'refsafe="disable"'), RANGE),
    "a motor that is off": arm(option("", 'actuation="disable"'), "", MOTOR.format('motor armature=".1" damping=".3"')),
    "a group that is off": arm(option('actuatorgroupdisable="1"'), "", MOTOR.format('motor group="1" armature=".1"')),
    "explicit damping": arm(option("", 'eulerdamp="disable"'), 'damping=".2 .5"'),
    "a damper": arm(option(FAST), "", MOTOR.format('damper kv="3" ctrlrange="0 2"')),
    "a gain by length": arm("", "", MOTOR.format('general gaintype="affine" gainprm="3 -2 -.3"')),
    "a gain on an activation": arm(
        option(FAST), "", MOTOR.format('general dyntype="filter" dynprm=".05" gaintype="affine" gainprm="3 -2 -.3"')
    ),
    "an ellipsoid on the floor": only(RUGBY),
    "a tie in one body": arm("", "", '<equality><connect site1="s" site2="t"/></equality>'),
}


def model_of(text: str) -> tuple[ComplementarityModel, mujoco.MjModel]:
    peer = mujoco.MjModel.from_xml_string(text)
    peer.opt.tolerance, peer.opt.iterations = 0, 200
    scene = Scene.from_mjcf(peer, self_contact="none")
    return ComplementarityModel(scene, **mujocos(scene)), peer


@pytest.mark.parametrize("name", FILES)
def test_one_step(name: str) -> None:
    model, peer = model_of(FILES[name])
    scene, data = model.scene, mujoco.MjData(peer)
    q, v, u = random_states(scene, 20, np.random.default_rng(0), Ranges(gap=(-0.003, 0.001), speed=3.0))
    step = model.predict(q, v, u)
    for k in range(len(q)):
        with quiet():
            mujoco.mj_resetData(peer, data)
            data.qpos[:], data.qvel[:], data.ctrl[:] = q[k], v[k], u[k, : peer.nu]
            data.act[:] = u[k, peer.nu :]
            mujoco.mj_step(peer, data)
        change = np.abs(data.qvel - v[k]).max()
        assert np.abs(step.v_next[k] - data.qvel).max() < 1e-5 * change + 1e-6, k
        assert np.abs(scene.difference(data.qpos, step.q_next[k])).max() < 1e-5 * (change + 1) * peer.opt.timestep, k


@pytest.mark.parametrize("name", FILES)
def test_derivatives(name: str) -> None:
    model, _ = model_of(FILES[name])
    smoothing = Barrier(1e-4)
    soft = model.with_settings(smoothing=smoothing, backward_smoothing=smoothing, path_tolerance=1e-12)
    states = random_states(model.scene, 3, np.random.default_rng(1), Ranges(gap=(-0.003, -0.001), speed=1.0))
    assert compare(soft, *states, parameters=40)["worst"] < 1e-4


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("name", ["RK4", "RK4 with contact", "RK4 with a filter", "implicit", "a damper"])
def test_products_are_those_of_the_jacobian(name: str, substeps: int) -> None:
    model = model_of(FILES[name])[0].with_settings(substeps=substeps)
    rng = np.random.default_rng(2)
    q, v, u = random_states(model.scene, 5, rng, Ranges(gap=(-0.003, 0.001), speed=1.0))
    given = rng.normal(size=(2, *v.shape))
    forward = model.stepper.forward(q, v, u, model.parameters, tape=True)
    out = model.stepper.backward(u, model.parameters, forward["tape"], *given, want_theta=True)
    found = np.concatenate([out[key] for key in ("gq", "gv", "gu", "gtheta")], axis=1)
    jacobian = model.predict(q, v, u, parameter_jacobian=True).jacobian
    assert jacobian is not None
    expected = np.einsum("bi,bij->bj", np.concatenate(list(given), axis=1), jacobian)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_activations_under_rk4() -> None:
    """What follows a step's activations is what the core and MuJoCo have."""
    for name in ("RK4 with a filter", "RK4 with an exact filter", "RK4 with an integrator"):
        model, peer = model_of(FILES[name])
        assert model.activations is not None
        data = mujoco.MjData(peer)
        data.ctrl[:], data.act[:] = 0.7, 0.2
        controls = np.array([[*data.ctrl, *data.act]])
        mujoco.mj_step(peer, data)
        after = model.activations.next(torch.from_numpy(controls)).numpy()
        np.testing.assert_allclose(after[0], data.act, rtol=0, atol=1e-14)


def test_ends_of_a_limit_that_act_at_once_are_told() -> None:
    scene = Scene.from_mjcf(arm("", RANGE + ' margin=".3"'))
    assert ("joint limit", "c") in [(told.kind, told.name) for told in scene.differences]


def test_a_tendon_that_no_joint_moves_yet() -> None:
    """It runs beside a ball that may come in its way: its weight is 0 at qpos0."""
    world = """<site name="s"/><site name="t" pos=".2 0 0"/>
    <body pos=".1 0 .2"><joint type="slide"/><geom name="ball" size=".05"/></body>"""
    path = '<site site="s"/><geom geom="ball"/><site site="t"/>'
    rest = f'<tendon><spatial range="0 .1" frictionloss=".1">{path}</spatial></tendon>'
    model = ComplementarityModel(Scene.from_mjcf(f"<mujoco><worldbody>{world}</worldbody>{rest}</mujoco>"))
    q = np.linspace(-0.25, 0.0, 20)[:, None]
    step = model.predict(q, 0 * q, np.zeros((20, 0)), parameter_jacobian=True)
    assert np.isfinite(step.v_next).all()
    assert np.isfinite(step.jacobian).all()
    assert (step.status == 0).all()


@pytest.mark.parametrize("kind", ["hinge", "slide"])
@pytest.mark.parametrize("mass", ["1e-6", "1", "1e5"])
def test_joints_that_move_no_mass_are_named(kind: str, mass: str) -> None:
    """MuJoCo takes two slides along one axis for apart; they had loaded, and every step was NaN."""
    one, two = (f'<joint name="{name}" type="{kind}"/>' for name in ("one", "two"))
    with pytest.raises(UserError, match="joint 'one' can move without moving any mass"):
        Scene.from_mjcf(only(f'<body>{one}{two}<geom size=".1" mass="{mass}"/></body>'))


def test_joints_that_differ_move_a_mass() -> None:
    """One after another along one axis, hinges side by side, and a joint between a rotor and its link."""
    inner = '<body><joint type="slide"/><geom size=".1"/></body>'
    hinges = '<body pos="1 0 0"><joint pos=".1 0 0"/><joint pos=".2 0 0"/><joint type="slide"/><geom size=".1"/></body>'
    rotor = '<body pos="2 0 0"><joint armature=".01"/><joint stiffness="100"/><geom size=".1"/></body>'
    scene = Scene.from_mjcf(only(f'<body><joint type="slide"/><geom size=".1"/>{inner}</body>{hinges}{rotor}'))
    assert scene.nv == 7
    step = ComplementarityModel(scene).predict(scene.q0[None], np.ones((1, 7)), np.zeros((1, 0)))
    assert np.isfinite(step.v_next).all()


@pytest.mark.parametrize(("size", "mass"), [(5e-4, 1e-6), (1e-3, 1e-6), (5.0, 1e6)])
def test_small_and_large_bodies(size: float, mass: float) -> None:
    """A box of a milligram had been taken for one without mass; steps are those of a box of 1 kg in other units."""
    found = []
    for length, weight in ((size, mass), (0.1, 1.0)):
        unit = length / 0.1
        h, tc = 0.002 * unit**0.5, 0.02 * unit**0.5
        soft = f'solref="{tc} 1" solimp=".9 .95 {0.001 * unit} .5 2"'
        shape = f'type="box" size="{length} {0.7 * length} {0.4 * length}" mass="{weight}" {soft}'
        body = f'<body pos="0 0 {0.6 * length}" euler="20 10 0"><freejoint/><geom {shape}/></body>'
        model = ComplementarityModel(Scene.from_mjcf(only(FLAT.replace("/>", f" {soft}/>") + body, f'timestep="{h}"')))
        q, v = model.scene.q0[None], np.zeros((1, 6))
        for _ in range(100):
            step = model.predict(q, v, np.zeros((1, 0)))
            q, v = step.q_next, step.v_next
            assert step.status[0] == 0
        found.append(np.concatenate([q[0, :3] / unit, q[0, 3:]]))
    np.testing.assert_allclose(found[0], found[1], atol=1e-4)
