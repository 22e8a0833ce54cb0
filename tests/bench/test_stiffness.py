"""The stiffness sweep: its real system against closed forms, its errors, the section from made-up cells."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.accuracy.strata import in_contact
from cmbrl.bench.studies.stiffness.cells import Work, cell, errors
from cmbrl.bench.studies.stiffness.study import plot, table
from cmbrl.bench.studies.stiffness.tosses import TOSS_STEPS, record
from cmbrl.fitting import Budget
from cmbrl.models.baselines import Ballistic, HoldVelocity
from cmbrl.registry import load_task


def test_tosses_fly_freely_and_sink_less_into_stiffer_ground() -> None:
    scene = load_task("cube_toss").load_scene()
    depth = {}
    for stiffness in (100.0, 2500.0):
        log = record(stiffness, 2 * TOSS_STEPS, 0)
        flight = ~in_contact(log, scene, 2e-3)
        fall = np.array([0, 0, -9.81 * log.dt, 0, 0, 0])
        assert np.allclose((log.v_next - log.v)[flight], fall, atol=1e-9)  # isotropic inertia: the spin stays
        depth[stiffness] = -scene.gaps(log.q).min()
    assert depth[100.0] > 2 * depth[2500.0] > 0
    again = record(100.0, 90, 0)
    assert np.array_equal(again.q, record(100.0, 2 * TOSS_STEPS, 0).q[:90])
    assert again.n_episodes == 2


def test_errors_are_relative_to_the_change() -> None:
    scene, dt = load_task("cube_toss").load_scene(), load_task("cube_toss").control_dt
    log = record(500.0, 3 * TOSS_STEPS, 1)
    ballistic, hold = errors(Ballistic(scene, dt), log), errors(HoldVelocity(scene, dt), log)
    assert ballistic["flight"] < 1e-9
    change = log.v_next - log.v
    assert hold["all"] == pytest.approx(np.sqrt(np.mean(np.mean(change**2, 0) / np.var(change, 0))))
    assert hold["turn"] == pytest.approx(np.sqrt(np.mean(change[:, 3:] ** 2)))


@pytest.mark.slow
def test_a_fit_of_the_right_law_wins() -> None:
    small = Budget(trial_rows=200, trial_rounds=1, trial_population=8, held_out_rows=200, search_rows=200,
                   search_rounds=2, search_population=16, polish_rows=300, polish_iterations=4)  # fmt: skip
    models = cell(500.0, 0, Work(rows=300, test_rows=300, updates=20, budget=small))
    assert models["soft, fitted"]["all"] < min(models[m]["all"] for m in ("soft, nominal", "neural ensemble"))


def test_every_seed_is_shown() -> None:
    """Seed 1 errs twice as much as seed 0."""
    names = ("soft, fitted", "soft, nominal", "rigid, fitted", "rigid, nominal", "neural ensemble", "ballistic")
    error = {"all": 0.5, "contact": 0.6, "flight": 0.1, "turn": 1.0, "seconds": 2.0}
    cells = [
        {"stiffness": k, "seed": s, "models": {n: {key: (1 + s) * e for key, e in error.items()} for n in names}}
        for k in (100.0, 500.0)
        for s in (0, 1)
    ]
    assert len(table(cells).rows) == 4 * len(names)
    for axes, key in zip(plot(cells).axes, ("all", "contact", "turn"), strict=True):
        dots, medians = axes.get_lines()[:2]
        assert dots.get_xydata().tolist() == [[c["stiffness"], c["models"]["ballistic"][key]] for c in cells]
        assert medians.get_ydata() == pytest.approx([1.5 * error[key]] * 2)
