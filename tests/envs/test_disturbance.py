"""Parameters of an episode's own: what varies, by which factors, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import cmbrl
from cmbrl.envs.disturbance import parameter_sets
from cmbrl.errors import UserError

BOXES = """<mujoco><worldbody><geom name="floor" type="plane" size="9 9 1"/>
<body name="a" pos="0 0 1"><freejoint/><geom name="g" type="box" size=".1 .1 .1" mass="2"/></body>
<body name="b" pos="1 0 1"><freejoint/><geom name="h" type="box" size=".1 .1 .1" mass="3"/></body>
</worldbody></mujoco>"""


@pytest.fixture
def boxes() -> cmbrl.ComplementarityModel:
    return cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(BOXES))


def ratios(model: cmbrl.ComplementarityModel, sets: np.ndarray, name: str) -> np.ndarray:
    found = [k for k, p in enumerate(model.scene.parameters) if name in (p.name, p.group)]
    return sets[:, found] / model.parameters[found]


def test_a_name_or_a_group_has_one_factor_an_episode(boxes: cmbrl.ComplementarityModel) -> None:
    sets = parameter_sets(boxes, 0.0, 400, factors="mass.a:0.9:1.2, softness_time:0.01:1")
    assert sets is not None
    mass, time = ratios(boxes, sets, "mass.a"), ratios(boxes, sets, "softness_time")
    assert 0.9 <= mass.min() < 0.92
    assert 1.18 < mass.max() <= 1.2
    np.testing.assert_array_equal(ratios(boxes, sets, "mass.b"), 1.0)
    np.testing.assert_allclose(time, time[:, :1].repeat(time.shape[1], axis=1))  # all contacts alike
    assert np.median(time) == pytest.approx(0.1, rel=0.3)  # even in the logarithm
    others = [p.group not in ("mass", "softness_time") for p in boxes.scene.parameters]
    np.testing.assert_array_equal(sets[:, others], np.tile(boxes.parameters[others], (400, 1)))


def test_they_come_on_top_of_draws_and_spread_and_keep_to_bounds(boxes: cmbrl.ComplementarityModel) -> None:
    draws = np.tile(boxes.parameters, (2, 1))
    draws[1, [p.name == "mass.b" for p in boxes.scene.parameters]] *= 1.1
    drawn = cmbrl.ComplementarityModel(boxes.scene, candidates=draws)
    sets = parameter_sets(drawn, 0.0, 50, factors="mass.b:2:2")
    assert sets is not None
    found = ratios(boxes, sets, "mass.b").ravel()
    assert set(np.round(found, 9)) == {2.0, 2.2}
    far = parameter_sets(boxes, 0.0, 50, factors="friction:1e9:1e9")
    assert far is not None
    high = [p.high for p in boxes.scene.parameters if p.group == "friction"]
    np.testing.assert_allclose(ratios(boxes, far, "friction")[0] * _own(boxes), high)


def _own(model: cmbrl.ComplementarityModel) -> np.ndarray:
    return np.array([x for p, x in zip(model.scene.parameters, model.parameters, strict=True) if p.group == "friction"])


def test_nothing_to_vary(boxes: cmbrl.ComplementarityModel) -> None:
    assert parameter_sets(boxes, 0.0) is None


@pytest.mark.parametrize(
    ("factors", "message"),
    [
        ("masses:0.9:1.1", r"no parameter or group 'masses'.*did you mean"),
        ("mass:0.9", "give NAME:LEAST:MOST"),
        ("mass:0.9:a", "give NAME:LEAST:MOST"),
        ("mass:1.1:0.9", "the least one first"),
        ("mass:0:1", "must be positive and finite"),
        ("mass:nan:1", "must be positive and finite"),
        ("com_x:0.9:1.1", "is 0, which no factor changes"),
    ],
)
def test_factors_that_say_nothing_are_refused(boxes: cmbrl.ComplementarityModel, factors: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        parameter_sets(boxes, 0.0, factors=factors)


def test_a_learned_model_has_nothing_to_vary() -> None:
    class Learned:
        name, dt = "learned", 0.02

    with pytest.raises(UserError, match="learned has no parameters of a robot"):
        parameter_sets(Learned(), 0.0, factors="mass:0.9:1.1")  # type: ignore[arg-type]
