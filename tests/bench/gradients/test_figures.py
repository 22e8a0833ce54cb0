"""The papers' figures are drawn, and figure 5b returns what it shows."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from cmbrl.bench.studies.gradients import figures, figures_policy
from cmbrl.bench.studies.gradients.systems import SYSTEMS
from cmbrl.contact import Barrier

SCRIPTS = Path(__file__).parents[3] / "scripts"


@pytest.mark.parametrize("draw", [figures.figure_1, figures.figure_2, figures.figure_6])
def test_one_contact(draw: object, tmp_path: Path) -> None:
    draw(tmp_path / "figure.png")  # type: ignore[operator]
    assert (tmp_path / "figure.png").stat().st_size > 20_000


def test_variance_against_horizon(tmp_path: Path) -> None:
    figures_policy.figure_3(tmp_path / "figure.png", horizons=(2, 4), samples=4)
    assert (tmp_path / "figure.png").stat().st_size > 20_000


def test_bias_of_the_cheetah(tmp_path: Path) -> None:
    rows = figures_policy.figure_5b(tmp_path / "figure.png", horizons=(2, 4), samples=8)
    assert (tmp_path / "figure.png").stat().st_size > 20_000
    assert len(rows) == 2 * 6
    assert all(0 <= r.bias < 10 and r.unsolved == 0 for r in rows)


def test_length_of_a_kappa() -> None:
    system = SYSTEMS["hopper"]()
    length = figures_policy.length_of(system, 1e-3)
    kappa = Barrier(length=length).resolve(system.scene, system.settings["time_step"])["kappa"]
    assert kappa == pytest.approx(1e-3, rel=1e-12)


@pytest.mark.parametrize("script", sorted(SCRIPTS.glob("figure_[1-6]*.py")), ids=lambda path: path.stem)
def test_scripts_explain_themselves(script: Path) -> None:
    """Every figure has a script with --out that says what was not to be had from the paper."""
    text = script.read_text(encoding="utf-8")
    explanation = ast.get_docstring(ast.parse(text))
    assert explanation
    assert "our choice" in explanation
    assert "--out" in text
