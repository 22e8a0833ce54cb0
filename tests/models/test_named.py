"""The model of a task, and of a task in other steps than its own."""

from __future__ import annotations

import pytest

from cmbrl.errors import UserError
from cmbrl.models.named import nominal_model
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
