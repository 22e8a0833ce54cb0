"""What a killed fit has done is not done again: units of work, and the steps of the one that was not finished."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cmbrl
from cmbrl.data import Transitions
from cmbrl.data.plausible.finding import Finding
from cmbrl.data.remembered import remembered
from cmbrl.errors import UserError
from cmbrl.fitting import state as state_module
from cmbrl.fitting.log import checking
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.search.gauss_newton import gauss_newton
from cmbrl.fitting.search.objective import Objective
from cmbrl.fitting.state import Journal, OutOfTime


class Killed(BaseException):
    """Stands for the end of the process."""


def test_a_search_goes_on_inside_of_the_unit_that_was_killed(
    carts, two_carts: Transitions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(state_module, "_SECONDS_BETWEEN_WRITES", -1.0)
    monkeypatch.setattr(state_module, "_OF_WRITING", 0.0)
    evidence = Evidence.of(carts.model(2), two_carts)
    loss = evidence.loss(two_carts.windows(4)[::9], 4, *evidence.scales(4, 0.5))
    active, z = evidence.space.default, np.zeros(len(evidence.space))
    steps = []

    def searched(journal: Journal, most: int) -> dict[str, list[float]]:
        def keep(_: np.ndarray) -> None:
            if len(steps) == most:
                raise Killed
            steps.append(1)

        objective = Objective.at(loss, evidence.space, active, z)
        return {"z": gauss_newton(objective, z, 6, journal, keep, decrease=0.0).z.tolist()}

    whole = searched(Journal(None, ""), 99)
    equations, computed = Objective.normal_equations, []
    monkeypatch.setattr(Objective, "normal_equations", lambda *a: computed.append(1) or equations(*a))
    steps.clear()
    journal = Journal(tmp_path, "fit")
    with pytest.raises(Killed):
        journal.unit("search", lambda: searched(journal, 2))
    before = len(computed)
    resumed = Journal(tmp_path, "fit")
    assert resumed.resumed
    assert resumed.unit("search", lambda: searched(resumed, 99)) == whole
    assert (before, len(computed) - before) == (3, 3)
    assert not resumed.rounds  # the outcome of the unit takes their place


def test_checks_end_in_time_and_leave_nothing_of_a_log_that_is_refused(
    carts, two_carts: Transitions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def late(self: checking.MountCheck) -> None:
        self.journal.cuts += 1
        raise OutOfTime

    monkeypatch.setattr(checking.MountCheck, "finding", late)
    monkeypatch.setattr(checking.ColumnsCheck, "finding", lambda self: Finding("is negated"))
    evidence, told = Evidence.of(carts.model(2), two_carts), []
    with pytest.raises(UserError, match="is negated"):
        checking.checked(evidence, 1, 0.5, 0, Journal(tmp_path, "fit", lambda *x: told.append(x)), 100.0)
    assert told == [(0.0, "checking the log: mount"), (0.0, "checking the log: columns")]
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(checking.ColumnsCheck, "finding", lambda self: None)
    journal = Journal(tmp_path, "fit")
    assert checking.checked(evidence, 1, 0.5, 0, journal, 100.0) == ("mount",)
    assert (journal.cuts, list(journal.units)) == (0, ["check of columns"])
    assert "the log's mount" in checking.unchecked_told(["mount"])


def test_what_follows_from_a_log_is_computed_once(two_carts: Transitions) -> None:
    log, calls = two_carts.select(slice(None)), []
    first, again = (remembered(log, "numbers", lambda: calls.append(1) or np.arange(3)) for _ in range(2))
    assert first is again
    assert len(calls) == 1
    with pytest.raises(ValueError, match="read-only"):
        first[0] = 1
    assert remembered(cmbrl.Transitions(**log.fields()), "numbers", lambda: 7) == 7
