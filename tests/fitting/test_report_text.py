"""The report as text: what it leaves out, and how it names what it tells."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from cmbrl import ComplementarityModel, Scene, Transitions, fit
from cmbrl.fitting import Budget
from cmbrl.fitting.fitted_parameter import FittedParameter
from cmbrl.fitting.outcome.report_text import render
from cmbrl.scene.info.inventory import moving_pairs

ROW = {"rmse": 0.1, "loss": 0.2, "failures": 0}
REPORT: dict[str, Any] = {
    "data": {"transitions": 3999, "episodes": 1}, "method": "random", "seed": 0, "seconds": {"total": 1.0},
    "candidates": 5, "horizon": 1, "loss": {"all, fitted": ROW}, "stopped": None, "selection": None,
    "flat_directions": [], "at_bound": [], "unseen": [], "gauge": [], "left_out": [], "fitted": ["mass.a"],
}  # fmt: skip


def told(parameters: dict[str, FittedParameter] | None = None, **more: Any) -> str:
    return " ".join(render(parameters or {}, {**REPORT, **more}).split())


def test_one_episode_is_one() -> None:
    assert "fit of 3999 transitions in 1 episode by random" in told()


def test_noise_that_does_not_show_is_not_listed() -> None:
    text = told(noise=[[1e-3, 2e-3, 0.0, 0.0]])
    assert "sensor noise of positions [m, rad]: 0.001, 0.002" in text
    assert "sensor noise of velocities" not in text
    assert "sensor noise of velocities [m/s, rad/s]: 0, 0.01" in told(noise=[[1e-3, 2e-3, 0.0, 0.01]])


def test_starts_that_are_free_are_named() -> None:
    one = told(noise=[[1.1e-4, 0.0, 2.1e-3, 0.0]], positions_only=True, coordinates=["x", "theta"])
    assert "err by about 0.00011 (m, rad) and 0.0021 (m/s, rad/s) at x: each" in one
    base = {"positions_only": True, "coordinates": [f"base.{k}" for k in range(8)]}
    several = told(noise=[[*range(1, 9), *range(1, 9)]], **base)
    assert "err by about 1 to 8 (m, rad) and 1 to 8 (m/s, rad/s) at base.0, base.1, base.2 and 5 more: each" in several
    assert "(m/s, rad/s): each" in told(noise=[[1.0, 1.0]], positions_only=True)  # as fits of earlier versions


def test_a_table_names_the_start_where_it_was_set() -> None:
    moved = {"mass.a": FittedParameter(1.2, 1.1, 1.3, 1.0, "fitted", "1")}
    assert "95 % interval nominal status" in told(moved)
    assert "95 % interval start status" in told(moved, set=["mass.a"])


def test_pairs_are_named() -> None:
    moved = {"friction.pairs": FittedParameter(0.4, 0.3, 0.5, 0.5, "fitted", "1")}
    text = told(moved, pairs=["ball-box", "ball-lid"])
    assert "fitted 1 pairs: all contacts between moving bodies, ball-box, ball-lid" in text
    many = told(moved, pairs=[f"a-b{k}" for k in range(20)])
    assert "a-b7 and 12 more" in many
    assert "all contacts between" not in told({"friction.ball": moved["friction.pairs"]}, pairs=["ball-box"])
    assert "all contacts between" not in told(moved)  # as fits of earlier versions


def test_pairs_are_those_of_moving_bodies() -> None:
    bodies = "".join(f'<body pos="{k} 0 1"><freejoint/><geom name="{k}" size=".1"/></body>' for k in "123")
    floor = '<geom name="floor" type="plane" size="9 9 1"/>'
    scene = Scene.from_mjcf(f"<mujoco><worldbody>{floor}{bodies}</worldbody></mujoco>")
    assert moving_pairs(scene) == ["1-2", "1-3", "2-3"]


def test_what_is_zero_but_for_rounding_is_shown_as_zero() -> None:
    assert "bias.x 0 [-0.06, 0.06]" in told({"bias.x": FittedParameter(3.6e-118, -0.06, 0.06, 0.0, "fitted", "m")})
    assert FittedParameter(1e-7, 0.0, 1.0, 0.0, "fitted").shown == 1e-7


def test_ratios_that_motion_hardly_tells_are_left_out() -> None:
    parameters = {f"{x}.a": FittedParameter(1.0, 0.1, 9.0, 1.0, "flat") for x in ("gear", "mass", "armature")}
    found = {"reference": "gear.a", "parameters": {"mass.a": [1.0, 0.8, 1.25], "armature.a": [0.01, 0.0027, 0.037]}}
    text = told(parameters, ratios=[found])
    assert "if gear.a is the file's 1, then mass.a 1 [0.8, 1.25]" in text
    assert "armature.a 0.01" not in text
    assert "without 1, which motion tells within a factor of 3 at best" in text
    assert "if gear.a is what it began at, 1, then" in told(parameters, ratios=[found], set=["gear.a"])
    held = {**found, "held": ["gear.a", "damping.a", "kd.a"]}
    assert "if gear.a is the file's 1 and 2 more are right that were held (damping, gear, kd), then" in told(
        parameters, ratios=[held]
    )
    del found["parameters"]["mass.a"]  # type: ignore[attr-defined]
    assert "ratios" not in told(parameters, ratios=[found])


@pytest.mark.parametrize(("encoders", "says"), [(1e-4, True), (1e-3, False), (0.0, False)])
def test_what_is_left_beyond_the_noise_of_encoders_is_said(encoders: float, says: bool) -> None:
    errors = {
        "rmse": {"hold": 9.0, "nominal": 0.5, "fitted": 0.01},
        "loss": {"hold": 9.0, "nominal": 0.5, "fitted": 0.1},
    }
    text = told({}, horizons=[{"steps": 900, "estimated": True, "encoders": encoders, **errors}])
    assert ("over 900 steps, what is left is 1e+02 times the noise of the encoders" in text) == says


POLE = """<mujoco><option timestep=".005"/><worldbody><body name="pole"><joint name="a" axis="0 1 0" damping=".01"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 {}" mass=".3"/></body></worldbody>
<actuator><motor name="a" joint="a"/></actuator></mujoco>"""


@pytest.mark.parametrize(("end", "beyond"), [(-1.5, True), (-0.6, False)])
def test_a_centre_that_is_beyond_the_end_of_its_link_is_told(tmp_path: Path, end: float, beyond: bool) -> None:
    """The pole is three times as long as in the file, or hardly longer."""
    (tmp_path / "pole.xml").write_text(POLE.format(-0.5))
    model = mujoco.MjModel.from_xml_string(POLE.format(end))
    data, rng, rows = mujoco.MjData(model), np.random.default_rng(0), []
    for row in range(400):
        data.ctrl[:] = 1.5 * np.sin(0.07 * row) + np.sin(0.19 * row)
        rows.append([*data.qpos, *data.qvel, *data.ctrl])
        mujoco.mj_step(model, data, 2)
    q, v, u = np.array(rows).T[:, :, None] + [[[1e-5]], [[1e-4]], [[0.0]]] * rng.normal(size=(3, 400, 1))
    episode = np.repeat(np.arange(4), 100)[:-1]
    log = Transitions(q=q[:-1], v=v[:-1], u=u[:-1], q_next=q[1:], v_next=v[1:], dt=0.01, episode=episode)
    budget = Budget(survey_rows=300, trial_rows=300, held_out_rows=300, polish_rows=300, starts=1)
    scene = Scene.from_mjcf(tmp_path / "pole.xml")
    found = fit(ComplementarityModel(scene), log, groups=["com_z", "inertia"], budget=budget)
    assert found.report["beyond"] == (["com_z.pole"] if beyond else [])
    assert ("beyond what is expected" in found.report_text()) is beyond
