"""A fit that held-out episodes speak against is not handed out: the file is, and the first line says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cmbrl
from cmbrl.fitting import Budget, course
from cmbrl.fitting.choice.judging import harmed, returned, typically
from cmbrl.fitting.outcome.page.numbers import course as course_drawn
from cmbrl.fitting.search.loss_values import Errors

from .arm_log import followed

ARM = """<mujoco><option timestep=".002"/><worldbody><body pos="0 0 1"><joint name="a" axis="0 1 0" armature=".1"
damping="{damping}"/><geom type="capsule" size=".03" fromto="0 0 0 0 0 -.4" mass="2"/><body pos="0 0 -.4"><joint
name="b" axis="0 1 0" armature=".05" damping="{damping}"/><geom type="capsule" size=".02" fromto="0 0 0 .1 0 -.3"
mass="1"/></body></body></worldbody><actuator><position joint="a" kp="60" kv="4"/><position joint="b" kp="60"
kv="4"/></actuator></mujoco>"""
QUICK = Budget(
    trial_rows=500, polish_rows=500, polish_iterations=2, fold_iterations=2, search_rows=200, starts=1, draws=8,
    trial_iterations=2,
)  # fmt: skip


def errors(nominal: float, fitted: float) -> dict[str, Errors]:
    both = {"held out, nominal": nominal, "held out, fitted": fitted}
    return {name: Errors(np.full(120, loss), np.full(120, 2.0 * loss), 0, 1.0) for name, loss in both.items()}


def test_what_is_clearly_worse_or_not_finite_is_harm() -> None:
    assert not any(harmed(errors(1.0, fitted), 1.0) for fitted in (0.5, 1.0, 1.005))
    assert all(harmed(errors(1.0, fitted), 1.0) for fitted in (1.02, np.nan, np.inf))
    move = returned(errors(1.0, 1.5))
    assert (move["gain"], move["held_out_loss"]) == (pytest.approx(0.5), 1.0)


def test_a_few_starts_that_rule_the_mean_are_no_harm() -> None:
    """Of a pole that may fall to either side, say."""
    both = errors(1.0, 0.25)
    both["held out, fitted"].loss[::20] = 50.0
    few = np.arange(len(both["held out, fitted"].loss)) // 10
    assert both["held out, fitted"].mean > 1.5
    assert typically(both, few) == pytest.approx(2.0, rel=0.3)
    assert not harmed(both, typically(both, few))
    assert [typically(errors(1.0, fitted), few) for fitted in (1.0, np.nan)] == [1.0, 0.0]
    assert harmed(errors(1.0, 1.5), typically(errors(1.0, 1.5), few))


@pytest.mark.parametrize(("groups", "kept"), [(None, False), ("damping", True)])
def test_a_default_fit_that_harms_goes_back_to_the_file(
    groups: str | None, kept: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(course, "harmed", lambda *_: True)
    (tmp_path / "arm.xml").write_text(ARM.format(damping=0.2))
    model = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(tmp_path / "arm.xml"))
    result = cmbrl.fit(model, followed(ARM.format(damping=0.5), 400), groups=groups, budget=QUICK)
    assert bool(result.report["fitted"]) is kept
    assert ([row["group"] for row in result.report["selection"] or ()][-1:] == ["all that had moved"]) is not kept
    first = result.report_text().replace("\n  ", " ")
    assert first.startswith("Nothing was fitted: what had moved predicted unseen episodes worse") is not kept
    if not kept:
        assert all(p.value == p.nominal for p in result.parameters.values())
    assert course_drawn(result.report) is not None
