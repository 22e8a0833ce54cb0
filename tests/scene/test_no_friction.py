"""Friction of 0 in a file: MuJoCo raises it to 1e-5, which its law of contact makes stiff, and so do we."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus

from .conftest import Load, worst_step

BALL = (
    '<geom name="f" type="plane" size="1 1 .1" friction="{0}" condim="1"/>'
    '<body pos="0 0 .099"><freejoint/><geom name="g" size=".1" friction="{0}" condim="{1}" mass="1"/></body>'
)


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("condim", [1, 3, 4, 6])
@pytest.mark.parametrize("friction", ["0", "0 0 0", "-1"])
def test_its_steps_are_mujocos(friction: str, condim: int, cone: str, load: Load) -> None:
    scene, model = load(BALL.format(friction, condim), f'<option cone="{cone}"/>')
    assert worst_step(scene, model) < 1e-3


def test_explicit_pairs_have_it_too(load: Load) -> None:
    pair = '<contact><pair geom1="f" geom2="g" condim="4" friction="0 0 .01 0 0"/></contact>'
    scene, model = load(BALL.format("1", 3), pair)
    assert worst_step(scene, model) < 1e-3


@pytest.mark.parametrize(
    ("law", "condim", "friction"),
    [("mujoco", 1, 0.0), ("mujoco", 3, 1e-5), ("rigid", 3, 0.0), ("rigid", 4, 1e-5), ("spring-damper", 3, 0.0)],
)
def test_it_stays_0_where_that_is_exact(law: str, condim: int, friction: float, load: Load) -> None:
    scene, _ = load(BALL.format("0", condim), contact_law=law)
    assert scene.core.P[scene.layout.contact(0, "friction")] == friction


@pytest.mark.parametrize("condim", [3, 6])
def test_exact_sliding_is_solved_too(condim: int, load: Load) -> None:
    """Coulomb's law at its usual settings: what slides goes on; condim 6 slows what turns about the normal."""
    scene, _ = load(BALL.format("0", condim))
    v = np.array([[1.0, 0.5, 0.0, 0.0, 0.0, 2.0]])
    found = ComplementarityModel(scene).predict(scene.q0[None], v, np.zeros((1, 0)), jacobian=True)
    assert found.status[0] != SolverStatus.FAILED
    assert np.isfinite(found.jacobian).all()
    np.testing.assert_allclose(found.v_next[0, :2], v[0, :2], rtol=1e-3)
    assert (found.v_next[0, 5] < v[0, 5]) == (condim == 6)
