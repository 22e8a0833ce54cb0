"""Numbers that are not finite, parameters without a meaning and settings out of range never step in silence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl import UserError
from cmbrl.bench.states import Ranges, random_states
from cmbrl.contact import Barrier
from cmbrl.data.transitions import Transitions
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.native_step.result import SolverWarning
from cmbrl.models.windows import Scales, Windows
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

from ..scene.conftest import GYMNASIUM

HOPPER = next(file for file in GYMNASIUM if file.stem == "hopper")
CUBE = Path(__file__).parents[2] / "tasks/cube_toss/scene.xml"
BAD = pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])


@pytest.fixture
def model() -> ComplementarityModel:
    return ComplementarityModel(Scene.from_mjcf(HOPPER), substeps=2, smoothing=Barrier(1e-4))


@BAD
@pytest.mark.parametrize("which", ["q", "v", "u"])
@pytest.mark.parametrize("row", [0, 4, 10])  # in a pack with others, and in the last one, which repeats its last row
def test_a_row_that_is_not_finite_fails_alone(model: ComplementarityModel, which: str, row: int, bad: float) -> None:
    states = dict(zip("qvu", random_states(model.scene, 11, np.random.default_rng(0), Ranges()), strict=True))
    clean = model.predict(**states, parameter_jacobian=True, impulse=True)
    states[which][row, 0] = bad
    spoilt = model.predict(**states, parameter_jacobian=True, impulse=True)
    assert spoilt.status[row] == SolverStatus.FAILED
    for name in ("q_next", "v_next", "residual", "jacobian", "impulse"):
        ours, theirs = getattr(spoilt, name), getattr(clean, name)
        assert np.isnan(ours[row]).all(), name
        np.testing.assert_array_equal(np.delete(ours, row, 0), np.delete(theirs, row, 0), err_msg=name)


@BAD
def test_the_gradient_of_such_a_row_is_nan_and_of_no_other(model: ComplementarityModel, bad: float) -> None:
    states = random_states(model.scene, 6, np.random.default_rng(0), Ranges())
    theta = np.tile(model.parameters, (6, 1))

    def gradients() -> list[np.ndarray]:
        inputs = [torch.tensor(x, requires_grad=True) for x in (*states, theta)]
        q, v = model.step(*inputs)
        (q.sum() + v.sum()).backward()
        return [x.grad.numpy() for x in inputs]

    clean = gradients()
    states[2][3, 0] = bad
    with pytest.warns(SolverWarning, match="1 of 6 .* not finite"):
        spoilt = gradients()
    for ours, theirs in zip(spoilt, clean, strict=True):
        assert np.isnan(ours[3]).all()
        np.testing.assert_array_equal(np.delete(ours, 3, 0), np.delete(theirs, 3, 0))


@pytest.mark.parametrize("file", [HOPPER, CUBE], ids=["hopper", "cube"])
def test_a_batch_without_any_finite_row(file: Path) -> None:
    model = ComplementarityModel(Scene.from_mjcf(file))
    q, v, u = random_states(model.scene, 3, np.random.default_rng(0), Ranges())
    assert (model.predict(np.full_like(q, np.nan), v, u, jacobian=True).status == SolverStatus.FAILED).all()


def windows(model: ComplementarityModel, starts: list[int], **changes: np.ndarray) -> Windows:
    q, v, u = random_states(model.scene, 40, np.random.default_rng(0), Ranges())
    r = model.predict(q, v, u)
    log = Transitions(q=q, v=v, u=u, q_next=r.q_next, v_next=r.v_next, dt=model.dt, episode=np.zeros(40))
    for name, value in changes.items():
        object.__setattr__(log, name, value)
    nv = model.scene.nv
    return Windows(log, np.array(starts), 1, Scales(np.ones(nv), np.ones(nv), 1.0))


@BAD
def test_the_loss_of_a_control_that_is_not_finite_is_the_worst(model: ComplementarityModel, bad: float) -> None:
    u = np.zeros((40, model.scene.nu))
    u[7, 0] = bad
    theta = model.parameters[None]
    assert model.candidate_losses(theta, windows(model, [8, 9], u=u)).mean() < 1e6
    assert model.candidate_losses(theta, windows(model, [7, 9], u=u)).mean() > 1e14


@pytest.mark.parametrize("start", [-1, 40, 2**63 - 1])
def test_a_window_outside_the_log_is_refused(model: ComplementarityModel, start: int) -> None:
    with pytest.raises(UserError, match=f"start {start} .* leaves the log of 40 rows"):
        model.candidate_losses(model.parameters[None], windows(model, [start]))


@pytest.mark.parametrize("value", [np.nan, -1.0, np.inf])
@pytest.mark.parametrize("group", ["friction", "mass", "radius", "impedance_low", "armature"])
def test_a_parameter_without_a_meaning_is_named(model: ComplementarityModel, group: str, value: float) -> None:
    names = [p.name for p in model.scene.parameters]
    k = next(k for k, p in enumerate(model.scene.parameters) if p.group == group)
    if value == np.inf and model.scene.parameters[k].transform == "log":
        value = -np.inf
    q, v, u = random_states(model.scene, 3, np.random.default_rng(0), Ranges())
    theta = model.parameters.copy()
    theta[k] = value
    rows = np.tile(model.parameters, (3, 1))
    rows[2, k] = value
    for call in (
        lambda: model.predict(q, v, u, theta),
        lambda: model.step(*(torch.from_numpy(x) for x in (q, v, u, theta))),
        lambda: model.smooth_dynamics(q, v, theta),
        lambda: model.contact_problems(q, v, u, theta),
    ):
        with pytest.raises(UserError, match=rf"^parameter {names[k]} = \S+; .*\[.*\]$"):
            call()
    for call in (lambda: model.predict(q, v, u, rows), lambda: model.candidate_losses(rows, windows(model, [0]))):
        with pytest.raises(UserError, match=rf"^parameter {names[k]} = \S+ in row 2; .*\[.*\]$"):
            call()


@pytest.mark.parametrize(
    ("setting", "value"),
    [("substeps", 2**31), ("substeps", 1.9), ("threads", 0), ("threads", 2**31), ("prune", -1.0), ("prune", -np.inf)]
    + [(name, np.nan) for name in ("substeps", "time_step", "prune", "path_tolerance")],
)
def test_a_setting_out_of_range_is_named(model: ComplementarityModel, setting: str, value: float) -> None:
    with pytest.raises(UserError, match=f"^{setting} = {value}: give"):
        model.with_settings(**{setting: value})


def test_a_native_setting_out_of_range_is_named(model: ComplementarityModel) -> None:
    model.stepper.options["max_iterations"] = 2**31
    q, v, u = random_states(model.scene, 1, np.random.default_rng(0), Ranges())
    with pytest.raises(UserError, match=r"^setting 'max_iterations' is 2147483648; give a whole number"):
        model.predict(q, v, u)


def test_one_state_wants_a_batch(model: ComplementarityModel) -> None:
    q, v, u = random_states(model.scene, 1, np.random.default_rng(0), Ranges())
    told = r"^q has shape \(\d+,\); give a batch, as q\[None\], v\[None\], u\[None\] of one state$"
    with pytest.raises(UserError, match=told):
        model.predict(q[0], v[0], u[0])
    with pytest.raises(UserError, match=r"^v has shape .*; give a batch, as q\[None\], v\[None\] of one state$"):
        model.smooth_dynamics(q, v[0])


def test_a_wrong_shape_is_named(model: ComplementarityModel) -> None:
    q, v, u = random_states(model.scene, 2, np.random.default_rng(0), Ranges())
    with pytest.raises(UserError, match=r"array 'u' has the shape \(1, 3\); give \(2, 3\)"):
        model.predict(q, v, u[:1])
