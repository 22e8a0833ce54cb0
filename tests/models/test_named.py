"""The model of a task, and of a task in other steps than its own."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from cmbrl.errors import UserError
from cmbrl.models.named import nominal_model
from cmbrl.models.source import load_source
from cmbrl.registry import load_task


@pytest.mark.parametrize("time_step", [0.01, 0.005, 0.0025])
def test_a_task_in_other_steps_keeps_its_control_step(time_step: float) -> None:
    """Ant's model takes ten steps of 5 ms, its file five of 10 ms."""
    task = load_task("ant")
    model = nominal_model(task, time_step=time_step)
    assert model.substeps == round(0.05 / time_step)
    assert model.dt == pytest.approx(task.control_dt)
    with pytest.raises(UserError, match=r"not a whole number of time steps of 0\.003 s"):
        nominal_model(task, time_step=0.003)


@pytest.mark.parametrize(("dt", "substeps"), [(0.008, 4), (0.002, 1), (0.02, 10), (0.005, 3)])
def test_a_task_is_fitted_to_a_log_of_another_rate(dt: float, substeps: int) -> None:
    """In steps of its own, 2 ms of the hopper's four in 8 ms, or shorter ones where these make no row of the log."""
    source = load_source("hopper")
    assert source.task is not None
    log = SimpleNamespace(dt=dt)
    model = source.model(log)  # type: ignore[arg-type]  # of which the duration of a row counts
    assert model.substeps == substeps
    assert model.dt == pytest.approx(dt)
    assert model.smoothing == nominal_model(source.task).smoothing
    assert source.model().dt == pytest.approx(source.task.control_dt)
