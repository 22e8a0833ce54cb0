"""The study of policy gradients: its systems, its reference, and that what it keeps can be read again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.studies.gradients.contenders import Contender, contenders
from cmbrl.bench.studies.gradients.measure import judge
from cmbrl.bench.studies.gradients.study import STUDY
from cmbrl.bench.studies.gradients.systems import SYSTEMS
from cmbrl.bench.study import Section, Settings
from cmbrl.contact import Barrier
from cmbrl.gradients import finite_differences, pathwise


@pytest.mark.parametrize("name", ["push impact", "push friction", "hopper", "cheetah"])
def test_pathwise_of_the_softened_return_is_its_derivative(name: str) -> None:
    """The systems are wired right: where kappa makes the return smooth, ours equals its differences."""
    system = SYSTEMS[name]()
    model = system.model(smoothing=Barrier(kappa=1e-2), prune=np.inf, path_tolerance=1e-10)
    objective = system.rollout(model, 6, 4)
    ours, reference = pathwise(objective, system.at, 4), finite_differences(objective, system.at, 1e-5, 4)
    np.testing.assert_allclose(ours.gradients, reference.gradients, rtol=1e-3, atol=1e-3 * np.abs(ours.gradients).max())


def test_exact_is_unbiased_on_a_push() -> None:
    """Inelastic impact: the hard derivative is the derivative of the expected return, a large kappa's is not."""
    exact, soft = judge(SYSTEMS["push impact"](), 16, [Contender("exact"), Contender("barrier", 1e-2)], 64, 0)
    assert exact.bias < 1e-3
    assert soft.resolved
    assert soft.bias > 0.05


def test_cells_are_kept(tmp_path: Path) -> None:
    system, field = SYSTEMS["push friction"](), [Contender("exact"), Contender("randomised", 1e-3, 3)]
    first = judge(system, 4, field, 8, 0, tmp_path)
    assert len(list(tmp_path.glob("*.json"))) == 3
    assert judge(system, 4, field, 8, 0, tmp_path) == first
    assert first[1].steps == 4 * 4


def test_every_contender_runs() -> None:
    """On the cheapest system, with finite results."""
    field = list(contenders())
    assert len({c.name for c in field}) == len(field)
    rows = judge(SYSTEMS["push impact"](), 8, field, 8, 0)
    assert all(row.failed == 0 and row.unsolved == 0 and row.bias < 1e3 for row in rows)


def test_study(tmp_path: Path) -> None:
    STUDY.run(tmp_path, Settings(quick=True, scenes=("push impact",)), lambda share, what: None).write(tmp_path)
    section = Section.read(tmp_path)
    assert {row[0] for row in section.tables[0].rows} == {"push impact"}
    for figure in section.figures:
        assert (tmp_path / figure.file).stat().st_size > 10_000
