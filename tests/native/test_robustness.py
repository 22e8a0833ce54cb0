"""Wild states: solved to 1e-8 or flagged, never wrong in silence, never NaN."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.bench import robustness
from cmbrl.contact import Barrier
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

from ..scene.conftest import G1, GYMNASIUM
from .test_derivatives import CUBE

FILES = {
    "hopper": next(file for file in GYMNASIUM if file.stem == "hopper"),
    "cheetah": next(file for file in GYMNASIUM if file.stem == "half_cheetah"),
    "cube": CUBE,
    "g1": G1,
}


def check(sizes: dict[str, int], share: float, laws: tuple[str, ...]) -> None:
    files = {name: file for name, file in FILES.items() if file.exists()}
    result = robustness.run(sizes, laws=laws, threads=1, files=files)
    table = robustness.table(result).text()
    for row in result["rows"]:
        assert row["nan"] == row["silent"] == 0, table
        assert row["flagged"] <= share * row["states"], table
        assert row["solved"] + row["flagged"] == row["states"], table
        assert row["worst_residual"] <= robustness.TOLERANCE, table


def test_soft_contact() -> None:
    check({"hopper": 3000, "cheetah": 3000, "cube": 3000, "g1": 200}, 1e-3, ("mujoco",))


def test_rigid_contact() -> None:
    """Rigid contact with friction to 10 has states with several solutions or folded paths: few, and flagged."""
    check({"hopper": 3000, "cheetah": 3000, "cube": 3000}, 5e-3, ("rigid",))
    check({"g1": 200}, 3e-2, ("rigid",))


def test_nan_in_the_state_is_flagged() -> None:
    model = ComplementarityModel(Scene.from_mjcf(CUBE), smoothing=Barrier(1e-4))
    q, v, u, theta = robustness.wild_batch(model.scene, 8, np.random.default_rng(0))
    v[3, 2] = np.nan
    r = model.predict(q, v, u, theta)
    assert r.status[3] == 2
    assert np.isfinite(np.delete(r.v_next, 3, axis=0)).all()


@pytest.mark.slow
def test_a_million_soft_states() -> None:
    check({"hopper": 1_000_000, "cheetah": 1_000_000, "cube": 1_000_000, "g1": 100_000}, 1e-4, ("mujoco",))
