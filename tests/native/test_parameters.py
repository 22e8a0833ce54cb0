"""Parameters that reach beyond the file: shapes of inertias, softness by mass, friction losses that leave 0."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.states import random_states
from cmbrl.bench.studies.derivatives.differences import RANGES, compare
from cmbrl.contact import Barrier, Exact, Gaussian
from cmbrl.contact.smoothing import Smoothing
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.step_settings import INTEGRATORS
from cmbrl.scene import Scene

TREE = """<mujoco><option timestep=".004"/><worldbody><geom type="plane" size="5 5 .1"/><body name="base" pos="0 0 .3">
<freejoint/><geom type="box" size=".1 .2 .05" euler="10 20 30"/><body name="arm" pos=".2 0 0">
<joint name="ball" type="ball" range="0 40" limited="true"/><geom type="capsule" size=".04" fromto="0 0 0 .3 .1 0"/>
<body name="hand" pos=".3 .1 0"><joint name="wrist" axis="0 1 1" range="-30 30" limited="true" frictionloss=".1"/>
<geom type="box" size=".05 .1 .02" euler="0 40 0"/></body></body></body>
<body name="lone" pos="1 0 .2"><freejoint/><geom size=".1" mass="2"/></body></worldbody></mujoco>"""
PLANAR = """<mujoco><option timestep=".004"/><worldbody><geom type="plane" size="5 5 .1"/>
<body name="base" pos="0 0 .2"><joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<joint name="turn" axis="0 1 0"/><geom type="capsule" size=".05 .1"/><body name="leg" pos="0 0 -.1">
<joint name="knee" axis="0 1 0" range="-40 40" limited="true" frictionloss=".2"/>
<geom type="capsule" size=".04" fromto="0 0 0 .1 0 -.2"/></body></body></worldbody></mujoco>"""
HUNG = """<mujoco><option timestep=".004"/><worldbody><site name="a" pos="-1 0 2"/><site name="b" pos="1 .2 2"/>
<body pos="0 0 .5"><freejoint/><geom type="box" size=".1 .2 .05"/><site name="c" pos="-.1 .1 .05"/>
<site name="d" pos=".1 -.1 .05"/></body></worldbody><tendon>
<spatial name="left"><site site="a"/><site site="c"/></spatial>
<spatial name="right" damping="1"><site site="b"/><site site="d"/></spatial></tendon><actuator>
<motor tendon="left" ctrlrange="-40 0"/><position tendon="right" kp="100" forcerange="-40 0"/></actuator></mujoco>"""
SPREAD = {"mass": (0.6, 1.7), "inertia": (0.4, 2.5), "inertia_tilt": (-0.5, 0.5), "stop_time": (1.5, 3.0)}
SPREAD |= {"stop_damping": (0.3, 2.0), "stop_softness": (0.2, 5.0), "armature": (0.0, 0.0019)}
SPREAD |= {f"com_{axis}": (-0.02, 0.02) for axis in "xyz"}


def written(folder: Path, text: str, contact_law: str = "mujoco") -> Scene:
    file = folder / "scene.xml"
    file.write_text(text, encoding="utf-8")
    return Scene.from_mjcf(file, contact_law=contact_law)


def without_friction(text: str) -> str:
    return text.replace('frictionloss=".1"', "").replace('frictionloss=".2"', "")


def elsewhere(scene: Scene, seed: int) -> np.ndarray:
    """Parameters with other masses and inertias than the file's."""
    rng, theta = np.random.default_rng(seed), scene.parameter_vector()
    for k, p in enumerate(scene.parameters):
        if p.group in SPREAD:
            theta[k] = rng.uniform(*SPREAD[p.group])
    return theta


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("text", [TREE, PLANAR], ids=["spatial", "planar"])
@pytest.mark.parametrize(("law", "smoothing"), [("mujoco", Barrier(1e-4)), ("mujoco", Gaussian(0.01, floor=1e-6)),
                                                ("logistic", Barrier(1e-4)), ("rigid", Barrier(1e-4))])  # fmt: skip
def test_derivatives_away_from_the_file(
    text: str, law: str, smoothing: Smoothing, integrator: str, tmp_path: Path
) -> None:
    scene = written(tmp_path, text, law)
    model = ComplementarityModel(
        scene, smoothing=smoothing, integrator=integrator, parameters=elsewhere(scene, 1), path_tolerance=1e-12
    )
    row = compare(model, *random_states(scene, 12, np.random.default_rng(0), RANGES), 400)
    stops = {"stop", "stop_time", "stop_damping", "stop_softness"}
    expected = {"mass", "inertia", "com_x", "frictionloss", *stops} | ({"inertia_tilt"} if text == TREE else set())
    assert expected <= set(row["kinds"])
    assert row["median"] <= 1e-6, row
    assert row["worst"] <= 1e-4, row
    assert row["across_kinks"] + row["vague"] <= 0.05 * row["columns"], row


@pytest.mark.parametrize("text", [TREE, PLANAR], ids=["spatial", "planar"])
def test_products_with_parameters_of_their_own_in_each_row(text: str, tmp_path: Path) -> None:
    scene = written(tmp_path, without_friction(text))
    model = ComplementarityModel(scene, 2, backward_smoothing=Barrier(1e-3))
    rng = np.random.default_rng(0)
    q, v, u = random_states(scene, 13, rng, RANGES)
    theta = np.array([elsewhere(scene, seed) for seed in range(13)])
    losses = [k for k, p in enumerate(scene.parameters) if p.group == "frictionloss"]
    theta[::2, losses] = 0.01
    g = rng.normal(size=(13, 2 * scene.nv))
    gq, gv = (np.ascontiguousarray(part) for part in np.split(g, 2, axis=1))
    tape = model.stepper.forward(q, v, u, theta, tape=True)["tape"]
    ours = model.stepper.backward(u, theta, tape, gq, gv, want_theta=True)["gtheta"]
    for k in range(13):
        alone = ComplementarityModel(scene, 2, backward_smoothing=Barrier(1e-3), parameters=theta[k])
        r = alone.predict(q[k : k + 1], v[k : k + 1], u[k : k + 1], jacobian=True, parameter_jacobian=True)
        expected = g[k] @ r.jacobian[0][:, 2 * scene.nv + scene.nu :]
        np.testing.assert_allclose(ours[k], expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize(("law", "smoothing"), [("mujoco", Gaussian(0.01, floor=1e-6)), ("rigid", Barrier(1e-4))])
def test_some_columns_are_those_of_all(law: str, smoothing: Smoothing, integrator: str, tmp_path: Path) -> None:
    """In any order, over substeps in which contacts come and go, and where a bounce flies first."""
    scene = written(tmp_path, TREE, law)
    model = ComplementarityModel(scene, 5, smoothing=smoothing, integrator=integrator, parameters=elsewhere(scene, 1))
    rng = np.random.default_rng(0)
    q, v, u = random_states(scene, 40, rng, RANGES)
    first = 2 * scene.nv + scene.nu
    whole = model.predict(q, v, u, parameter_jacobian=True).jacobian
    contacts = np.array([p.group in ("friction", "softness_time", "radius") for p in scene.parameters])
    assert (np.abs(whole[:, :, first:][:, :, contacts]).max(axis=1) == 0.0).any()  # some touch nothing
    for wanted in (rng.permutation(len(scene.parameters))[:17], np.flatnonzero(contacts)[::-1], np.empty(0, dtype=int)):
        some = model.predict(q, v, u, parameter_jacobian=wanted).jacobian
        assert some.shape[2] == first + len(wanted)
        expected = np.concatenate([whole[:, :, :first], whole[:, :, first + wanted]], axis=2)
        np.testing.assert_allclose(some, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("wanted", [[-1], [0, 0], [1000]])
def test_columns_are_numbers_of_parameters(wanted: list[int], tmp_path: Path) -> None:
    model = ComplementarityModel(written(tmp_path, TREE))
    states = random_states(model.scene, 1, np.random.default_rng(0), RANGES)
    with pytest.raises(UserError, match=f"column {wanted[-1]} of {len(model.parameters)} parameters; give each number"):
        model.predict(*states, parameter_jacobian=np.array(wanted))


@pytest.mark.parametrize("wanted", [[True, False], [0.5], [[0, 1]]])
def test_columns_are_whole_numbers_in_a_row(wanted: list[object], tmp_path: Path) -> None:
    model = ComplementarityModel(written(tmp_path, TREE))
    states = random_states(model.scene, 1, np.random.default_rng(0), RANGES)
    with pytest.raises(UserError, match="give numbers of parameters"):
        model.predict(*states, parameter_jacobian=np.array(wanted))


def test_the_step_has_the_inertia_of_the_physical_vector(tmp_path: Path) -> None:
    """The core's inertia is that of a file with these numbers written into it."""
    body = '<mujoco><worldbody><body><freejoint/>{}<geom size=".1" mass="0"/></body></worldbody></mujoco>'
    box = '<inertial pos=".1 .2 .3" quat="1 .2 .3 .4" mass="2" diaginertia=".1 .2 .25"/>'
    scene = written(tmp_path, body.format(box))
    theta = elsewhere(scene, 3)
    mass, *numbers = scene.physical_vector(theta)[:10]
    words = [" ".join(map(repr, map(float, part))) for part in (numbers[:3], numbers[3:])]
    inertial = f'<inertial pos="{words[0]}" mass="{float(mass)!r}" fullinertia="{words[1]}"/>'
    changed = written(tmp_path, body.format(inertial))
    states = random_states(scene, 20, np.random.default_rng(0), RANGES)
    ours = ComplementarityModel(scene, parameters=theta).predict(*states)
    theirs = ComplementarityModel(changed).predict(*states)
    np.testing.assert_allclose(ours.v_next, theirs.v_next, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("smoothing", [Exact(), Barrier(1e-4), Gaussian(0.01, floor=1e-6)], ids=["exact", "kappa", "g"])
@pytest.mark.parametrize("text", [TREE, PLANAR, HUNG], ids=["spatial", "planar", "cables"])
def test_friction_losses_leave_zero(text: str, smoothing: Smoothing, integrator: str, tmp_path: Path) -> None:
    """One-sided differences, extrapolated: limits of 1 to 4 parts in a million of the weight."""
    scene = written(tmp_path, without_friction(text))
    model = ComplementarityModel(scene, smoothing=smoothing, integrator=integrator, path_tolerance=1e-12)
    losses = [k for k, p in enumerate(scene.parameters) if p.group in ("frictionloss", "tendon_frictionloss")]
    assert losses
    q, v, u = random_states(scene, 30, np.random.default_rng(0), RANGES)
    v[::3] *= 1e-3  # some hardly move, within the speed at which friction yields
    r = model.predict(q, v, u, jacobian=True, parameter_jacobian=True)
    for k in losses:
        ours = r.jacobian[:, scene.nv :, 2 * scene.nv + scene.nu + k]
        shifted = []
        for step in (1e-6, 2e-6, 4e-6):
            theta = scene.parameter_vector()
            theta[k] = step
            shifted.append((model.predict(q, v, u, theta).v_next - r.v_next) / step)
        slope = (8 * shifted[0] - 6 * shifted[1] + shifted[2]) / 3  # without the terms of first and second order
        error = np.abs(slope - ours).max(axis=1) / np.maximum(np.abs(ours).max(axis=1), 1e-3)
        assert np.abs(ours).max() > 1e-3
        assert np.median(error) < 1e-5
        assert (error < 1e-2).mean() > 0.9, np.sort(error)  # of the rest, a contact is about to begin or to slip


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("smoothing", [Exact(), Barrier(1e-4)], ids=["exact", "kappa"])
@pytest.mark.parametrize("text", [TREE, PLANAR], ids=["spatial", "planar"])
def test_friction_by_place_and_speed(text: str, smoothing: Smoothing, integrator: str, tmp_path: Path) -> None:
    """Its limit is the file's, more towards one end and at low speed; derivatives in state and parameters."""
    scene = written(tmp_path, text)
    theta, (joint,) = elsewhere(scene, 2), (p.name[15:] for p in scene.parameters if p.group == "friction_slope")
    names = [p.name for p in scene.parameters]
    loss = theta[names.index(f"frictionloss.{joint}")]
    for group, value in {"friction_slope": 0.8 * loss, "stribeck": 0.5 * loss, "stribeck_speed": 0.5}.items():
        theta[names.index(f"{group}.{joint}")] = value
    model = ComplementarityModel(
        scene, smoothing=smoothing, integrator=integrator, parameters=theta, path_tolerance=1e-12
    )
    row = compare(model, *random_states(scene, 20, np.random.default_rng(0), RANGES), 400)
    assert {"friction_slope", "stribeck", "stribeck_speed"} <= set(row["kinds"])
    assert row["median"] <= 1e-6, row
    assert row["worst"] <= 1e-4, row
    assert row["across_kinks"] + row["vague"] <= 0.05 * row["columns"], row


def test_friction_by_place_and_speed_is_what_it_says(tmp_path: Path) -> None:
    """A wheel that slips: dv = -h F/I with F = f0 + f1 q + f2 exp(-|v|/vs), nothing where that is negative."""
    scene = written(
        tmp_path,
        '<mujoco><option timestep=".001"/><worldbody><body><joint name="j" axis="0 0 1" frictionloss=".5"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="2 2 2"/></body></worldbody></mujoco>',
    )
    theta = scene.parameter_vector()
    values = {"frictionloss.j": 0.5, "friction_slope.j": 0.4, "stribeck.j": 0.3, "stribeck_speed.j": 0.7}
    for k, p in enumerate(scene.parameters):
        theta[k] = values.get(p.name, theta[k])
    q, v = np.array([[0.6], [-0.9], [0.0], [-3.0]]), np.array([[1.5], [-0.8], [2.0], [3.0]])
    force = np.maximum(0.0, 0.5 + 0.4 * q + 0.3 * np.exp(-np.abs(v) / 0.7))
    found = ComplementarityModel(scene, parameters=theta).predict(q, v, np.zeros((4, 0)))
    np.testing.assert_allclose(found.v_next, v - 0.001 * np.sign(v) * force / 2.0, rtol=1e-6)
    assert force[3] == 0.0
