"""Wild states: solved to 1e-8 or flagged, never wrong in silence, never NaN."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from cmbrl.bench.states import bench_scene
from cmbrl.bench.studies.robustness.cells import SMOOTHINGS, TOLERANCE, measure, wild_batch
from cmbrl.contact import Barrier, Exact
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus

pytest.importorskip("gymnasium", reason="the MJCFs of hopper and cheetah are Gymnasium's")


def check(sizes: dict[str, int], share: float, laws: tuple[str, ...]) -> None:
    for name, count in sizes.items():
        for law, smoothing in product(laws, SMOOTHINGS.values()):
            model = ComplementarityModel(bench_scene(name, law), smoothing=smoothing)
            row = measure(model, count, 0)
            assert row["states"] == count, (name, law, row)
            assert row["nan"] == row["silent"] == 0, (name, law, row)
            assert row["flagged"] <= share * count, (name, law, row)
            assert row["solved"] + row["flagged"] == count, (name, law, row)
            assert row["worst_residual"] <= TOLERANCE, (name, law, row)


def test_soft_contact() -> None:
    check({"hopper": 3000, "cheetah": 3000, "cube_toss": 3000, "g1": 200}, 1e-3, ("mujoco",))


def test_logistic_contact() -> None:
    check({"hopper": 3000, "cheetah": 3000, "cube_toss": 3000, "g1": 200}, 1e-3, ("logistic:stiffness=50", "logistic"))


def test_rigid_contact() -> None:
    """Rigid contact with friction to 10 has states with several solutions or folded paths: few, and flagged."""
    check({"hopper": 3000, "cheetah": 3000, "cube_toss": 3000}, 1e-3, ("rigid",))
    check({"g1": 200}, 1e-2, ("rigid",))


def test_a_derivative_softer_than_asked_for_is_flagged() -> None:
    """Simulated soft, differentiated hard: where the hard solve had to be softened, so has the step's derivative."""
    scene = bench_scene("hopper", "rigid")
    q, v, u, theta = wild_batch(scene, 1500, np.random.default_rng(1))
    hard = ComplementarityModel(scene, smoothing=Exact())
    softened = hard.predict(q, v, u, theta).status == SolverStatus.FALLBACK
    assert softened.sum() > 10
    q, v, u, theta = (x[softened] for x in (q, v, u, theta))
    mixed = hard.with_settings(smoothing=Barrier(1e-2))
    assert (mixed.predict(q, v, u, theta).status == SolverStatus.CONVERGED).all()
    differentiated = mixed.with_settings(backward_smoothing=Exact()).predict(q, v, u, theta, jacobian=True)
    flagged = differentiated.status == SolverStatus.FALLBACK
    assert flagged.mean() > 0.9  # the hard solve starts elsewhere, and may be luckier


def test_nan_in_the_state_is_flagged() -> None:
    model = ComplementarityModel(bench_scene("cube_toss"), smoothing=Barrier(1e-4))
    q, v, u, theta = wild_batch(model.scene, 8, np.random.default_rng(0))
    v[3, 2] = np.nan
    r = model.predict(q, v, u, theta)
    assert r.status[3] == SolverStatus.FAILED
    assert np.isfinite(np.delete(r.v_next, 3, axis=0)).all()


@pytest.mark.slow
def test_a_million_soft_states() -> None:
    check({"hopper": 1_000_000, "cheetah": 1_000_000, "cube_toss": 1_000_000, "g1": 100_000}, 1e-4, ("mujoco",))


@pytest.mark.slow
def test_a_million_rigid_states() -> None:
    check({"hopper": 1_000_000, "cheetah": 1_000_000, "cube_toss": 1_000_000}, 1e-4, ("rigid",))
