"""Contact of two bodies: Jacobians and vector-Jacobian products of the step equal finite differences of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.studies.derivatives.differences import SMOOTHINGS, compare
from cmbrl.contact import Barrier
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

from .pairs import BOX, BRICK, CAPSULE, PLANE, SPATIAL, Pair, scene_of, states
from .test_adjoint import mismatch_at

LAWS = [("mujoco", 0.0), ("rigid", 0.0), ("rigid", 0.5), ("spring-damper", 0.0), ("logistic", 0.0)]
KINDS = {"q", "v", "mass", "com_x", "friction", "radius", "gravity"}
OF_LAW = {
    "mujoco": {"softness_time", "softness_damping", "softness_scale"}
    | {f"impedance_{part}" for part in ("low", "high", "width")},
    "rigid": {"softness_time"},
    "spring-damper": {"contact_stiffness", "contact_damping"},
    "logistic:stiffness=300": {"activation_stiffness"},
}
COUNT = 6
MATCH = 1e-8  # of both ways, at conditions of up to 1e7


def assert_exact(scene: Scene, pair: Pair, restitution: float, smoothing: str, count: int = COUNT) -> None:
    theta, groups = scene.parameter_vector(), np.array([p.group for p in scene.parameters])
    theta[groups == "restitution"] = restitution
    theta[groups == "softness_time"] *= 1.25  # off MuJoCo's least time constant
    model = ComplementarityModel(
        scene, time_step=0.002, smoothing=SMOOTHINGS[smoothing], parameters=theta, path_tolerance=1e-12
    )
    q, v, u = states(scene, pair, count, np.random.default_rng(0))
    smooth = model.smooth_dynamics(q, v)
    nearest = smooth["J"][np.arange(count), smooth["gap"].argmin(axis=1), 0]
    speed = np.einsum("bv,bv->b", nearest, v)
    v[1:] *= -np.sign(speed[1:, None])  # all but one close in
    row = compare(model, q, v, u, 30)
    expected = KINDS | OF_LAW[scene.contact_law] | ({"u", "gear", "damping"} if scene.planar else set())
    assert set(row["kinds"]) - {"restitution"} >= expected
    assert not restitution or row["kinds"]["restitution"]["count"] > 0
    assert row["median"] <= 1e-6, row
    assert row["worst"] <= 1e-4, row
    assert row["across_kinks"] + row["vague"] <= 0.1 * row["columns"], row
    assert row["unsolved"] == 0, row
    impulse = model.predict(q, v, u, impulse=True).impulse
    assert impulse is not None
    assert (impulse[..., 0] > 1e-3).any(axis=1).mean() >= 0.5  # they do touch
    assert mismatch_at(model, q, v, u, np.random.default_rng(1)) < MATCH


@pytest.mark.parametrize(("law", "restitution"), LAWS)
@pytest.mark.parametrize("name", SPATIAL)
def test_spatial_pairs(name: str, law: str, restitution: float, tmp_path: Path) -> None:
    assert_exact(scene_of(SPATIAL[name], tmp_path, law), SPATIAL[name], restitution, "kappa 1e-4")


@pytest.mark.parametrize(("law", "restitution"), LAWS)
@pytest.mark.parametrize("name", PLANE)
def test_planar_pairs(name: str, law: str, restitution: float, tmp_path: Path) -> None:
    assert_exact(scene_of(PLANE[name], tmp_path, law, planar=True), PLANE[name], restitution, "kappa 1e-4")


@pytest.mark.parametrize("smoothing", ["exact", "kappa 1e-2", "gaussian"])
@pytest.mark.parametrize("name", ["capsule-capsule any", "sphere-box any"])
def test_smoothings(name: str, smoothing: str, tmp_path: Path) -> None:
    assert_exact(scene_of(SPATIAL[name], tmp_path, "mujoco"), SPATIAL[name], 0.0, smoothing)


@pytest.mark.parametrize("name", ["capsule-capsule any", "sphere-box any"])
def test_against_the_world(name: str, tmp_path: Path) -> None:
    assert_exact(scene_of(SPATIAL[name], tmp_path, "mujoco", fixed=True), SPATIAL[name], 0.0, "kappa 1e-4")


@pytest.mark.parametrize("law", ["mujoco", "rigid", "spring-damper"])
@pytest.mark.parametrize("slip", [0.0, 0.15, 0.4])
def test_parallel_capsules(law: str, slip: float, tmp_path: Path) -> None:
    """One point, of the overlap; derivatives finite, and equal by both ways, though the closest points are any."""
    pair = Pair(CAPSULE, CAPSULE)
    model = ComplementarityModel(scene_of(pair, tmp_path, law), smoothing=Barrier(1e-6))
    q = np.tile(model.scene.q0, (1, 1))
    q[0, 7:] = [0.119, 0.0, slip, 1.0, 0.0, 0.0, 0.0]
    q[0, :7] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    v = np.zeros((1, 12))
    v[0, 6] = -0.1
    assert model.scene.gaps(q)[0, 0] == pytest.approx(-1e-3, abs=1e-12)
    r = model.predict(q, v, np.zeros((1, 0)), jacobian=True, parameter_jacobian=True, impulse=True)
    assert r.status[0] == 0
    assert r.jacobian is not None
    assert r.impulse is not None
    assert np.isfinite(r.jacobian).all()
    assert r.impulse[0, 0, 0] > 1e-3
    assert mismatch_at(model, q, v, np.zeros((1, 0)), np.random.default_rng(0)) < MATCH


@pytest.mark.parametrize("gap", [1e-6, 1e-12, 0.0, -1e-12, -1e-6])
def test_a_box_rests_at_any_small_gap(gap: float) -> None:
    """A corner at distance 0 from a side still has the side's normal: the box does not fall for a step."""
    boxes = f'<geom {BOX}/><body pos="0 0 {0.4 + gap:.17g}"><freejoint/><geom {BRICK}/></body>'
    model = ComplementarityModel(Scene.from_mjcf(f"<mujoco><worldbody>{boxes}</worldbody></mujoco>", (), "rigid"))
    fallen = model.predict(model.scene.q0[None], np.zeros((1, 6)), np.zeros((1, 0))).v_next[0, 2]
    assert abs(fallen) < 1e-3 * 9.81 * model.time_step + 1.1 * abs(gap) / model.time_step
