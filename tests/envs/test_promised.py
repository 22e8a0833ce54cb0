"""What a real system lacks of what a model promised."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.cli.evaluate import _promise
from cmbrl.envs.evaluation import Evaluation
from cmbrl.envs.promised import lacking


def found(*returns: float) -> Evaluation:
    return Evaluation(np.array(returns), np.full(len(returns), 9), np.zeros(len(returns), dtype=bool))


@pytest.mark.parametrize(
    ("real", "model", "idle", "share"),
    [
        ([240.0, 244.0], [480.0, 484.0], [20.0, 20.0], 240 / 482),
        ([480.0, 470.0], [478.0, 471.0], [20.0, 20.0], 0.0),  # as promised
        ([500.0], [478.0], [20.0], 0.0),  # more
        ([-6.2, -6.0], [-4.6, -4.4], [-43.0, -43.0], 1.6 / 38.5),  # costs near 0: beyond no action it is little
        ([-550.0, -570.0], [-280.0, -290.0], [-600.0, -600.0], 275 / 315),
        ([480.0, 100.0, 470.0, 470.0], [478.0, 470.0, 480.0, 475.0], [20.0] * 4, 0.0),  # one episode of four
        ([0.0], [0.0], [0.0], 0.0),
    ],
)
def test_what_is_lacking(real: list[float], model: list[float], idle: list[float], share: float) -> None:
    assert lacking(found(*real), found(*model), found(*idle)) == pytest.approx(share)


def test_what_is_lacking_is_told_with_a_remedy() -> None:
    assert _promise(0.15, "nominal", "arm.py") == ""
    assert "50 % less than nominal promises, it is not as its file: fit a log of it (cmbrl record arm.py" in _promise(
        0.5, "nominal", "arm.py"
    )
    assert "80 % less than runs/fit promises" in (told := _promise(0.8, "runs/fit", "arm.py"))
    assert "cmbrl record arm.py --policy), see where runs/fit errs there (cmbrl error), and fit both logs" in told
