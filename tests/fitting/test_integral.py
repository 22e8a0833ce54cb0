"""Servos that integrate what they are off, where the file's do not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cmbrl
from cmbrl.accuracy.open_loop import simulate
from cmbrl.data.position_log import PositionLog
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.models.between.begun import Begun

from .servo_arm import AHEAD, QUICK, H, arm, recorded

BEGUN = 150  # rows before the log, in which the controller has integrated


def integrating(gain: float, rows: int = 1000, begun: int = BEGUN, lacked: float = 0.0) -> PositionLog:
    """An arm that gravity pulls at, under a controller whose ki / kp is ``gain``.

    ``lacked`` [rad s]: what it had integrated ``begun`` rows before the log.
    """

    def control(target: float, rate: float, position: float) -> float:
        nonlocal lacked
        lacked += H * (target - position)
        return target + gain * lacked

    return recorded(arm(2.5, AHEAD), control, rows, begun)


@pytest.mark.parametrize("integral", [3.0, 0.0])
def test_an_integral_is_found_where_there_is_one(integral: float, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(arm(2.0, AHEAD))
    scene = cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")
    log = integrating(integral)
    found = cmbrl.fit(cmbrl.ComplementarityModel(scene), log, budget=QUICK)
    assert ("integral" in [row["group"] for row in found.report["selection"] or []]) == bool(integral)
    assert found.parameters["integral.servo"].value == pytest.approx(integral, rel=0.05)
    data = Evidence.of(found.model, log).log
    ahead = simulate({"fit": found.model}, data, scene, data.dt * (1.0 + np.arange(len(data))))
    assert ahead.mean("fit").mean() < 2e-3  # over ten seconds, by its own integral


def test_logs_begin_with_integrals_of_their_own(tmp_path: Path) -> None:
    """Those of the fit, which agree all the same, and one that it is judged by."""
    (tmp_path / "arm.xml").write_text(arm(2.0, AHEAD))
    scene = cmbrl.Scene.from_mjcf(tmp_path / "arm.xml")
    logs = {"one": integrating(3.0, 500), "other": integrating(3.0, 500, begun=10, lacked=0.06)}
    found = cmbrl.fit(cmbrl.ComplementarityModel(scene), logs, budget=QUICK)
    assert found.parameters["integral.servo"].value == pytest.approx(3.0, rel=0.05)
    assert all(log["agrees"] for log in found.report["logs"])
    third = Evidence.of(found.model, integrating(3.0, 500, begun=5, lacked=-0.05)).log
    assert np.abs(found.model.seen(third).u[0] - third.u[0]).max() > 0.1
    ahead = simulate({"fit": found.model}, third, scene, third.dt * (1.0 + np.arange(len(third))))
    assert ahead.mean("fit").mean() < 2e-3


def test_what_was_integrated_is_that_of_the_episode() -> None:
    """In the control, to the noise of the encoder; another episode has its own."""
    scene = cmbrl.Scene.from_mjcf(arm(2.5, AHEAD))
    model = cmbrl.ComplementarityModel(scene, observation={"integral.servo": 3.0}).for_log(0.01)
    logs = {"one": integrating(3.0, 300, begun=1, lacked=0.1), "other": integrating(3.0, 300, begun=1, lacked=-0.1)}
    log = Evidence.of(model, logs).log
    first = np.flatnonzero(np.diff(log.episode, prepend=-1))
    assert (model.seen(log).u - log.u)[first, 0] == pytest.approx([0.3, -0.3], abs=0.02)


def test_episodes_of_another_log_begin_as_all_do() -> None:
    begun = Begun(np.array([2, 5]), np.array([[0.1], [0.2]]))
    assert begun.of(np.array([5, 2, 3, 9]))[:, 0].tolist() == [0.2, 0.1, 0.0, 0.0]
