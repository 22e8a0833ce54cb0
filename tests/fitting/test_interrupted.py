"""Ctrl-C: the first ends a fit with a short report on its best so far, the second without a report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cmbrl
from cmbrl.fitting import Budget

QUICK = Budget(trial_rounds=3, trial_population=16)


class Presses:
    """Progress of a fit, during which Ctrl-C is pressed when it reports each of ``texts`` in turn."""

    def __init__(self, *texts: str) -> None:
        self.texts, self.told = list(texts), []

    def __call__(self, done: float, text: str) -> None:
        self.told.append(text)
        if self.texts and text.startswith(self.texts[0]):
            del self.texts[0]
            raise KeyboardInterrupt


@pytest.fixture
def data(carts):
    return carts.record(carts.truth(2, gear_1=0.7, tilt=0.4), episodes=20, steps=40, noise=1e-3)


def test_the_first_leaves_a_short_report_on_the_best_so_far(carts, data, capsys) -> None:
    whole = cmbrl.fit(carts.model(2), data, budget=QUICK)
    found = cmbrl.fit(carts.model(2), data, budget=QUICK, progress=Presses("polish"))
    assert found.report["stopped"] == "interrupted"
    assert found.report["fitted"] == whole.report["fitted"]
    assert found.report["loss"]["held out, fitted"]["rmse"] < 0.3 * found.report["loss"]["held out, nominal"]["rmse"]
    assert found.report["loss"]["all, fitted"]["starts"] < whole.report["loss"]["all, fitted"]["starts"]
    assert "Ctrl-C again" in capsys.readouterr().err


def test_the_second_leaves_what_a_resumed_fit_goes_on_with(carts, data, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        cmbrl.fit(carts.model(2), data, budget=QUICK, folder=tmp_path, progress=Presses("polish", "intervals"))
    resumed = cmbrl.fit(carts.model(2), data, budget=QUICK, folder=tmp_path)
    whole = cmbrl.fit(carts.model(2), data, budget=QUICK)
    assert (resumed.report["resumed"], resumed.report["stopped"]) == (True, None)
    assert np.array_equal(resumed.model.parameters, whole.model.parameters)
