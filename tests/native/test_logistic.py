"""The logistic contact law: a share of the approach ends, and the deeper the more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

RADIUS, MASS, STEP, GRAVITY = 0.1, 2.0, 0.005, 9.81
BALL = f"""<mujoco><option timestep="{STEP}"/><worldbody><geom type="plane" size="1 1 1" friction="0.5"/>
  <body pos="0 0 {RADIUS}"><joint type="slide" axis="0 0 1"/><joint type="slide" axis="1 0 0"/>
  <geom type="sphere" size="{RADIUS}" mass="{MASS}" friction="0.5"/></body></worldbody></mujoco>"""


def ball(folder: Path, law: str, **settings: float) -> ComplementarityModel:
    file = folder / "ball.xml"
    file.write_text(BALL)
    return ComplementarityModel(Scene.from_mjcf(file, contact_law=law), **settings)  # type: ignore[arg-type]


@pytest.mark.parametrize("stiffness", [50.0, 300.0])
def test_a_lone_contact_ends_the_logistic_share_of_the_approach(tmp_path: Path, stiffness: float) -> None:
    model = ball(tmp_path, f"logistic:stiffness={stiffness:g}")
    height = np.array([-0.03, -0.005, 0.0, 0.005, 0.03, 0.3])
    speed = np.array([-1.0, -0.2, -1.0, -0.2, -1.0, -1.0])
    q, v = np.zeros((6, 2)), np.stack([speed, 0 * speed], axis=1)
    q[:, 0] = height
    share = 1 / (1 + np.exp(stiffness * height))
    expected = (1 - share) * (speed - STEP * GRAVITY)
    assert model.predict(q, v, np.zeros((6, 0))).v_next[:, 0] == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_contact_neither_pushes_out_nor_pulls(tmp_path: Path) -> None:
    model = ball(tmp_path, "logistic")
    q, v = np.array([[-0.05, 0.0], [-0.05, 0.0]]), np.array([[0.0, 0.0], [2.0, 0.0]])
    after = model.predict(q, v, np.zeros((2, 0))).v_next[:, 0]
    assert after[0] == pytest.approx(0.0, abs=1e-6)  # it stays where it is
    assert after[1] == pytest.approx(2.0 - STEP * GRAVITY, abs=1e-6)


def test_a_resting_ball_sinks_as_the_law_says(tmp_path: Path) -> None:
    """dd/dt = g h exp(-stiffness d), so that it is log(1 + stiffness g h t) / stiffness deep."""
    stiffness, duration = 100.0, 2.0
    model = ball(tmp_path, f"logistic:stiffness={stiffness:g}", time_step=1e-3)
    q, v = np.zeros((1, 2)), np.zeros((1, 2))
    for _ in range(int(duration / 1e-3)):
        r = model.predict(q, v, np.zeros((1, 0)))
        q, v = r.q_next, r.v_next
    depth = np.log(1 + stiffness * GRAVITY * 1e-3 * duration) / stiffness
    assert -q[0, 0] == pytest.approx(depth, rel=2e-2)


def test_friction_brakes_a_slide(tmp_path: Path) -> None:
    """Deep enough that contact carries all the weight, Coulomb's law with the file's coefficient slows it down."""
    model = ball(tmp_path, "logistic")
    after = model.predict(np.array([[-0.1, 0.0]]), np.array([[0.0, 1.0]]), np.zeros((1, 0))).v_next
    assert after[0, 1] == pytest.approx(1.0 - 0.5 * GRAVITY * STEP, abs=1e-6)


def test_rows_left_out_would_not_have_mattered(tmp_path: Path) -> None:
    q = np.stack([np.linspace(-0.2, 1.0, 200), np.zeros(200)], axis=1)
    v = np.stack([np.tile([-2.0, 2.0], 100), np.zeros(200)], axis=1)
    ours, every = (
        ball(tmp_path, "logistic:stiffness=50", prune=prune).predict(q, v, np.zeros((200, 0)))
        for prune in (3.0, np.inf)
    )
    assert np.abs(ours.v_next - every.v_next).max() < 1e-8


@pytest.mark.parametrize(
    "law", ["logistic:stiffness=0", "logistic:stifness=3", "rigid:stiffness=3", "logistic:stiffness=x"]
)
def test_options_that_make_no_sense_are_refused(tmp_path: Path, law: str) -> None:
    with pytest.raises(UserError, match=f"contact law '{law}'"):
        ball(tmp_path, law)


def test_a_law_by_another_name_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="contact law"):
        ball(tmp_path, "logstic")


def test_the_scene_says_which_law(tmp_path: Path) -> None:
    model = ball(tmp_path, "logistic")
    assert model.scene.contact_law == "logistic:stiffness=300"
    (stiffness,) = (p for p in model.scene.parameters if p.group == "activation_stiffness")
    assert stiffness.nominal == 300.0
