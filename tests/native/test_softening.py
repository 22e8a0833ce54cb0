"""Softening by row: what one body is needs not be felt by another; the published adaptive rule."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.contact import ABS, Barrier, Exact, Gaussian, Relaxed
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

SLOPE = np.deg2rad(10)
BOX = """<body name="box" pos="0 0 0"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
  <geom type="sphere" size="0.01" mass="0.001" friction="0.5"/></body>"""
HEAVY = """<body name="heavy" pos="5 0 0.5"><joint type="slide" axis="0 0 1"/>
  <geom type="sphere" size="0.5" mass="500"/></body>"""
JOINT = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody><body><joint type="hinge" axis="0 1 0"
  frictionloss="0.1" solreffriction="0.004 1" solimpfriction="0.9999 0.9999 0.001"/>
  <geom type="sphere" size="0.1" mass="1"/>
  </body></worldbody><actuator><motor joint="j"/></actuator></mujoco>""".replace(
    '<joint type="hinge"', '<joint name="j" type="hinge"'
)
STANCE = (
    """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="9 9 1"/>{bodies}</worldbody></mujoco>"""
)
BALL = (
    '<body pos="{x} 0 {z}"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
    '<geom type="sphere" size="0.1" mass="1"/></body>'
)


def scene_of(folder: Path, mjcf: str, law: str = "rigid") -> Scene:
    (folder / "scene.xml").write_text(mjcf)
    return Scene.from_mjcf(folder / "scene.xml", contact_law=law)


def creep(folder: Path, bodies: str, smoothing: Smoothing) -> float:
    """Speed [m/s] of the 1 g box down a slope on which it should stick, after 0.2 s."""
    gravity = f"{9.81 * np.sin(SLOPE):.15g} 0 {-9.81 * np.cos(SLOPE):.15g}"
    mjcf = f"""<mujoco><option timestep="0.002" gravity="{gravity}"/><worldbody>
      <geom type="plane" size="9 9 1" pos="0 0 -0.01" friction="0.5"/>{bodies}</worldbody></mujoco>"""
    model = ComplementarityModel(scene_of(folder, mjcf), substeps=100, smoothing=smoothing)
    r = model.predict(model.scene.q0[None], np.zeros((1, model.scene.nv)), np.zeros((1, 0)))
    assert r.status[0] == 0
    return abs(float(r.v_next[0, 0]))


@pytest.mark.parametrize("smoothing", [Exact(), Relaxed()])
def test_a_light_box_does_not_feel_a_heavy_body_elsewhere(tmp_path: Path, smoothing: Exact | Relaxed) -> None:
    alone, beside = creep(tmp_path, BOX, smoothing), creep(tmp_path, BOX + HEAVY, smoothing)
    assert beside < 2 * smoothing.speed
    assert beside == pytest.approx(alone, rel=1e-3, abs=1e-12)


def test_softening_follows_the_gravity_of_the_scene(tmp_path: Path) -> None:
    for gravity in (1.62, 9.81, 24.8):
        mjcf = (
            f'<mujoco><option timestep="0.002" gravity="0 0 {-gravity}"/><worldbody><geom type="plane" size="9 9 1"/>'
        )
        scene = scene_of(tmp_path, mjcf + BALL.format(x=0, z=0.1) + "</worldbody></mujoco>")
        model = ComplementarityModel(scene, substeps=200, smoothing=Relaxed(1e-3))
        gap = model.scene.gaps(model.predict(scene.q0[None], np.zeros((1, 2)), np.zeros((1, 0))).q_next[0])
        assert gap[0] == pytest.approx(1e-3 * model.time_step, rel=1e-2)  # hovers at speed * h, whatever its weight is


@pytest.mark.parametrize("smoothing", [Relaxed(), Relaxed(1e-3), Barrier(1e-4), Barrier(1e-2), Gaussian(1e-3), Exact()])
def test_contacts_softening_does_not_smear_dry_friction(tmp_path: Path, smoothing: Smoothing) -> None:
    """At half its friction loss a joint stands still: closed form 2/3 eps, eps the speed at which friction yields."""
    model = ComplementarityModel(scene_of(tmp_path, JOINT), smoothing=smoothing)
    q = v = np.zeros((1, 1))
    for _ in range(300):
        r = model.predict(q, v, np.full((1, 1), 0.05))
        q, v = r.q_next, r.v_next
    assert abs(v[0, 0]) < 1e-3
    slipping = model.predict(q, v, np.full((1, 1), 0.15)).v_next[0, 0] - v[0, 0]
    inertia = model.smooth_dynamics(q, v)["M"][0, 0, 0]
    assert slipping == pytest.approx(0.05 * model.time_step / inertia, abs=2e-3)


def kappa_at(model: ComplementarityModel, height: float) -> np.ndarray:
    """Products of normal impulse and slack [J] of the two balls' contacts after a step from these gaps (0, height)."""
    q = model.scene.q0.copy()
    q[1], q[3] = 0.0, height
    q, v = q[None], np.zeros((1, 4))
    r = model.predict(q, v, np.zeros((1, 0)), impulse=True)
    assert r.status[0] == 0
    assert r.impulse is not None
    gap = model.scene.gaps(q[0])[:2]
    return r.impulse[0, :2, 0] * (gap / model.time_step + r.v_next[0, [1, 3]])


def test_the_published_rule(tmp_path: Path) -> None:
    """One kappa for all contacts, from the gap of the nearest idle one; at its floor where all carry load."""
    bodies = BALL.format(x=0, z=0.1) + BALL.format(x=1, z=0.1)
    scene = scene_of(tmp_path, STANCE.format(bodies=bodies))
    policy = ABS(peak=1e-3, reach=2e-3)
    model = ComplementarityModel(scene, smoothing=policy)
    floor = ComplementarityModel(scene, smoothing=Exact())
    for height in (1e-3, 2e-3, 3e-3):
        expected = policy.peak * np.exp(-((height / policy.reach) ** 2))
        np.testing.assert_allclose(kappa_at(model, height), expected, rtol=1e-5)  # the loaded contact too
    np.testing.assert_allclose(kappa_at(model, 0.0), kappa_at(floor, 0.0), rtol=1e-3)
    np.testing.assert_allclose(kappa_at(floor, 0.0), 1e-9 * 9.81 * model.time_step, rtol=1e-3)  # unit masses


def test_the_published_rule_holds_kappa_fixed_in_the_derivative(tmp_path: Path) -> None:
    """As the derivative it is that of the constant kappa which it comes to; in the simulation too."""
    scene = scene_of(tmp_path, STANCE.format(bodies=BALL.format(x=0, z=0.1) + BALL.format(x=1, z=0.1)))
    policy, q = ABS(peak=1e-3, reach=2e-3), scene.q0.copy()
    q[1], q[3] = 0.0, 1e-3
    state = q[None], np.zeros((1, 4)), np.zeros((1, 0))
    same = Barrier(policy.peak * np.exp(-0.25))
    soft = ComplementarityModel(scene, smoothing=same).predict(*state, jacobian=True)
    for settings in ({"smoothing": policy}, {"smoothing": Exact(), "backward_smoothing": policy}):
        ours = ComplementarityModel(scene, **settings).predict(*state, jacobian=True)
        np.testing.assert_allclose(ours.jacobian, soft.jacobian, rtol=0, atol=1e-6)
