"""The error table against errors put there by hand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl import Scene, Transitions, UserError
from cmbrl.accuracy.compare import compare
from cmbrl.accuracy.laws import laws_told
from cmbrl.accuracy.named_models import build_models, common_source
from cmbrl.accuracy.plots import plot
from cmbrl.models.baselines import Ballistic, HoldVelocity
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.source import Source, load_source

DT = 0.01
CUBE = """<mujoco><worldbody><geom type="plane" size="5 5 .1"/>
<body pos="0 0 1"><freejoint/><geom type="box" size=".1 .1 .1"/></body></worldbody></mujoco>"""
ARM = """<mujoco><worldbody><geom type="plane" size="5 5 .1" pos="0 0 -3"/><body>
<joint name="j" type="hinge" axis="0 1 0"/><geom size=".1" pos="0 0 -1"/></body></worldbody>
<actuator><motor joint="j"/></actuator></mujoco>"""


@pytest.fixture
def cube(tmp_path: Path) -> Scene:
    (tmp_path / "cube.xml").write_text(CUBE, encoding="utf-8")
    return Scene.from_mjcf(tmp_path / "cube.xml")


def tosses(scene: Scene, episodes: int = 3, rows: int = 40) -> Transitions:
    """Bodies that move at constant acceleration, exactly as `Ballistic` steps, with random spins; none touches."""
    rng = np.random.default_rng(0)
    parts: dict[str, list[np.ndarray]] = {k: [] for k in ("q", "v", "q_next", "v_next")}
    for _ in range(episodes):
        q, v = scene.q0 + np.eye(scene.nq)[2] * 2.0, rng.normal(size=scene.nv)
        for _ in range(rows):
            v_next = v.copy()
            v_next[2] -= DT * 9.81
            q_next = scene.integrate(q, DT * v_next)
            for name, value in (("q", q), ("v", v), ("q_next", q_next), ("v_next", v_next)):
                parts[name].append(value)
            q, v = q_next, v_next
    stacked = {name: np.array(values) for name, values in parts.items()}
    return Transitions(**stacked, u=np.zeros((episodes * rows, 0)), dt=DT, episode=np.repeat(np.arange(episodes), rows))


class Offset:
    """The true motion, with a fixed error in the vertical velocity of every step."""

    name = "offset"

    def __init__(self, scene: Scene, error: float) -> None:
        self.dt, self.inner, self.error, self.failures = DT, Ballistic(scene, DT), error, 0

    def reset_failures(self) -> None:
        self.failures = 0

    def step(self, q: torch.Tensor, v: torch.Tensor, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        self.failures += len(q)
        q_next, v_next = self.inner.step(q, v, u)
        v_next = v_next.clone()
        v_next[:, 2] += self.error
        return q_next, v_next


class Broken(Offset):
    """Predicts nothing at all for a body that rises."""

    def step(self, q: torch.Tensor, v: torch.Tensor, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        q_next, v_next = super().step(q, v, u)
        return q_next, torch.where(v[:, 2:3] > 0, torch.nan, v_next)


def test_exact_model_has_no_error_at_any_horizon(cube: Scene) -> None:
    table = compare({"exact": Ballistic(cube, DT), "hold": HoldVelocity(cube, DT)}, tosses(cube), cube)
    assert [h.steps for h in table.horizons] == [1, 5, 20]  # no episode holds 100 rows
    assert all(table.entry("exact", k).error < 1e-12 for k in (1, 5, 20))
    assert table.entry("hold", 20).error > 0.1
    assert table.horizons[0].windows == {"all": 120, "flight": 120}
    assert table.horizons[2].windows["all"] == 3 * (40 - 20 + 1)


def test_definitions(cube: Scene) -> None:
    data, wrong = tosses(cube), 0.25
    table = compare({"offset": Offset(cube, wrong)}, data, cube, horizons=(1, 4))
    one = table.entry("offset", 1)
    change = np.hstack([cube.difference(data.q, data.q_next), data.v_next - data.v]).std(axis=0)
    # spins stay and all fall alike, so no change of velocity varies: an error in velocity has no scale at one step
    assert (change > 1e-9).tolist() == [True] * 6 + [False] * 6
    assert one.error < 1e-12
    assert one.physical["position_velocity"] == pytest.approx(wrong)
    assert one.physical["position"] == pytest.approx(0.0, abs=1e-12)
    four = table.entry("offset", 4)
    height_error = DT * wrong * (1 + 2 + 3)
    assert four.physical["position"] == pytest.approx(height_error)
    parts = height_error / data.q[:, 2].std(), 4 * wrong / data.v[:, 2].std()
    assert four.error == pytest.approx(np.hypot(*parts) / np.sqrt(12))
    assert four.failures == 4 * four.windows
    assert table.curves["offset"][-1] == pytest.approx(four.error)


def test_strata_and_penetration(cube: Scene) -> None:
    data = tosses(cube, episodes=1, rows=30)
    q = np.zeros_like(data.q)
    q[:, 3], q[:, 2] = 1.0, 0.5  # upright, well above the floor ...
    q[10:, 2] = 0.1  # ... then lying on it
    v = np.zeros_like(data.v)
    v[:, 0], v[20:, 0] = 1.0, 0.0
    q[:, 0] = np.concatenate([[0], np.cumsum(DT * v[:-1, 0])])
    rest = Transitions(q=q[:-1], v=v[:-1], u=data.u[:-1], q_next=q[1:], v_next=v[1:], dt=DT, episode=data.episode[:-1])
    table = compare({"fall": Ballistic(cube, DT)}, rest, cube, horizons=(1, 5), contact_gap=1e-3)
    assert table.horizons[0].windows == {
        **{"all": 29, "flight": 9, "contact": 20},
        **{"contact, moving": 11, "contact, resting": 9},
    }
    assert table.horizons[1].windows == {
        **{"all": 25, "flight": 5, "contact": 20},
        **{"contact, moving": 15, "contact, resting": 5},
    }
    resting = table.entry("fall", 5, "contact, resting")
    fallen = 9.81 * DT**2 * np.arange(1, 6).cumsum()  # into the floor, as nothing holds it up
    assert resting.penetration_max_mm == pytest.approx(1e3 * fallen[-1])
    assert resting.penetration_mean_mm == pytest.approx(1e3 * fallen.mean())
    assert table.horizons[1].logged_penetration_max_mm == pytest.approx(0.0, abs=1e-9)


def test_a_diverged_model_is_seen(cube: Scene) -> None:
    data = tosses(cube)
    table = compare({"broken": Broken(cube, 0.0)}, data, cube, horizons=(5,))
    entry = table.entry("broken", 5)
    assert entry.diverged == int((data.v[data.windows(5), 2] > 0).sum()) > 0
    assert entry.error == float("inf")
    assert table.to_json()["entries"][0]["error"] is None
    json.dumps(table.to_json(), allow_nan=False)
    assert "inf" in table.text()


def test_windows_are_thinned_beyond_one_step(cube: Scene) -> None:
    table = compare({"hold": HoldVelocity(cube, DT)}, tosses(cube), cube, horizons=(1, 5), max_windows=7)
    assert [h.windows["all"] for h in table.horizons] == [120, 7]


def test_text_and_plot(tmp_path: Path, cube: Scene) -> None:
    models = {"hold velocity": HoldVelocity(cube, DT), "exact": Ballistic(cube, DT)}
    shares: list[float] = []
    table = compare(models, tosses(cube), cube, progress=lambda share, text: shares.append(share))
    assert shares == sorted(shares)
    text = table.text()
    assert "normalised error by horizon" in text
    assert "20 steps (200 ms)" in text
    assert all(len(line) == len(line.rstrip()) for line in text.splitlines())
    assert max(map(len, text.splitlines())) <= 100
    plot(table, tmp_path / "error.svg")
    drawn = (tmp_path / "error.svg").read_text(encoding="utf-8")
    for words in (*models, "steps predicted open loop", "flight"):
        assert f"<!-- {words}" in drawn


def test_wide_tables_continue_below_and_lose_no_column(cube: Scene) -> None:
    models = {f"runs/fits/of/the/cube/number/{k}": HoldVelocity(cube, DT) for k in range(3)}
    table = compare(models, tosses(cube), cube)
    text = table.text()
    assert max(map(len, text.splitlines())) <= 100
    for head in ("error", "median", "us/step", "position", "rotation", "velocity", "spin", "nothing touches"):
        assert head in text
    for head in ("diverged", "failed", "angle ", "flight", "pen."):  # empty everywhere, or nothing but all of it
        assert head not in text
    assert text.count("he/cube/number/2") > 4


def test_angles_are_reported_per_joint(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM, encoding="utf-8")
    arm = Scene.from_mjcf(tmp_path / "arm.xml")
    q = np.linspace(0, 1, 12)[:, None] ** 2
    v, u = np.diff(q, axis=0) / DT, np.zeros((10, 1))
    data = Transitions(q=q[:10], v=v[:10], u=u, q_next=q[1:11], v_next=v[1:11], dt=DT, episode=np.zeros(10))
    table = compare({"hold": HoldVelocity(arm, DT)}, data, arm, horizons=(1,))
    entry = table.entry("hold", 1)
    assert set(entry.physical) == {"angle", "angle_velocity"}
    assert entry.physical["angle_velocity"] == pytest.approx(np.sqrt(np.mean((v[1:11] - v[:10]) ** 2)))
    assert list(table.horizons[0].windows) == ["all", "flight"]


def test_refusals(cube: Scene) -> None:
    data = tosses(cube)
    with pytest.raises(UserError, match=r"slow: steps 0.02 s, the log 0.01 s"):
        compare({"slow": HoldVelocity(cube, 0.02)}, data, cube)
    with pytest.raises(UserError, match="horizons"):
        compare({"hold": HoldVelocity(cube, DT)}, data, cube, horizons=(0, 5))
    still = Transitions(
        q=data.q[[0] * 5], v=0 * data.v[:5], u=data.u[:5], q_next=data.q[[0] * 5], v_next=0 * data.v[:5], dt=DT,
        episode=data.episode[:5],
    )  # fmt: skip
    with pytest.raises(UserError, match="nothing changes"):
        compare({"hold": HoldVelocity(cube, DT)}, still, cube)


def test_every_law_is_told(cube: Scene) -> None:
    file = ComplementarityModel(cube)
    ms = 1e3 * file.time_step
    law, doubt = laws_told({"hold": HoldVelocity(cube, 0.01), "nominal": file}, ["hold", "nominal"])
    assert law == f"law of sliding: exact Coulomb, time step {ms:g} ms: nominal"
    assert doubt.startswith("nominal: if MuJoCo made the log")
    assert "--sliding convex" in doubt
    assert laws_told({"nominal": file}, ["nominal"], doubt=False) == [law]
    convex = {"nominal": file.with_settings(sliding="convex")}
    assert laws_told(convex, ["nominal"]) == [f"law of sliding: MuJoCo's convex law, time step {ms:g} ms: nominal"]
    both = laws_told({"fit": file, **convex}, ["runs/fit", "nominal"])  # a fit's law is its own choice
    assert [line.rpartition(": ")[2] for line in both] == ["fit", "nominal"]


def test_files_step_and_slide_as_the_first_fit_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, dt in (("puck", 0.004), ("other", 0.001)):
        (tmp_path / f"{name}.xml").write_text(
            CUBE.replace("<worldbody>", f'<option timestep="{dt}"/><worldbody>'), encoding="utf-8"
        )
    own = load_source(str(tmp_path / "puck.xml")).scene
    fit = ComplementarityModel(own, substeps=5, time_step=0.002, sliding="convex")
    fit = ComplementarityModel.from_config(own, fit.to_config())  # as it is loaded
    monkeypatch.setattr("cmbrl.models.named.saved_model", lambda *_, **__: fit)
    monkeypatch.setattr("cmbrl.models.named.load_complementarity", lambda *_: fit)
    monkeypatch.setattr("cmbrl.models.named.in_own_file", lambda found, _: found)
    monkeypatch.setattr("cmbrl.models.named.task_of_fit", lambda _: None)
    monkeypatch.setattr("cmbrl.models.named.holds_fit", lambda word: word == str(tmp_path))
    words = [str(tmp_path), "nominal", str(tmp_path / "other.xml")]
    log = tosses(own)
    for scene in (None, str(tmp_path / "puck.xml")):
        found = build_models(words, common_source(words, scene), log, 1)
        assert {(one.sliding, one.look_ahead, one.time_step) for one in found.values()} == {("convex", False, 0.002)}
        assert found["other"].scene.name == "other"
    given = build_models(words, common_source(words), log, 1, sliding="coulomb")
    assert [(one.sliding, one.look_ahead) for one in given.values()] == [("convex", False), *[("coulomb", True)] * 2]
    under = common_source(words, str(tmp_path / "puck.xml"), contact_law="rigid")
    assert build_models(words[1:], under, log, 1)["nominal"].sliding == "coulomb"


@pytest.mark.parametrize("dt", [0.0334628, 0.01])
def test_a_fit_of_another_rate_steps_as_the_log_does(
    dt: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Recordings whose stamps jitter differ in their rate by a little."""
    (tmp_path / "arm.xml").write_text(ARM)
    source = load_source(str(tmp_path / "arm.xml"))
    fit = ComplementarityModel(source.scene).for_log(0.0334168)
    monkeypatch.setattr("cmbrl.models.named.saved_model", lambda *_, **__: fit)
    q, v, u = (torch.full((1, 1), value, dtype=torch.float64) for value in (0.3, 0.0, 0.2))
    states = [(q, v)]
    for _ in range(40):
        states.append(fit.at(dt).step(*states[-1], u))
    rows_q, rows_v = (torch.cat(part).numpy() for part in zip(*states, strict=True))
    steps = {"u": np.full((40, 1), 0.2), "episode": np.zeros(40, dtype=int), "dt": dt}
    log = Transitions(q=rows_q[:-1], v=rows_v[:-1], q_next=rows_q[1:], v_next=rows_v[1:], **steps)
    of_fit = Source("fit", source.scene, fitted=fit)  # as without --scene: the file steps as the fit does
    models = build_models(["fit", "nominal"], of_fit, log, 1)
    for name in models:
        assert compare(models, log, source.scene, horizons=(1, 5)).entry(name, 5).error < 1e-9
