"""Tangents along windows of a log equal the product of the steps' own Jacobians."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cmbrl.bench.states import random_states
from cmbrl.contact import Barrier
from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.log_windows import Predicted
from cmbrl.models.windows import Scales, Windows
from cmbrl.scene import Scene

from ..models.windows_by_steps import along_by_steps
from .test_batches import CALM, CUBE, HOPPER

STARTS = np.array([0, 3, 4, 10, 11, 12, 20, 31, 33, 50, 61])  # no multiple of any pack
ARMS = """<mujoco><option timestep=".01" integrator="implicitfast"/><worldbody><geom type="plane" size="3 3 .1"/>
<body pos="0 0 .6"><joint name="left" axis="0 1 0" damping=".3" range="-40 40"/><geom type="capsule" size=".04"
fromto="0 0 0 .4 0 0"/><body pos=".4 0 0"><joint name="ball" type="ball" damping=".2"/><geom size=".1"/></body></body>
<body pos="0 1 .3"><joint name="right" axis="0 0 1" damping=".3" frictionloss=".1"/><geom type="box" size=".2 .1 .1"/>
</body></worldbody><actuator><position joint="left" kp="30" kv="2"/><general joint="right" dyntype="filter"
dynprm=".05" gainprm="8"/></actuator></mujoco>"""
HARD = {"smoothing": Barrier(1e-4)}
CASES: dict[str, tuple[Any, dict[str, Any]]] = {
    "hopper, leapfrog": (HOPPER, {**HARD, "substeps": 2}),
    "hopper, MuJoCo's": (HOPPER, {"integrator": "rk4", "sliding": "convex", "look_ahead": False}),
    "hopper, midpoint": (HOPPER, {**HARD, "integrator": "midpoint"}),
    "cube": (CUBE, {**HARD, "substeps": 3}),
    "arms": (ARMS, {**HARD, "substeps": 2}),
    "arms, MuJoCo's": (ARMS, {"sliding": "convex", "look_ahead": False}),
}


@pytest.fixture(params=CASES)
def model(request: pytest.FixtureRequest) -> ComplementarityModel:
    source, settings = CASES[request.param]
    return ComplementarityModel(Scene.from_mjcf(source), **settings)


def windows_of(model: ComplementarityModel, horizon: int = 4) -> Windows:
    """With starts off the logged states."""
    rng, nv = np.random.default_rng(3), model.scene.nv
    q, v, u = random_states(model.scene, 70, rng, CALM)
    u = np.hstack([u, rng.normal(size=(70, model.scene.inputs - u.shape[1]))])
    log = Transitions(
        q=q, v=v, u=u, q_next=np.roll(q, 1, 0), v_next=np.roll(v, 1, 0), dt=model.dt, episode=np.zeros(70)
    )
    scales = Scales(np.full(nv, 0.5), np.full(nv, 2.0), 0.5, noise=np.full(2 * nv, 0.01))
    offset = 0.02 * rng.standard_normal((len(STARTS), 2 * nv))
    return replace(Windows(log, STARTS, horizon, scales), offset=offset)


def wanted_of(model: ComplementarityModel, windows: Windows, own: int = 5) -> tuple[np.ndarray, ...]:
    """Parameters in any order, columns of one's own, of which three move controls, some of the rows, and units."""
    rng, states = np.random.default_rng(4), 2 * model.scene.nv
    columns = rng.permutation(len(model.parameters))[: len(model.parameters) * 3 // 4]
    driven = rng.normal(size=(*windows.data.u.shape, min(3, own)))
    rows, units = rng.permutation(states)[: states - 1], rng.uniform(1.0, 2.0, (len(STARTS), states - 1))
    return columns, rng.normal(size=(states, own)), driven, rows, units


def assert_alike(found: Predicted, wanted: Predicted) -> None:
    np.testing.assert_allclose(found.q, wanted.q, atol=1e-6)
    np.testing.assert_allclose(found.v, wanted.v, atol=1e-6)
    np.testing.assert_array_equal(found.told, wanted.told)
    size = np.maximum(np.abs(wanted.tangents).max(axis=(2, 3), keepdims=True), 1e-9)
    np.testing.assert_allclose(found.tangents / size, wanted.tangents / size, atol=1e-4)


@pytest.mark.parametrize("own", [5, 60])
def test_tangents_are_the_product_of_the_jacobians(model: ComplementarityModel, own: int) -> None:
    windows = windows_of(model)
    wanted = wanted_of(model, windows, own)
    assert_alike(
        model.along(windows, model.parameters, *wanted), along_by_steps(model, windows, model.parameters, *wanted)
    )


def test_results_do_not_depend_on_threads(model: ComplementarityModel) -> None:
    windows, several = windows_of(model), model.with_settings(threads=3)
    wanted = wanted_of(model, windows)
    one, other = (m.along(windows, m.parameters, *wanted) for m in (model, several))
    np.testing.assert_array_equal(one.v, other.v)
    np.testing.assert_array_equal(one.tangents, other.tangents)


def test_a_window_is_lost_by_itself(model: ComplementarityModel) -> None:
    """Whose controls, or its start, are not finite at some step; those beside it are as they were."""
    windows, step = windows_of(model), 2 if model.scene.inputs else 0
    assert windows.offset is not None
    wanted = wanted_of(model, windows)
    before = model.along(windows, model.parameters, *wanted)
    if step:
        windows.data.u[STARTS[-1] + step] = np.nan
    else:
        windows.offset[-1] = np.nan
    after = model.along(windows, model.parameters, *wanted)
    others = np.arange(len(STARTS)) < len(STARTS) - 1
    np.testing.assert_allclose(after.v[others], before.v[others], atol=1e-6)
    assert np.isfinite(after.tangents[others]).all()
    assert np.isfinite(after.v[-1, :step]).all()
    assert np.isnan(after.v[-1, step:]).all()
    assert np.isnan(after.tangents[-1, :5, step:]).all()


BAD = {
    "another horizon": ({"horizon": 90}, "leaves the log"),
    "a parameter twice": ({"columns": np.array([1, 1])}, "give each number once"),
    "a row too many": ({"rows": np.array([99]), "units": np.ones((1, 1))}, "row 99 of 12"),
    "controls without a start": ({"begun": np.zeros((12, 2))}, "more columns move controls than there are"),
    "units of other rows": ({"units": np.ones((1, 3))}, "array 'units' has the shape"),
    "starts of another robot": ({"begun": np.zeros((11, 5))}, "array 'begun' has the shape"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_does_not_fit_is_refused(case: str) -> None:
    change, message = BAD[case]
    model = ComplementarityModel(Scene.from_mjcf(HOPPER))
    windows = windows_of(model)
    columns, begun, driven, rows, units = wanted_of(model, windows)
    given = {"columns": columns, "begun": begun, "driven": driven, "rows": rows, "units": units, "horizon": 4} | change
    q, v = windows.begin(model.scene)
    with pytest.raises(UserError, match=message):
        model.stepper.core.windows(
            q, v, windows.data.u, STARTS, given["horizon"], model.parameters, given["columns"], given["begun"],
            given["driven"], given["rows"], given["units"], model.stepper.options,
        )  # fmt: skip
