"""A fit takes the law of sliding that the log supports, if that is clear and the choice is open, and says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import cmbrl
from cmbrl.contact import Exact, Relaxed
from cmbrl.data.position_log import PositionLog
from cmbrl.data.transitions import Transitions
from cmbrl.fitting import FitResult
from cmbrl.fitting.budget import Budget
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.sliding import rivals, supported_sliding
from cmbrl.fitting.log.survey import Surveyor
from cmbrl.fitting.outcome.report_text import render
from cmbrl.fitting.state import Journal, OutOfTime
from cmbrl.models.named import nominal_model
from cmbrl.registry import load_task

from .pushed_box import PUSHER, pushes
from .test_fit_hidden import recorded, scene

QUICK = Budget(polish_rows=600, polish_iterations=4, fold_iterations=2, survey_rows=200, survey_iterations=2)
PUCK = """<mujoco><option timestep=".004" cone="elliptic"/><worldbody><geom type="plane" size="9 9 .1" friction=".6"/>
<body name="puck" pos="0 0 .05"><freejoint/><geom type="box" size=".2 .2 .05" mass="2" friction=".6"/><site name="s"/>
</body></worldbody><actuator><motor site="s" gear="30 0 0 0 0 0"/><motor site="s" gear="0 20 0 0 0 0"/></actuator>
</mujoco>"""


def log_of(folder: Path) -> tuple[cmbrl.ComplementarityModel, Transitions]:
    """A pushed puck in MuJoCo, whose steps are of the convex law."""
    return cmbrl.ComplementarityModel(scene(folder, PUCK)), recorded(PUCK, 1, 6, 100, 0, 1.0)


def chosen(model: cmbrl.ComplementarityModel, log: Transitions | PositionLog) -> tuple[str, dict[str, Any] | None]:
    """The law of sliding that the log supports, and what is told of it."""
    evidence = Evidence.of(model, log)
    begin = np.zeros(len(evidence.space))
    surveyor = Surveyor(evidence, evidence.space.default, begin, 0.5, 3, 0, 200, 2, Journal(None, ""))
    found = supported_sliding(surveyor, (1, 4, 10, 20))
    return found.evidence.model.sliding, found.told


def test_the_law_that_the_log_supports_is_taken(tmp_path: Path) -> None:
    model, log = log_of(tmp_path)
    found, told = chosen(model, log)
    assert found == "convex"
    assert told is not None
    assert told["taken"]
    exact = model.predict(log.q, log.v, log.u)
    ours = replace(log, q_next=exact.q_next, v_next=exact.v_next, episode=np.arange(len(log)))
    kept, told = chosen(model, ours)
    assert kept == "coulomb"
    assert told is not None
    assert told["relative_error"] > 1.0


def poses(model: cmbrl.ComplementarityModel, log: Transitions, above: float) -> PositionLog:
    """The poses of the puck in ``log``, as if it had been ``above`` the table [m]."""
    return PositionLog(
        time=log.dt * np.arange(len(log)), position=np.zeros((len(log), 0)), joint_names=(), command=log.u,
        actuator_names=model.scene.actuator_names, command_kind="torque", episode=log.episode,
        base=log.q + above * (np.arange(7) == 2),
    )  # fmt: skip


@pytest.mark.parametrize("above", [0.0, 1.0])
def test_positions_alone_are_fitted_for_a_choice_where_something_touches(above: float, tmp_path: Path) -> None:
    """Which law such poses support hangs on how far fits get: exact ones of six slides tell hardly more of either."""
    model, log = log_of(tmp_path)
    found, told = chosen(model, poses(model, log, above))
    assert (told is None) == bool(above)
    assert found == ("convex" if told is not None and told["taken"] else "coulomb")


def captured(base: np.ndarray) -> np.ndarray:
    """Poses (T, 7) with noise of 0.3 mm and 1 mrad."""
    rng = np.random.default_rng(0)
    place, turn = 3e-4 * rng.standard_normal((len(base), 3)), 5e-4 * rng.standard_normal((len(base), 3))
    noisy = base + np.hstack([place, np.zeros((len(base), 1)), turn])
    noisy[:, 3:] /= np.linalg.norm(noisy[:, 3:], axis=1, keepdims=True)
    return noisy


def test_noisy_poses_of_a_world_of_exact_coulomb_keep_it(tmp_path: Path) -> None:
    model, log = log_of(tmp_path)
    rows, (q, v) = [], (log.q[:1], log.v[:1])
    for k in range(len(log)):  # the same pushes, and the same starts of episodes
        if log.episode[k] != log.episode[k - 1]:
            q, v = log.q[k : k + 1], log.v[k : k + 1]
        rows.append(q[0])
        step = model.predict(q, v, log.u[k : k + 1])
        q, v = step.q_next, step.v_next
    found, told = chosen(model, replace(poses(model, log, 0.0), base=captured(np.array(rows))))
    assert found == "coulomb"
    assert told is not None


def test_all_laws_that_are_open_are_tried(tmp_path: Path) -> None:
    """Of positions, MuJoCo's step alone: what stands in for shapes may hold fingers that pass each other there."""
    model, log = log_of(tmp_path)
    states, positions = (rivals(Evidence.of(model, each)) for each in (log, poses(model, log, 0.0)))
    assert list(states) == ["mujoco", "convex"]
    assert list(positions) == ["mujoco"]
    assert (states["convex"].sliding, states["convex"].look_ahead) == ("convex", model.look_ahead)
    assert (states["mujoco"].sliding, states["mujoco"].look_ahead) == ("convex", False)
    assert positions["mujoco"].to_config() == states["mujoco"].to_config()


def test_a_file_that_asks_for_rk4_is_tried_under_it(tmp_path: Path) -> None:
    """Unless the integrator was named; a policy is trained by one solve a step. The puck may spin by itself."""
    open_scene = scene(tmp_path, PUCK.replace('timestep=".004"', 'timestep=".004" integrator="RK4"'))
    soft = Relaxed(3e-4)
    model = cmbrl.ComplementarityModel(open_scene, smoothing=soft)
    theirs = model.rivals()["mujoco"]
    assert (model.integrator, theirs.integrator, theirs.smoothing) == ("midpoint", "rk4", Exact())
    trained = theirs.for_training(soft, model)
    assert (trained.integrator, trained.look_ahead, trained.sliding) == ("midpoint", True, "convex")
    assert trained.smoothing == trained.backward_smoothing == soft
    by_euler = cmbrl.ComplementarityModel(scene(tmp_path, PUCK)).rivals()["mujoco"]
    assert not by_euler.look_ahead
    assert by_euler.for_training(soft, model).look_ahead
    named = cmbrl.ComplementarityModel(open_scene, integrator="leapfrog")
    assert list(named.rivals()) == ["convex"]
    assert list(model.with_settings(time_step=0.008).rivals()) == ["mujoco", "convex"]
    long = cmbrl.ComplementarityModel(scene(tmp_path, PUCK), time_step=0.008)
    assert list(long.rivals()) == ["convex"]
    assert not cmbrl.ComplementarityModel(open_scene, sliding="coulomb").rivals()
    assert not theirs.rivals()


def test_a_task_in_shorter_steps_than_its_file_is_tried_under_the_file_s() -> None:
    """Ant's model takes Euler steps of 5 ms for its policies, its file RK4 steps of 10 ms."""
    task = load_task("ant")
    model, log = nominal_model(task, threads=1), task.record(100, seed=1)
    theirs = model.rivals()["mujoco"]
    q, v = theirs.step(*(torch.from_numpy(x) for x in (log.q, log.v, log.u)))
    assert np.abs(q.numpy() - log.q_next).max() < 1e-6
    assert np.abs(v.numpy() - log.v_next).max() < 1e-5
    assert (theirs.dt, model.dt) == pytest.approx((log.dt, log.dt))
    trained = theirs.for_training(model.smoothing, model)
    assert trained.to_config() == model.to_config()
    assert list(model.with_settings(time_step=0.01, substeps=5).rivals()) == []


@pytest.mark.parametrize(
    ("short", "long", "taken"), [(0.8, None, True), (1.3, None, False), (0.98, 0.9, True), (0.92, 1.0, False)]
)
def test_both_fits_go_on_where_they_hardly_differ(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, short: float, long: float | None, taken: bool
) -> None:
    asked = []

    def score_at(surveyor: Surveyor, z: np.ndarray) -> float:
        asked.append(longer := bool(z.any()))
        error = long if longer else short
        assert error is not None
        return float(np.log(error)) if surveyor.label else 0.0

    monkeypatch.setattr(Surveyor, "in_time", lambda surveyor, steps: {steps: np.zeros_like(surveyor.begin)})
    monkeypatch.setattr(Surveyor, "fitted_to", lambda surveyor, _, longer: np.full_like(surveyor.begin, longer))
    monkeypatch.setattr(Surveyor, "score_at", score_at)
    monkeypatch.setattr(Surveyor, "explains", lambda *_: False)
    found, told = chosen(*log_of(tmp_path))
    assert told is not None
    assert told["taken"] == taken == (found == "convex")
    assert any(asked) == (long is not None)


@pytest.mark.parametrize(
    ("short", "on", "taken"), [(1.9, 0.7, True), (1.3, 1.1, False), (0.5, None, True), (4, None, False)]
)
def test_of_positions_a_law_that_lags_goes_on_from_where_the_own_one_led(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, short: float, on: float | None, taken: bool
) -> None:
    begins: dict[str, float] = {}

    def score_at(surveyor: Surveyor, _: np.ndarray) -> float:
        begins[surveyor.label] = surveyor.begin[0]
        error = on if "on, " in surveyor.label else short
        assert error is not None
        return float(np.log(error)) if surveyor.label.startswith("mujoco") else 0.0

    monkeypatch.setattr(Surveyor, "in_time", lambda surveyor, steps: {steps: surveyor.begin})
    monkeypatch.setattr(Surveyor, "score_at", score_at)
    monkeypatch.setattr(Surveyor, "fitted_to", lambda surveyor, _, longer=False: surveyor.begin + 0.25)
    model, log = log_of(tmp_path)
    found, told = chosen(model, poses(model, log, 0.0))
    assert told is not None
    assert told["taken"] == taken == (found == "convex")
    first, further = {"mujoco: ": 0.0, "": 0.0}, {"mujoco: on, ": 0.25, "on, ": 0.25}
    assert begins == (first if on is None else first | further)


@pytest.mark.parametrize(("noise", "then"), [(0.0, [4, 4]), (1e-4, [10, 20])])
def test_fits_of_a_noisy_log_go_on_over_more_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, noise: float, then: list[int]
) -> None:
    """Over four, a law that takes the noise away from what rests may seem as good as the law that pushes a box."""
    evidence = Evidence.of(
        cmbrl.ComplementarityModel(scene(tmp_path, PUSHER.format(floor=0.6, mass=0.4))), pushes(12, 60, noise)
    )
    horizons: list[int] = []

    def fitted(_: Surveyor, name: str, horizon: int, noise: np.ndarray | None, z: np.ndarray, *others: Any, **__: Any):
        horizons.append(horizon)
        return z

    monkeypatch.setattr(Surveyor, "_fit", fitted)
    begin = np.zeros(len(evidence.space))
    surveyor = Surveyor(evidence, evidence.space.default, begin, 0.5, 4, 0, 2000, 8, Journal(None, ""))
    surveyor.fitted_to(4, longer=True)
    assert horizons == [1, 4, *then]


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_a_box_that_is_pushed_tells_the_law(tmp_path: Path, noise: float) -> None:
    """Its corners touch and leave within four steps: a fit over these moves only from where one over a step has led.

    With noise it moves only if windows start free of it: a tenth of a millimetre shakes a box that lies on its corners.
    """
    evidence = Evidence.of(
        cmbrl.ComplementarityModel(scene(tmp_path, PUSHER.format(floor=0.6, mass=0.4))), pushes(12, 60, noise)
    )
    begin = np.zeros(len(evidence.space))
    surveyor = Surveyor(evidence, evidence.space.default, begin, 0.5, 4, 0, 2000, 8, Journal(None, ""))
    found = supported_sliding(surveyor, (1, 4, 10, 20))
    assert found.told is not None
    assert found.told["relative_error"] < 0.85
    assert found.evidence.model.sliding == "convex"


@pytest.mark.parametrize(
    ("theirs", "ours", "told"),
    [((1, 4), (1, 4), 4), ((1, 4), (1,), 1), ((1,), (1, 4), 1), ((1, 4), (), None), ((), (1, 4), None)],
)
def test_laws_are_compared_as_far_as_there_was_time_for_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, theirs: tuple[int, ...], ours: tuple[int, ...], told: int | None
) -> None:
    """MuJoCo's step first, which the logs of simulators call for."""

    def in_time(surveyor: Surveyor, _: int) -> dict[int, np.ndarray]:
        steps = {"": ours, "mujoco: ": theirs}.get(surveyor.label, ())
        return {h: np.full_like(surveyor.begin, h) for h in steps}

    monkeypatch.setattr(Surveyor, "in_time", in_time)
    monkeypatch.setattr(Surveyor, "score_at", lambda surveyor, z: -z[0] if surveyor.label else 0.0)
    monkeypatch.setattr(Surveyor, "explains", lambda *_: False)
    found = supported_sliding(pushed(tmp_path), (1, 4)).told
    error = (
        None if told is None else {"tried": "mujoco", "own": "coulomb", "relative_error": np.exp(-told), "taken": True}
    )
    assert found == error


def test_a_law_that_explains_the_log_is_taken_without_time_for_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def in_time(surveyor: Surveyor, steps: int) -> dict[int, np.ndarray]:
        return {steps: surveyor.begin} if surveyor.label == "mujoco: " else {}

    monkeypatch.setattr(Surveyor, "in_time", in_time)
    monkeypatch.setattr(Surveyor, "score_at", lambda *_: -9.0)
    monkeypatch.setattr(Surveyor, "explains", lambda *_: True)
    found = supported_sliding(pushed(tmp_path), (1, 4))
    assert found.told is not None
    assert (found.told["tried"], found.told["taken"]) == ("mujoco", True)


def test_fits_that_time_ends_are_known_as_far_as_they_went(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fitted(_: Surveyor, name: str, horizon: int, noise: np.ndarray | None, z: np.ndarray, *others: Any, **__: Any):
        if horizon > 1:
            raise OutOfTime
        return z + 1.0

    monkeypatch.setattr(Surveyor, "_fit", fitted)
    surveyor = pushed(tmp_path)
    found = surveyor.in_time(4)
    assert list(found) == [1]
    np.testing.assert_array_equal(found[1], surveyor.begin + 1.0)


def pushed(folder: Path) -> Surveyor:
    """Of a box that was pushed."""
    model = cmbrl.ComplementarityModel(scene(folder, PUSHER.format(floor=0.6, mass=0.4)))
    evidence = Evidence.of(model, pushes(4, 60))
    begin = np.zeros(len(evidence.space))
    return Surveyor(evidence, evidence.space.default, begin, 0.5, 4, 0, 2000, 8, Journal(None, ""))


def test_where_a_law_explains_the_log_the_others_are_not_surveyed(tmp_path: Path) -> None:
    """The own is fitted plainly, to say how much better that law is."""
    model, log = log_of(tmp_path)
    evidence, journal = Evidence.of(model, log), Journal(None, "")
    begin = np.zeros(len(evidence.space))
    found = supported_sliding(Surveyor(evidence, evidence.space.default, begin, 3.0, 3, 0, 200, 8, journal), (1, 4))
    assert found.told is not None
    assert (found.told["tried"], found.told["taken"]) == ("mujoco", True)
    surveys = [name for name in journal.units if "survey" in name]
    assert surveys == [f"{law} survey of {h} steps" for law in ("mujoco:", "plainly,") for h in (1, 4)]


def test_a_law_that_was_named_or_does_not_matter_stays(tmp_path: Path) -> None:
    model, log = log_of(tmp_path)
    named = model.with_settings(sliding="coulomb")
    assert chosen(named, log) == ("coulomb", None)
    assert not named.rivals()
    smooth = PUCK.replace('friction=".6"', 'condim="1"')
    assert list(cmbrl.ComplementarityModel(scene(tmp_path, smooth)).rivals()) == ["mujoco"]
    rigid = cmbrl.Scene.from_mjcf(PUCK, contact_law="rigid")
    assert not cmbrl.ComplementarityModel(rigid).rivals()


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_fit_keeps_and_tells_its_law(tmp_path: Path) -> None:
    model, log = log_of(tmp_path)
    slippery = [0.4 if p.name.startswith("friction.") else p.nominal for p in model.scene.parameters]
    model = model.with_parameters(np.array(slippery))
    result = cmbrl.fit(model, log, groups=["friction"], method="gauss-newton", horizon=1, budget=QUICK)
    assert result.model.sliding == "convex"
    assert result.report["sliding"]["taken"]
    assert "law of sliding: MuJoCo's step" in " ".join(result.report_text().split())
    friction = [p.value for name, p in result.parameters.items() if name.startswith("friction.")]
    assert max(abs(value - 0.6) for value in friction) < 0.05
    result.save(tmp_path / "fit")
    saved = FitResult.load(tmp_path / "fit")
    assert saved.model.sliding == "convex"
    kept = {**saved.report, "sliding": {"tried": "convex", "relative_error": 0.97, "taken": False}}
    assert "law of sliding: exact Coulomb" in " ".join(render(saved.parameters, kept).split())
    kept["sliding"] = {"tried": "mujoco", "own": "convex", "relative_error": 1.2, "taken": False}  # convex was named
    assert "law of sliding: the convex law, MuJoCo's; MuJoCo's step" in " ".join(render(saved.parameters, kept).split())
