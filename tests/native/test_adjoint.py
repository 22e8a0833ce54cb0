"""Vector-Jacobian products are products with the transposed Jacobian, whatever is differentiated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.states import random_states
from cmbrl.bench.studies.derivatives.differences import RANGES
from cmbrl.contact import Barrier, Gaussian
from cmbrl.contact.smoothing import Smoothing
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.step_settings import INTEGRATORS
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

CUBE = Path(__file__).parents[2] / "tasks/cube_toss/scene.xml"


def mismatch_at(
    model: ComplementarityModel, q: np.ndarray, v: np.ndarray, u: np.ndarray, rng: np.random.Generator
) -> float:
    """Largest relative difference of the two at states q (B, nq), v (B, nv), u (B, nu) under random cotangents."""
    r = model.predict(q, v, u, jacobian=True, parameter_jacobian=True)
    assert r.jacobian is not None
    tape = model.stepper.forward(q, v, u, model.parameters, tape=True)["tape"]
    g = rng.normal(size=(len(q), 2 * model.scene.nv))
    gq, gv = (np.ascontiguousarray(part) for part in np.split(g, 2, axis=1))
    back = model.stepper.backward(u, model.parameters, tape, gq, gv, want_theta=True)
    ours = np.concatenate([back[name] for name in ("gq", "gv", "gu", "gtheta")], axis=1)
    expected = np.einsum("br,brc->bc", g, r.jacobian)
    solved = r.status == SolverStatus.CONVERGED
    assert solved.mean() > 0.9
    error = np.linalg.norm(ours - expected, axis=1) / np.linalg.norm(expected, axis=1)
    return float(error[solved].max())


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("backward", [Barrier(1e-2), Gaussian(0.01, floor=1e-5)], ids=["kappa", "gaussian"])
@pytest.mark.parametrize(("law", "restitution"), [("mujoco", 0.0), ("rigid", 0.0), ("rigid", 0.5)])
def test_simulate_hard_differentiate_soft(law: str, restitution: float, backward: Smoothing, integrator: str) -> None:
    """Of a free body whose displacement, velocity and late impacts differ from those that are differentiated."""
    scene = Scene.from_mjcf(CUBE, contact_law=law)
    theta = scene.parameter_vector()
    theta[[p.group == "restitution" for p in scene.parameters]] = restitution
    model = ComplementarityModel(
        scene, 3, smoothing=Barrier(1e-6), backward_smoothing=backward, integrator=integrator, parameters=theta
    )
    rng = np.random.default_rng(0)
    assert mismatch_at(model, *random_states(scene, 40, rng, RANGES), rng) < 1e-10
