"""Velocities that an import took for slopes of positions: they tell where predictions start, and are not compared."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import cmbrl
from cmbrl import ComplementarityModel, Scene
from cmbrl.data.transitions import Transitions
from cmbrl.fitting import Budget
from cmbrl.fitting.log import evidence as evidence_module
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.horizons import horizons_of, judged_over
from cmbrl.fitting.log.judge import Judge
from cmbrl.fitting.log.noise import sensor_noise
from cmbrl.fitting.log.position_noise import slopes

PUCK = """<mujoco><option timestep="0.005"/><worldbody><geom type="plane" size="5 5 1" friction="{0}"/>
<body pos="0 0 .2"><freejoint/><geom name="puck" type="box" size=".06 .04 .02" mass=".3" friction="{0}"/></body>
</worldbody></mujoco>"""
PLACE, TURN, DT = 3e-4, 1e-3, 0.01


def tosses(half: int, count: int = 12, rows: int = 60, friction: float = 0.3) -> Transitions:
    """Tosses by a capture with noise, and velocities by slopes over ``half`` rows on either side; 0: the true ones."""
    model = mujoco.MjModel.from_xml_string(PUCK.format(friction))
    data, draw, parts = mujoco.MjData(model), np.random.default_rng(0), []
    for toss in range(count):
        mujoco.mj_resetData(model, data)
        data.qpos[2] = 0.06
        data.qvel[:] = draw.normal(size=6) * [1.5, 1.5, 0.3, 2.0, 2.0, 6.0]
        q, v = np.empty((rows, 7)), np.empty((rows, 6))
        for row in range(rows):
            q[row], v[row] = data.qpos, data.qvel
            mujoco.mj_step(model, data, 2)
        off = np.concatenate([PLACE * draw.normal(size=(rows, 3)), TURN * draw.normal(size=(rows, 3))], axis=1)
        for row in range(rows):
            mujoco.mj_integratePos(model, q[row], off[row], 1.0)
        if half:
            q, v = q[half : rows - half], _slopes(model, q, half)
        parts.append((q, v, np.full(len(q) - 1, toss)))
    q, v = (np.concatenate([part[k][:-1] for part in parts]) for k in (0, 1))
    q_next, v_next = (np.concatenate([part[k][1:] for part in parts]) for k in (0, 1))
    episode = np.concatenate([part[2] for part in parts])
    return Transitions(q=q, v=v, u=np.empty((len(q), 0)), q_next=q_next, v_next=v_next, dt=DT, episode=episode)


def _slopes(model: mujoco.MjModel, q: np.ndarray, half: int) -> np.ndarray:
    found, change = np.zeros((len(q) - 2 * half, 6)), np.empty(6)
    for row in range(len(found)):
        for k in range(-half, half + 1):
            mujoco.mj_differentiatePos(model, change, 1.0, q[row + half], q[row + half + k])
            found[row] += k * change
    return found / (DT * sum(k * k for k in range(-half, half + 1)))


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    (tmp_path / "puck.xml").write_text(PUCK.format(0.6))
    return Scene.from_mjcf(tmp_path / "puck.xml")


@pytest.mark.parametrize("half", [0, 1, 2, 3])
def test_they_are_known_by_the_positions_around_them(scene: Scene, half: int) -> None:
    log = tosses(half)
    assert slopes(scene, log).tolist() == [half] * 6
    clean = replace(log, v=log.v + 1.0)  # of a sensor of their own
    assert not slopes(scene, clean).any()


def test_their_noise_is_that_of_positions_less_what_slopes_leave(scene: Scene) -> None:
    evidence = Evidence.of(ComplementarityModel(scene), tosses(2))
    noise = sensor_noise(evidence, evidence.space.nominal)
    assert noise is not None
    np.testing.assert_allclose(noise[0, 6:], noise[0, :6] / (DT * np.sqrt(10.0)))
    np.testing.assert_allclose(noise[0, :3], PLACE, rtol=0.2)


def test_they_are_not_compared_nor_what_they_have_seen(scene: Scene) -> None:
    evidence = Evidence.of(ComplementarityModel(scene), tosses(2))
    assert evidence.compared == 6
    assert all(np.isinf(scales.v).all() and np.isfinite(scales.q).all() for scales in evidence.scales(4, 0.5))
    assert min(horizons_of(evidence, "auto")) == min(judged_over(evidence)) == 4
    assert all(np.isinf(judge.scale[6:]).all() for judge in Judge.all(evidence, 0.5))
    sensed = Evidence.of(ComplementarityModel(scene), tosses(0))
    assert (sensed.compared, min(horizons_of(sensed, "auto"))) == (12, 1)


@pytest.mark.slow
def test_blows_do_not_make_a_body_heavier_to_turn(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Slopes across an impact are between the velocities before and after it: compared, they tell of more inertia."""
    monkeypatch.setattr(evidence_module, "slopes", lambda scene, data: np.zeros(scene.nv, dtype=np.int64))
    compared = _inertia(scene)
    monkeypatch.undo()
    assert np.abs(np.log(_inertia(scene))).max() < 0.6 * np.abs(np.log(compared)).max()


def _inertia(scene: Scene) -> list[float]:
    """As shares of the true ones, of a puck that is told from tosses."""
    budget = Budget(survey_rows=600, trial_rows=600, held_out_rows=600, search_rows=300, polish_rows=1500, starts=1)
    groups = ["friction", "inertia", "softness_time", "softness_damping"]
    found = cmbrl.fit(ComplementarityModel(scene), tosses(2, count=16), groups=groups, budget=budget)
    return [found.parameters[f"inertia.body1:{axis}"].value for axis in "xy"]
