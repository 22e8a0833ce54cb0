"""The page of a fit: whole in one file, for logs of states and of positions, and only after a fit that is done."""

import base64
import io
import json
import re
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from PIL import Image

from cmbrl.cli import main
from cmbrl.data import Transitions
from cmbrl.data.position_log import PositionLog
from cmbrl.errors import UserError
from cmbrl.fitting import FitResult
from cmbrl.fitting.outcome.first_line import first_line
from cmbrl.fitting.outcome.page.motion import MOST, motion, residuals
from cmbrl.fitting.outcome.page.predictions import OneStep, Window

ARM = """
<mujoco><option timestep="0.005" integrator="implicitfast"/>
<worldbody><geom name="floor" type="plane" size="1 1 1" pos="0 0 -.5"/><body>
  <joint name="hip" axis="0 1 0" damping="{damping}" armature=".01"/>
  <geom name="upper" type="capsule" size=".03" fromto="0 0 0 0 0 -.25" mass="1.2"/>
  <body pos="0 0 -.25"><joint name="knee" axis="0 1 0" damping="{damping}" armature=".01"/>
    <geom name="lower" type="capsule" size=".02" fromto="0 0 0 0 0 -.25" mass=".4"/></body>
</body></worldbody>
<actuator><position joint="hip" kp="25" kv="1"/><position joint="knee" kp="25" kv="1"/></actuator></mujoco>
"""
NAMES = ("motion", "residuals", "parameters", "together", "course")


def simulated(damping: float, rows: int) -> dict[str, np.ndarray]:
    """Positions, velocities and targets of slow sines."""
    model = mujoco.MjModel.from_xml_string(ARM.format(damping=damping))
    data = mujoco.MjData(model)
    time = 0.005 * np.arange(rows)
    target = 0.8 * np.sin(np.outer(time, [7.0, 11.0]))
    q, v = np.zeros((rows, 2)), np.zeros((rows, 2))
    for row in range(rows):
        q[row], v[row] = data.qpos, data.qvel
        data.ctrl = target[row]
        mujoco.mj_step(model, data)
    return {"time": time, "q": q, "v": v, "u": target}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """arm.xml, a log of states and a log of positions of an arm with three times its damping."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "arm.xml").write_text(ARM.format(damping=0.1))
    log = simulated(0.3, 601)
    q, v, u = log["q"], log["v"], log["u"]
    steps = {"q": q[:-1], "v": v[:-1], "u": u[:-1], "q_next": q[1:], "v_next": v[1:]}
    Transitions(**steps, dt=0.005, episode=np.arange(600) // 100).save(folder / "states.npz")
    names = ("hip", "knee")
    PositionLog(time=log["time"], position=q, command=u, joint_names=names).save(folder / "positions.npz")
    return folder


def fit(place: Path, log: str, out: Path, *words: str) -> int:
    options = ["--method", "gauss-newton", "--groups", "damping", "--groups", "mass", "--threads", "1", *words]
    return main(["fit", str(place / "arm.xml"), "--data", str(place / f"{log}.npz"), "--out", str(out), *options])


@pytest.fixture(scope="module", params=[("states", "1"), ("positions", "20")])
def folder(request: pytest.FixtureRequest, place: Path) -> Path:
    log, horizon = request.param
    assert fit(place, log, place / log, "--horizon", horizon) == 0
    return place / log


def pictures(page: str) -> dict[str, Image.Image]:
    """The picture of each section that has one."""
    found = {}
    for section in re.findall(r"<section id=.*?</section>", page, re.S):
        for kind in re.findall(r'src="data:image/png;base64,([^"]+)"', section):
            name = re.match(r'<section id="(\w+)"', section)
            assert name
            found[name[1]] = Image.open(io.BytesIO(base64.b64decode(kind)))
    return found


def test_the_page_is_whole_in_one_file(folder: Path) -> None:
    page = (folder / "page.html").read_text()
    assert "http" not in page
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page)
    assert not re.findall(r"url\(|<script|<link rel=\"stylesheet|@import", page)
    assert page.count("<img") == len(pictures(page))


def test_each_section_has_a_picture(folder: Path) -> None:
    page = (folder / "page.html").read_text()
    found = pictures(page)
    directions = json.loads((folder / "fit.json").read_text())["report"]["flat_directions"]
    together = any(len(direction["parameters"]) > 1 for direction in directions)
    assert set(found) == {name for name in NAMES if name != "together" or together}
    for picture in found.values():
        assert picture.width > 900
        assert np.asarray(picture.convert("L")).std() > 5  # something is drawn


def test_it_begins_with_the_verdict_of_the_report(folder: Path) -> None:
    page, report = (folder / "page.html").read_text(), (folder / "report.txt").read_text()
    heading = re.search(r"<h1>(.*)</h1>", page)
    assert heading
    assert heading[1].startswith(report.splitlines()[0])
    assert "times better than the file" in heading[1]


def test_the_fit_that_is_shown_has_not_seen_the_seconds(folder: Path) -> None:
    page = (folder / "page.html").read_text()
    assert "fitted without them" in page
    held = json.loads((folder / "fit.json").read_text())
    assert held["report"]["course"][0]["name"] == "polish"
    counts, best = np.array(held["report"]["course"][0]["best"]).T
    assert (np.diff(counts) >= 0).all()
    assert best[-1] < best[0]
    assert held["report"]["mjcf"] == {"file": "fitted.xml", "missing": []}
    fitted = mujoco.MjModel.from_xml_path(str(folder / "fitted.xml"))
    assert fitted.dof_damping[0] == pytest.approx(held["parameters"]["damping.hip"]["value"], rel=1e-5)


def test_a_killed_fit_leaves_no_page_and_resuming_makes_it(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*_: object) -> None:
        raise RuntimeError("killed")

    with monkeypatch.context() as patch:
        patch.setattr(import_module("cmbrl.fitting.fit"), "conclude", killed)
        with pytest.raises(RuntimeError, match="killed"):
            fit(place, "states", tmp_path / "run")
    assert (tmp_path / "run/state.json").exists()
    assert not {"page.html", "fitted.xml", "fit.json"} & {entry.name for entry in (tmp_path / "run").iterdir()}
    assert fit(place, "states", tmp_path / "run", "--resume") == 0
    assert set(pictures((tmp_path / "run/page.html").read_text())) >= {"motion", "residuals", "course"}


def test_a_folder_that_cannot_take_the_page_keeps_its_files(folder: Path, tmp_path: Path) -> None:
    result = FitResult.load(folder)
    (tmp_path / "page.html").mkdir()
    (tmp_path / "fit.json").write_text("older")
    with pytest.raises(UserError, match=r"page\.html"):
        result.save(tmp_path)
    assert {entry.name for entry in tmp_path.iterdir()} == {"page.html", "fit.json"}
    assert (tmp_path / "fit.json").read_text() == "older"


def test_a_fit_read_from_its_folder_says_that_it_has_no_unseen_seconds(folder: Path, tmp_path: Path) -> None:
    FitResult.load(folder).save(tmp_path / "copy")
    page = (tmp_path / "copy/page.html").read_text()
    assert "there are no unseen seconds to show" in page
    assert {"parameters", "course"} <= set(pictures(page))


def test_at_most_twelve_coordinates_are_drawn_and_the_worst_ones() -> None:
    draw, nv = np.random.default_rng(0), 20
    names = tuple(f"joint{k}" for k in range(nv))
    scene = SimpleNamespace(coordinate_names=names, coordinate_kinds=("angle",) * nv)
    logged = draw.normal(size=(30, nv))
    error = np.linspace(0.01, 1.0, nv)
    window = Window(logged, logged + 2 * error, logged + error)
    assert motion(scene, [window], 0.01)[1] == list(names[-MOST:])
    rows = draw.normal(size=(5, 200, nv))
    found = OneStep(rows[0], rows[1] * error, np.full((200, nv), np.nan), rows[2], rows[3], rows[4, :, 0], np.ones(nv))
    assert residuals(scene, found)[1] == list(names[-6:])


@pytest.mark.parametrize(("gap", "panels"), [(0.3, 3), (0.001, 4)])
def test_residuals_show_gaps_that_matter_and_no_strokes_out_of_the_picture(gap: float, panels: int) -> None:
    draw = np.random.default_rng(0)
    scene = SimpleNamespace(coordinate_names=("joint",), coordinate_kinds=("angle",))
    before, after, command, speed, position = draw.normal(size=(5, 200, 1))
    found = OneStep(before + 100 * position, after, command, speed, position, np.full(200, gap), np.ones(1))
    axes = residuals(scene, found)[0].axes
    assert len(axes) == panels
    against = next(line for line in axes[2].lines if line.get_label() == "file")
    drawn = np.asarray(against.get_ydata(), dtype=float)
    assert np.isnan(drawn).any()
    assert np.nanmax(np.abs(drawn), initial=0.0) <= axes[2].get_ylim()[1]


OF_MANY = {"data": {"transitions": 1000}}
HARDLY = {"held out, nominal": {"rmse": 0.2}, "held out, fitted": {"rmse": 0.1}}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, "10 times better than the file (an error over 1 step of 0.02 instead of 0.2)."),
        ({"at_bound": ["mass.a"]}, "; 1 parameter lies on a bound."),
        ({"horizon": 5}, "over 5 steps"),
        ({"fitted": []}, "Nothing was fitted: the file explains the log as well."),
        ({"fitted": [], "stopped": "interrupted"}, "Nothing was fitted: no parameter had moved yet."),
        ({"loss": {}}, "has not been judged"),
        ({"stopped": "time limit"}, "instead of 0.2). Stopped early (time limit)."),
        ({"stopped": "time limit", "loss": HARDLY}, "Stopped early (time limit). The fit predicts"),
        ({"loss": {"held out, nominal": {"rmse": 0.2}, "held out, fitted": {"rmse": 0.3}}}, "worse than the file"),
        ({"loss": {"held out, nominal": {"rmse": 0.2}, "held out, fitted": {"rmse": 0.199}}}, "about as well as the"),
        ({"set": ["mass.a"]}, "10 times better than the start (--set) (an error"),
        ({"set": ["mass.a"], "fitted": []}, "Nothing was fitted: the start (--set) explains the log as well."),
    ],
)
def test_the_verdict(change: dict, words: str) -> None:
    loss = {"held out, nominal": {"rmse": 0.2}, "held out, fitted": {"rmse": 0.02}}
    report = {"loss": loss, "fitted": ["mass.a"], "horizon": 1, "stopped": None, "at_bound": [], **OF_MANY}
    assert words in first_line({**report, **change})


@pytest.mark.parametrize(
    ("short", "far", "words"),
    [
        ((0.37, 0.1), (0.7, 0.02), "3.7 times better than the file (an error over 5 steps of 0.1 instead of 0.37 devi"),
        ((0.37, 0.1), (0.7, 0.02), " deviations of the change), 35 times over 99 steps: "),
        ((0.1, 0.0995), (0.7, 0.02), "), 35 times over 99 steps: 0.02 instead of 0.7 deviations of the states."),
        ((0.37, 0.1), (1e300, 0.02), "change); over 99 steps it errs by 0.02 instead of 1e+300 deviations of the"),
        ((0.37, 0.1), (8.0, 2.0), "; over 99 steps it errs by 2 instead of 8 deviations of the states. Over 99"),
    ],
)  # fmt: skip
def test_what_a_long_prediction_gains_is_told_beside_a_short_one(
    short: tuple[float, float], far: tuple[float, float], words: str
) -> None:
    loss = {f"held out, {name}": {"rmse": x} for name, x in zip(("nominal", "fitted"), short, strict=True)}
    both = dict(zip(("nominal", "fitted"), far, strict=True))
    row = {"steps": 99, "rmse": {"hold": 9.0, **both}, "loss": {"hold": 9.0, **both}, "estimated": True}
    told = {"loss": loss, "fitted": ["mass.a"], "horizon": 5, "stopped": None, "at_bound": [], "horizons": [row]}
    report = {**told, **OF_MANY}
    assert words in first_line(report)


def test_errors_of_a_horizon_are_those_of_the_table() -> None:
    """The loss has another unit: the same horizon would have two errors, in the first line and in the table."""
    loss = {f"held out, {name}": {"rmse": x} for name, x in (("nominal", 2.6), ("fitted", 0.776))}
    errors = {5: (0.27, 0.15), 20: (0.55, 0.26), 100: (0.32, 0.107)}
    rows = [
        {"steps": steps, **{of: {"hold": 0.9, "nominal": before, "fitted": after} for of in ("rmse", "loss")}}
        for steps, (before, after) in errors.items()
    ]
    told = {"loss": loss, "fitted": ["mass.a"], "horizon": 20, "stopped": None, "at_bound": [], "horizons": rows}
    assert first_line({**told, **OF_MANY}) == (
        "The fit predicts unseen seconds 2.12 times better than the file (an error over 20 steps of 0.26 instead of "
        "0.55), 2.99 times over 100 steps: 0.107 instead of 0.32."
    )
    worse = [{**row, "rmse": {**row["rmse"], "fitted": 9.0}} for row in rows]
    assert (
        "it loses to holding the velocity over 5, 20, 100 step(s) by RMSE, and to the start (--set) as it is over"
        in (first_line({**told, **OF_MANY, "horizons": worse, "set": ["mass.a"]}))
    )
