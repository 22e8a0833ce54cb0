"""Wild states: solved to 1e-8 or flagged, never wrong in silence, never NaN."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from cmbrl.bench.states import G1, NO_G1
from cmbrl.bench.studies.robustness.cells import SMOOTHINGS, TOLERANCE, measure, wild_batch
from cmbrl.contact import Barrier, Exact
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

from ..scene.conftest import GYMNASIUM
from .test_derivatives import CUBE

FILES = {
    "hopper": next(file for file in GYMNASIUM if file.stem == "hopper"),
    "cheetah": next(file for file in GYMNASIUM if file.stem == "half_cheetah"),
    "cube": CUBE,
    "g1": G1,
}


def check(sizes: dict[str, int], share: float, laws: tuple[str, ...]) -> None:
    for name, count in sizes.items():
        if not FILES[name].exists():
            continue
        for law, smoothing in product(laws, SMOOTHINGS.values()):
            model = ComplementarityModel(Scene.from_mjcf(FILES[name], contact_law=law), smoothing=smoothing)
            row = measure(model, count, 0)
            assert row["states"] == count, (name, law, row)
            assert row["nan"] == row["silent"] == 0, (name, law, row)
            assert row["flagged"] <= share * count, (name, law, row)
            assert row["solved"] + row["flagged"] == count, (name, law, row)
            assert row["worst_residual"] <= TOLERANCE, (name, law, row)


def test_soft_contact() -> None:
    check({"hopper": 3000, "cheetah": 3000, "cube": 3000, "g1": 200}, 1e-3, ("mujoco",))


def test_logistic_contact() -> None:
    check({"hopper": 3000, "cheetah": 3000, "cube": 3000, "g1": 200}, 1e-3, ("logistic:stiffness=50", "logistic"))


def test_rigid_contact() -> None:
    """Rigid contact with friction to 10 has states with several solutions or folded paths: few, and flagged."""
    check({"hopper": 3000, "cheetah": 3000, "cube": 3000}, 1e-3, ("rigid",))
    check({"g1": 200}, 1e-2, ("rigid",))


@pytest.mark.skipif(not G1.exists(), reason=NO_G1)
def test_a_derivative_softer_than_asked_for_is_flagged() -> None:
    """Simulated soft, differentiated hard: where the hard solve had to be softened, so has the step's derivative."""
    scene = Scene.from_mjcf(G1, contact_law="rigid")
    q, v, u, theta = wild_batch(scene, 1500, np.random.default_rng(1))
    hard = ComplementarityModel(scene, smoothing=Exact())
    softened = hard.predict(q, v, u, theta).status == SolverStatus.FALLBACK
    assert softened.any()
    q, v, u, theta = (x[softened] for x in (q, v, u, theta))
    mixed = hard.with_settings(smoothing=Barrier(1e-2))
    assert (mixed.predict(q, v, u, theta).status == SolverStatus.CONVERGED).all()
    differentiated = mixed.with_settings(backward_smoothing=Exact()).predict(q, v, u, theta, jacobian=True)
    assert (
        differentiated.status == SolverStatus.FALLBACK
    ).mean() > 0.5  # the hard solve starts elsewhere, and may be luckier


def test_nan_in_the_state_is_flagged() -> None:
    model = ComplementarityModel(Scene.from_mjcf(CUBE), smoothing=Barrier(1e-4))
    q, v, u, theta = wild_batch(model.scene, 8, np.random.default_rng(0))
    v[3, 2] = np.nan
    r = model.predict(q, v, u, theta)
    assert r.status[3] == SolverStatus.FAILED
    assert np.isfinite(np.delete(r.v_next, 3, axis=0)).all()


@pytest.mark.slow
def test_a_million_soft_states() -> None:
    check({"hopper": 1_000_000, "cheetah": 1_000_000, "cube": 1_000_000, "g1": 100_000}, 1e-4, ("mujoco",))


@pytest.mark.slow
def test_a_million_rigid_states() -> None:
    check({"hopper": 1_000_000, "cheetah": 1_000_000, "cube": 1_000_000}, 1e-4, ("rigid",))
