"""Loops whose joints turn round, by any number of turns, behind the encoder of a crank alone."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.data.loop_gaps import gaps
from cmbrl.data.loops import closed, closing
from cmbrl.errors import UserError
from cmbrl.scene import Scene

TURN = 2.0 * np.pi


def four_bar(crank: float, ground: float) -> Scene:
    """Of a crank upright at the origin, and a rocker at ``ground`` [m] that ends at (.15, .25)."""
    return Scene.from_mjcf(
        f"""<mujoco><worldbody><body name="crank"><joint name="crank" axis="0 1 0"/>
<geom type="capsule" size=".01" fromto="0 0 0 0 0 {crank}" mass=".1"/>
<body name="rod" pos="0 0 {crank}"><joint name="rod" axis="0 1 0"/>
<geom type="capsule" size=".01" fromto="0 0 0 .2 0 .05" mass=".1"/></body></body>
<body name="rocker" pos="{ground} 0 0"><joint name="rocker" axis="0 1 0"/>
<geom type="capsule" size=".01" fromto="0 0 0 {0.2 - ground} 0 {crank + 0.05}" mass=".1"/></body></worldbody>
<equality><connect body1="rod" body2="rocker" anchor=".2 0 .05"/></equality></mujoco>"""
    )


CRANK_ROCKER, DRAG_LINK = four_bar(0.08, 0.25), four_bar(0.2, 0.05)


def rows_of(scene: Scene, crank: np.ndarray) -> np.ndarray:
    q = np.zeros((len(crank), scene.nq))
    q[:, 0] = crank
    assert closing(scene, [0]) == [1, 2]
    return closed(scene, q, [1, 2])


@pytest.mark.parametrize("scene", [CRANK_ROCKER, DRAG_LINK])
@pytest.mark.parametrize(("turns", "rows"), [(4.0, 13), (13.0, 1500)])  # a third of a turn between rows, or little
def test_a_crank_may_turn_by_any_number_of_turns(scene: Scene, turns: float, rows: int) -> None:
    """The rod turns against the crank whose rocker swings; of a drag link, the rocker turns with the crank."""
    crank = np.linspace(0.0, -turns * TURN, rows)
    found = rows_of(scene, crank)
    assert np.abs(gaps(scene, found)).max() < 1e-8
    np.testing.assert_array_equal(found[:, 0], crank)
    turning, swinging, way = (1, 2, 1.0) if scene is CRANK_ROCKER else (2, 1, -1.0)
    assert found[-1, turning] - found[0, turning] == pytest.approx(way * turns * TURN, abs=1e-7)
    assert np.ptp(found[:, swinging]) < 2.0
    if rows > 1000:
        assert np.abs(np.diff(found, axis=0)).max() < 0.2


def test_turns_come_back_with_the_crank_and_no_matter_where_the_encoder_began() -> None:
    crank = 5.0 * TURN * np.sin(np.linspace(0.0, TURN, 1200))
    found = rows_of(CRANK_ROCKER, crank)
    np.testing.assert_allclose(found[-1], found[0], atol=1e-7)
    later = rows_of(CRANK_ROCKER, crank + 300.0 * TURN)
    np.testing.assert_allclose(later[:, 1:], found[:, 1:], atol=1e-7)


def test_rows_that_no_pose_closes_are_passed_over() -> None:
    told = rows_of(CRANK_ROCKER, np.linspace(0.0, 6.0 * TURN, 1500))
    wrong = np.arange(700, 712)
    rows = told * [1.0, 0.0, 1.0]  # the rocker is logged too
    rows[wrong, 2] += 0.3
    found = closed(CRANK_ROCKER, rows, [1])
    right = np.setdiff1d(np.arange(1500), wrong)
    np.testing.assert_allclose(found[right], told[right], atol=1e-7)
    assert np.abs(gaps(CRANK_ROCKER, found[wrong])).max() > 0.01


def test_a_joint_that_cannot_turn_round_is_refused() -> None:
    rows = np.zeros((300, 3))
    rows[:, 1] = np.linspace(0.0, 3.0 * TURN, 300)
    with pytest.raises(UserError, match=r"leave loops of scene .* open .* or log 'crank', 'rocker' too"):
        closed(DRAG_LINK, rows, [0, 2])
