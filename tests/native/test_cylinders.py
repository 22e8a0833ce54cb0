"""Cylinders on planes are round: they roll without a bump, lie on their side, stand on an end, and tip over its rim."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.bench.studies.derivatives.differences import SMOOTHINGS, compare
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

from .test_adjoint import mismatch_at

R, HALF = 0.1, 0.03
WHEEL = f"""<mujoco><option timestep="0.001"/><worldbody><geom type="plane" size="1 1 1"/>
<body><freejoint/><geom type="cylinder" size="{R} {HALF}" mass="1" friction="1"/></body></worldbody></mujoco>"""
ON_ITS_SIDE = [np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]
UPRIGHT = [1.0, 0.0, 0.0, 0.0]


@pytest.fixture
def wheel(tmp_path: Path) -> Path:
    file = tmp_path / "wheel.xml"
    file.write_text(WHEEL, encoding="utf-8")
    return file


def tilted(angle: float, about: float = 0.7) -> np.ndarray:
    """The quaternion of an upright cylinder turned by ``angle`` [rad] about a horizontal axis."""
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * np.array([np.cos(about), np.sin(about), 0.0]))])


def simulate(file: Path, law: str, q: np.ndarray, v: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Trajectories (steps, nq) of ours and of MuJoCo."""
    ours, model = ComplementarityModel(Scene.from_mjcf(file, contact_law=law)), mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q, v
    q, v = q[None], v[None]
    found = np.empty((2, steps, model.nq))
    for k in range(steps):
        r = ours.predict(q, v, np.zeros((1, 0)))
        assert r.status[0] == SolverStatus.CONVERGED
        mujoco.mj_step(model, data)
        q, v = r.q_next, r.v_next
        found[:, k] = q[0], data.qpos
    return found[0], found[1]


def test_a_wheel_rolls_without_a_bump(wheel: Path) -> None:
    """At 1 m/s for two metres, three turns: the height is constant and MuJoCo's."""
    start, speed = np.array([0.0, 0.0, R, *ON_ITS_SIDE]), np.array([1.0, 0.0, 0.0, 0.0, 0.0, -1.0 / R])
    ours, theirs = simulate(wheel, "mujoco", start, speed, 2000)
    assert theirs[-1, 0] > 1.9
    assert np.ptp(ours[500:, 2]) < 1e-8
    np.testing.assert_allclose(ours[500:, 2], theirs[500:, 2], rtol=0, atol=1e-7)
    np.testing.assert_allclose(ours[:, 0], theirs[:, 0], rtol=0, atol=1e-3)
    rigid, _ = simulate(wheel, "rigid", start, speed, 1000)
    np.testing.assert_allclose(rigid[:, 2], R, rtol=0, atol=1e-7)
    np.testing.assert_allclose(rigid[-1, 0], 1.0, rtol=0, atol=1e-4)


def test_a_wheel_turns_over_no_corner_when_it_is_pushed_slowly(wheel: Path) -> None:
    """The gap of the lowest point at every angle of the wheel, on its side and oblique, is the closed form."""
    scene = Scene.from_mjcf(wheel)
    for tilt in (np.pi / 2, 1.0, 0.3, 2e-3):
        for spin in np.linspace(0, 2 * np.pi, 37):
            roll = np.array([np.cos(spin / 2), 0, 0, np.sin(spin / 2)])
            q = np.zeros(7)
            q[2] = 0.2
            mujoco.mju_mulQuat(q[3:], tilted(tilt), roll)
            lowest = 0.2 - HALF * abs(np.cos(tilt)) - R * np.sin(tilt)
            assert scene.gaps(q).min() == pytest.approx(lowest, abs=1e-12)


@pytest.mark.parametrize("law", ["mujoco", "rigid"])
def test_it_stands_and_lies(law: str, wheel: Path) -> None:
    """Dropped nearly flat it comes to stand as high as in MuJoCo; laid on its side it stays."""
    for turn, height in ((tilted(1e-2), HALF), (np.array(ON_ITS_SIDE), R)):
        ours, theirs = simulate(wheel, law, np.array([0, 0, height + 2e-3, *turn]), np.zeros(6), 1000)
        assert np.abs(np.diff(ours[-100:], axis=0)).max() < 1e-10
        assert ours[-1, 2] == pytest.approx(theirs[-1, 2] if law == "mujoco" else height, abs=1e-7)
        assert np.hypot(*ours[-1, :2]) < 1e-3


def test_it_tips_over_its_rim(tmp_path: Path) -> None:
    """A tall cylinder on a slope stands up to tan = R / half, in any direction, and falls beyond it."""
    for share, stands in ((0.93, True), (1.07, False)):
        for turn in (0.0, 0.3, np.pi / 4):
            slope = np.arctan(share * 0.1 / 0.4)
            gravity = 9.81 * np.array([np.sin(slope) * np.cos(turn), np.sin(slope) * np.sin(turn), -np.cos(slope)])
            file = tmp_path / "tall.xml"
            file.write_text(
                f'<mujoco><option timestep="0.002" gravity="{gravity[0]} {gravity[1]} {gravity[2]}"/><worldbody>'
                '<geom type="plane" size="1 1 1" friction="2"/><body pos="0 0 .4"><freejoint/>'
                '<geom type="cylinder" size=".1 .4" mass="1"/></body></worldbody></mujoco>',
                encoding="utf-8",
            )
            model = ComplementarityModel(Scene.from_mjcf(file, contact_law="rigid"), substeps=500)
            r = model.predict(model.scene.q0[None], np.zeros((1, 6)), np.zeros((1, 0)))
            upright = 1 - 2 * (r.q_next[0, 4] ** 2 + r.q_next[0, 5] ** 2)
            assert (upright > 1 - 1e-5) == stands, (share, turn, upright)


@pytest.mark.parametrize(("law", "e"), [("mujoco", 0.0), ("rigid", 0.0), ("rigid", 0.5), ("spring-damper", 0.0)])
@pytest.mark.parametrize("tilt", [0.0, 4e-4, 0.02, 0.5, np.pi / 2])
def test_derivatives(law: str, e: float, tilt: float, wheel: Path) -> None:
    """Of rolling, wobbling, lying and standing, inside the region too where the lowest point runs to the centre."""
    scene, rng, count = Scene.from_mjcf(wheel, contact_law=law), np.random.default_rng(0), 6
    theta = scene.parameter_vector()
    theta[[p.group == "softness_time" for p in scene.parameters]] *= 1.25
    theta[[p.group == "restitution" for p in scene.parameters]] = e
    model = ComplementarityModel(scene, smoothing=SMOOTHINGS["kappa 1e-4"], parameters=theta, path_tolerance=1e-12)
    q, v = np.zeros((count, 7)), rng.uniform(-1, 1, (count, 6))
    for row in q:
        row[3:] = tilted(tilt, rng.uniform(0, 6))
    q[:, 2] = -scene.gaps(q).min(axis=1) + rng.uniform(-2e-3, 1e-3, count)
    v[:, 2] -= 0.5
    row = compare(model, q, v, np.zeros((count, 0)), 30)
    assert row["unsolved"] == 0, row
    assert row["median"] <= 1e-6, row
    assert row["worst"] <= 1e-4, row
    assert row["across_kinks"] + row["vague"] <= 0.1 * row["columns"], row
    assert mismatch_at(model, q, v, np.zeros((count, 0)), rng) < 1e-8


def test_gaps_and_rows_are_those_of_mujoco(wheel: Path) -> None:
    """At random poses: all that MuJoCo has, with Jacobians; of the end that lies higher its lowest point alone."""
    scene, model = Scene.from_mjcf(wheel), mujoco.MjModel.from_xml_path(str(wheel))
    model.opt.cone, model.opt.jacobian = mujoco.mjtCone.mjCONE_ELLIPTIC, mujoco.mjtJacobian.mjJAC_DENSE
    model.geom_margin[:] = 1.0
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    rims = np.flatnonzero(scene.core.con_axisA.any(axis=1)).tolist()
    assert len(rims) == 2 + 6
    for _ in range(20):
        data.qpos[:] = [*rng.normal(size=2), 0.2, *rng.normal(size=4)]
        data.qpos[3:] /= np.linalg.norm(data.qpos[3:])
        mujoco.mj_forward(model, data)
        smooth = ComplementarityModel(scene).smooth_dynamics(data.qpos[None], np.zeros((1, 6)))
        np.testing.assert_allclose(smooth["gap"][0], scene.gaps(data.qpos), rtol=0, atol=1e-12)
        theirs = [data.efc_J.reshape(-1, 6)[c.efc_address : c.efc_address + 3] for c in data.contact]
        seen = [k for k in rims if smooth["gap"][0, k] < 100.0]
        assert len(seen) == 2 + 4
        np.testing.assert_allclose(
            sorted({round(float(smooth["gap"][0, k]), 9) for k in seen}),
            sorted({round(c.dist, 9) for c in data.contact}),
        )
        for rows in smooth["J"][0, seen]:  # two points of one end are equally high
            assert min(_apart(rows, expected) for expected in theirs) < 1e-9


def _apart(rows: np.ndarray, expected: np.ndarray) -> float:
    """By how much the rows (3, 6) of one contact differ but for the tangents, which may be any."""
    along = np.abs(rows[0] - expected[0]).max()
    return float(max(along, np.abs(rows[1:].T @ rows[1:] - expected[1:].T @ expected[1:]).max()))


def test_an_oblique_cylinder_makes_the_scene_spatial(tmp_path: Path) -> None:
    file = tmp_path / "oblique.xml"
    file.write_text(
        '<mujoco><worldbody><geom name="ground" type="plane" size="1 1 1"/><body pos="0 0 1">'
        '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint type="hinge" axis="0 1 0"/>'
        '<geom name="roll" type="cylinder" size=".1 .3" zaxis="1 1 0"/></body></worldbody></mujoco>',
        encoding="utf-8",
    )
    scene = Scene.from_mjcf(file)
    assert not scene.planar
    assert scene.planar_why == "a cylinder is oblique to the plane of motion (roll - ground)"


@pytest.mark.parametrize("margin", [0.0, 0.01])
@pytest.mark.parametrize("tilt", [0.0, 1e-9, 2e-3, 0.05, 0.5, np.pi / 2 - 0.01, np.pi / 2, np.pi])
def test_a_step_under_mujocos_law_is_mujocos(tilt: float, margin: float) -> None:
    """Where rows do not look ahead, it touches with MuJoCo's points: the lowest, which may be any, and two more."""
    text = WHEEL.replace('mass="1"', f'mass="1" margin="{margin}"')
    model, scene = mujoco.MjModel.from_xml_string(text), Scene.from_mjcf(text)
    model.opt.tolerance, model.opt.iterations = 0.0, 200
    data, rng, ours = mujoco.MjData(model), np.random.default_rng(0), ComplementarityModel(scene, sliding="convex")
    for _ in range(6):
        q, v = np.zeros(7), rng.normal(size=6) * 0.3
        spin = rng.uniform(0, 6)
        mujoco.mju_mulQuat(q[3:], tilted(tilt, rng.uniform(0, 6)), np.array([np.cos(spin), 0, 0, np.sin(spin)]))
        q[2] = HALF * abs(np.cos(tilt)) + R * abs(np.sin(tilt)) - rng.uniform(0, 2e-3)
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_step(model, data)
        found = ours.predict(q[None], v[None], np.zeros((1, 0))).v_next[0]
        np.testing.assert_allclose(found, data.qvel, rtol=0, atol=1e-5 * (np.abs(data.qvel - v).max() + 0.1))


@pytest.mark.parametrize("tilt", [0.02, 0.5, np.pi / 2])
def test_derivatives_of_mujocos_points(tilt: float) -> None:
    scene, rng, count = Scene.from_mjcf(WHEEL), np.random.default_rng(1), 6
    model = ComplementarityModel(scene, sliding="convex", path_tolerance=1e-12)
    q, v, step = np.zeros((count, 7)), rng.uniform(-1, 1, (count, 6)), 1e-6
    for row in q:
        row[3:] = tilted(tilt, rng.uniform(0, 6))
    q[:, 2] = HALF * np.cos(tilt) + R * np.sin(tilt) - rng.uniform(1e-3, 2e-3, count)
    found = model.predict(q, v, np.zeros((count, 0)), jacobian=True).jacobian
    assert found is not None
    for k in range(12):
        ahead, behind = (sign * step * np.tile(np.arange(12) == k, (count, 1)) for sign in (1.0, -1.0))
        sides = [
            model.predict(scene.integrate(q, move[:, :6]), v + move[:, 6:], np.zeros((count, 0))).v_next
            for move in (ahead, behind)
        ]
        differences = (sides[0] - sides[1]) / (2 * step)
        np.testing.assert_allclose(found[:, 6:, k], differences, rtol=0, atol=1e-4 * (1.0 + np.abs(differences).max()))
