"""Ctrl-C: the first ends a fit with a short report on its best so far, the second without a report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cmbrl

from .conftest import QUICK


class Presses:
    """Progress of a fit, during which Ctrl-C is pressed when it reports each of ``texts`` in turn."""

    def __init__(self, *texts: str) -> None:
        self.texts, self.told = list(texts), []

    def __call__(self, done: float, text: str) -> None:
        self.told.append(text)
        if self.texts and text.startswith(self.texts[0]):
            del self.texts[0]
            raise KeyboardInterrupt


def test_the_first_leaves_a_short_report_on_the_best_so_far(carts, two_carts, quick_fit, capsys) -> None:
    found = cmbrl.fit(carts.model(2), two_carts, budget=QUICK, progress=Presses("polish"))
    assert found.report["stopped"] == "interrupted"
    assert found.report["fitted"] == quick_fit.report["fitted"]
    assert found.report["loss"]["held out, fitted"]["rmse"] < 0.3 * found.report["loss"]["held out, nominal"]["rmse"]
    assert found.report["loss"]["all, fitted"]["starts"] < quick_fit.report["loss"]["all, fitted"]["starts"]
    assert "Ctrl-C again" in capsys.readouterr().err


def test_the_second_leaves_what_a_resumed_fit_goes_on_with(carts, two_carts, quick_fit, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        cmbrl.fit(carts.model(2), two_carts, budget=QUICK, folder=tmp_path, progress=Presses("polish", "intervals"))
    resumed = cmbrl.fit(carts.model(2), two_carts, budget=QUICK, folder=tmp_path)
    assert (resumed.report["resumed"], resumed.report["stopped"]) == (True, None)
    assert np.array_equal(resumed.model.parameters, quick_fit.model.parameters)
