"""The reduction study: every variant of a group takes the same step. No test asserts a time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.studies.reduction.cells import group, measure
from cmbrl.bench.studies.reduction.plots import bars
from cmbrl.bench.studies.reduction.study import STUDY
from cmbrl.bench.study import Settings
from cmbrl.jobs import Runner


@pytest.mark.parametrize("scene", ["hopper", "cheetah", "cube in flight", "cube, frictionless"])
def test_variants_take_the_same_step(scene: str) -> None:
    rows = measure(scene, 300, 0, 1)
    assert len(rows) > 1
    assert sum(row["failures"] for row in rows) == 0
    assert max(row["velocity_difference"] for row in rows) < 1e-4
    assert max(row["typical_difference"] for row in rows) < 1e-7
    assert rows[0]["ratio"].median == 1


def test_spatial_algebra_changes_nothing_but_the_cost() -> None:
    (spatial,) = [row for row in measure("hopper", 200, 1, 1) if row["variant"] == "spatial"]
    assert spatial["velocity_difference"] < 1e-9


def test_states_in_flight_are_not_solved() -> None:
    variants, (q, v, u) = group("cube in flight", 100, 0)
    model = variants[0].model
    after = model.predict(q, v, u)
    assert (after.iterations == 0).all()
    gravity = np.array([0, 0, -9.81, 0, 0, 0])  # a cube's inertia is isotropic: free flight in closed form
    assert np.allclose(after.v_next, v + model.time_step * gravity, atol=1e-12)


def test_study_resumes_and_its_bars_are_its_times(tmp_path: Path) -> None:
    settings = Settings(quick=True, scenes=("cube, frictionless",))
    section = STUDY.run(tmp_path, settings, Runner(tmp_path / "cells"))
    table = section.tables[0]
    shown = [bar.get_width() for bar in bars(section.values["rows"]).axes[0].patches]
    assert shown == pytest.approx([row[table.columns.index("us")] for row in table.rows])
    assert (tmp_path / section.figures[0].file).read_bytes().startswith(b"\x89PNG")
    assert STUDY.run(tmp_path, settings, Runner(tmp_path / "cells")).tables == section.tables  # times are not new
