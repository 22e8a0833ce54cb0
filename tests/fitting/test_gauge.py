"""The unit of force that motion does not tell: parameters that the file does not have say nothing of it."""

from __future__ import annotations

import numpy as np

from cmbrl.fitting.search.gauge import distance, nearest
from cmbrl.fitting.search.space import Space
from cmbrl.scene.records import Parameter


def _space() -> Space:
    scales = [Parameter(f"mass.{k}", "mass", 1.0, 0.2, 5.0, "log", "1") for k in range(3)]
    new = [Parameter(f"armature.{k}", "armature", 0.0, 0.0, 1.0, "linear", "kg m^2") for k in range(6)]
    gain = Parameter("kp.a", "kp", 100.0, 20.0, 500.0, "log", "1")
    return Space.of((*scales, *new, gain), np.array([1.0] * 3 + [0.0] * 6 + [100.0]))


def test_what_the_file_does_not_have_does_not_pull_the_unit_down() -> None:
    """Rotors on six joints: with a unit half as large they were half as far from the file's zero."""
    space = _space()
    z = space.z(np.array([1.0] * 3 + [0.3] * 6 + [100.0]))
    members = [list(range(len(space)))]
    np.testing.assert_allclose(space.theta(nearest(space, z, members)), space.theta(z), rtol=1e-3)
    assert distance(space, z) == 0.0


def test_a_unit_that_is_off_goes_back_with_all_that_scales_by_it() -> None:
    space = _space()
    theta = np.array([0.5, 0.4, 0.6] + [0.15] * 6 + [50.0])
    found = space.theta(nearest(space, space.z(theta), [list(range(len(space)))]))
    np.testing.assert_allclose(found / theta, found[0] / theta[0])
    np.testing.assert_allclose(found[0] / theta[0], 2.0, rtol=0.05)
