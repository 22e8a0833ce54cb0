"""Units of the errors that users see: deviations of what moves, and none of what a solver's tolerance moves."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.data.trajectories import read_trajectories
from cmbrl.models.deviations import deviations
from cmbrl.scene import Scene

_TWO_SLIDES = """<mujoco><worldbody><body><joint name="x" type="slide"/><geom size=".1"/>
<body><joint name="y" type="slide" axis="0 1 0"/><geom size=".1"/></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize(("size", "moves"), [(1e-9, False), (1e-3, True)])
def test_what_a_tolerance_moves_has_no_unit(size: float, moves: bool) -> None:
    """A motion of a billionth of the other's is none: its error in its own unit would be that of rounding."""
    time = 0.01 * np.arange(300)
    q = np.column_stack([np.sin(time), size * np.sin(3 * time)])
    v = np.column_stack([np.cos(time), 3 * size * np.cos(3 * time)])
    log = read_trajectories(q, [300], dt=0.01, v=v)
    scene = Scene.from_mjcf(_TWO_SLIDES)
    for found, motion in zip(deviations(log, scene), ("change", "state"), strict=True):
        assert np.isfinite(found).tolist() == [True, moves, True, moves], motion
    change, state = deviations(log, scene)
    assert change[0] == pytest.approx(np.diff(q[:, 0]).std(), rel=1e-2)
    assert state[2] == pytest.approx(v[:, 0].std(), rel=1e-2)
