"""Saved parameters come back by name, also those of a version that knew fewer laws."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.errors import UserError
from cmbrl.models.theta import by_name, from_names
from cmbrl.scene import Scene

from ..native.test_batches import HOPPER


def test_only_laws_on_request_may_be_missing() -> None:
    scene = Scene.from_mjcf(HOPPER)
    values = by_name(scene, scene.parameter_vector())
    older = {name: value for name, value in values.items() if not name.startswith("gravity_tilt.")}
    assert len(older) < len(values)
    np.testing.assert_array_equal(from_names(scene, older), scene.parameter_vector())
    with pytest.raises(UserError, match=r"no value for the parameter 'mass\.torso'"):
        from_names(scene, {name: value for name, value in values.items() if name != "mass.torso"})
