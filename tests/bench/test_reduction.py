"""The reduction study: every variant of a group takes the same step. No test asserts a time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cmbrl.bench.studies.reduction.cases import groups
from cmbrl.bench.studies.reduction.study import STUDY, measure
from cmbrl.bench.study import Settings


def test_variants_take_the_same_step() -> None:
    found = groups(["hopper", "cheetah", "cube in flight", "cube, frictionless"], 300, 0)
    assert [group.label for group in found] == ["hopper", "cheetah", "cube in flight", "cube, frictionless"]
    for group in found:
        rows = measure(group, 1)
        assert len(rows) == len(group.variants)
        assert sum(row.failures for row in rows) == 0
        assert max(row.velocity_difference for row in rows) < 1e-4
        assert max(row.typical_difference for row in rows) < 1e-7
        assert rows[0].ratio.median == 1


def test_spatial_algebra_changes_nothing_but_the_cost() -> None:
    rows = measure(groups(["hopper"], 200, 1)[0], 1)
    spatial = next(row for row in rows if row.variant == "spatial")
    assert spatial.velocity_difference < 1e-9


def test_states_in_flight_are_not_solved() -> None:
    group = groups(["cube in flight"], 100, 0)[0]
    first = group.variants[0].model
    assert (first.predict(group.q, group.v, group.u).iterations == 0).all()
    gravity = np.array([0, 0, -9.81, 0, 0, 0])
    v = first.predict(group.q, group.v, group.u).v_next  # a cube's inertia is isotropic: free flight in closed form
    assert np.allclose(v, group.v + first.time_step * gravity, atol=1e-12)


def test_writes_picture_and_table(tmp_path: Path) -> None:
    told: list[float] = []
    settings = Settings(quick=True, scenes=("cube, frictionless",))
    section = STUDY.run(tmp_path, settings, lambda share, what: told.append(share))
    assert (tmp_path / section.figures[0].file).stat().st_size > 10_000
    assert len(section.tables[0].rows) == 2
    assert told
