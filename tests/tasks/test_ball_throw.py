"""The ball's real system against closed forms: flight, bounce, spin."""

from __future__ import annotations

import builtins

import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.tasks.ball_throw import TASK

pytest.importorskip("pymunk")
from cmbrl.tasks.ball_throw import real


@pytest.fixture(scope="module")
def log():
    return TASK.record(2000, seed=0)


def flying(log):
    """Rows far from ground and wall during the whole step."""
    away = (log.q[:, 1] > 0.2) & (log.q_next[:, 1] > 0.2)
    return away & ((np.abs(log.q[:, 0] - real.WALL_X) > 0.25) | (log.q[:, 1] > 0.75))


def test_flight_is_a_parabola(log):
    rows = flying(log)
    assert rows.sum() > 500
    h = log.dt
    fall = np.array([0.0, -real.GRAVITY, 0.0])
    assert np.allclose(log.v_next[rows], log.v[rows] + h * fall, atol=1e-9)
    exact = log.q[rows] + h * log.v[rows] + h**2 / 2 * fall
    assert np.allclose(log.q_next[rows], exact, atol=2e-6), "first order in 20 us"


def test_bounces_have_the_product_of_both_elasticities_and_frictions(log):
    """Single bounces on the ground: restitution of normal speed, Coulomb impulse at most mu times the normal one."""
    v, w = log.v, log.v_next
    single = (v[:, 1] < -1.0) & (w[:, 1] > 0.5) & (np.abs(log.q[:, 0] - real.WALL_X) > 0.25)
    assert single.sum() > 20
    # Time of impact from the parabola; speeds there from gravity alone.
    height = log.q[single, 1] - real.RADIUS
    down = (v[single, 1] + np.sqrt(v[single, 1] ** 2 + 2 * real.GRAVITY * height)) / real.GRAVITY
    before = -(v[single, 1] - real.GRAVITY * down)
    after = w[single, 1] + real.GRAVITY * (log.dt - down)
    assert np.allclose(after / before, real.RESTITUTION, rtol=1e-3)
    normal = before + after
    slip = v[single, 0] - real.RADIUS * v[single, 2]  # of the lowest point; a hinge about +y turns it towards -x
    change = w[single, 0] - v[single, 0]
    expected = -np.sign(slip) * np.minimum(real.FRICTION * normal, np.abs(slip) / 3)  # m r^2 / I = 2
    assert np.allclose(change, expected, atol=2e-3)
    assert np.allclose(real.RADIUS * (w - v)[single, 2], -2 * change, atol=2e-6)


def test_the_ball_never_sinks_in(log):
    assert log.q[:, 1].min() > real.RADIUS - 2e-3
    beside = log.q[:, 1] < real.WALL_HEIGHT
    assert (np.abs(log.q[beside, 0] - real.WALL_X).min()) > real.RADIUS + real.WALL_RADIUS - 2e-3


def test_scene_and_log_belong_together(log):
    scene = TASK.load_scene()
    log.check(scene, dt=TASK.control_dt)
    assert scene.planar
    assert scene.total_mass == pytest.approx(real.MASS)
    assert {"friction.ball", "restitution.ball", "gravity"} <= {p.name for p in scene.parameters}


def test_determinism_and_episodes(log):
    assert np.array_equal(TASK.record(150, seed=0).q_next, log.q_next[:150])
    assert not np.array_equal(TASK.record(150, seed=1).q, log.q[:150])
    assert log.n_episodes == 20
    assert len(log.windows(real.EPISODE_STEPS)) == 20


def test_no_control():
    with pytest.raises(UserError, match="cannot be driven by a policy"):
        TASK.record(5, behaviour=lambda observation: observation)


def test_missing_pymunk_is_one_line(monkeypatch):
    real_import = builtins.__import__

    def without(name, *rest):
        if name == "pymunk":
            raise ImportError(name)
        return real_import(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(UserError, match=r"pip install 'cmbrl\[tasks\]'"):
        TASK.record(5)
