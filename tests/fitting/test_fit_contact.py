"""The fit of the contact model: logs of the real systems of two tasks, and what a saved fit keeps."""

import json

import numpy as np
import pytest

pytest.importorskip("gymnasium")
pytest.importorskip("pymunk")

import cmbrl
from cmbrl.errors import UserError
from cmbrl.files import write_record
from cmbrl.fitting import Budget, FitResult
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.models.windows import Scales
from cmbrl.tasks import ball_throw, cube_toss
from cmbrl.tasks import hopper as hopper_task

QUICK = Budget(trial_rows=200, trial_rounds=2, trial_population=16, search_rows=300, search_rounds=5, polish_rows=600)


@pytest.fixture(scope="module")
def hopper():
    task = hopper_task.TASK
    scene = cmbrl.Scene.from_mjcf(task.scene_path)
    model = cmbrl.ComplementarityModel(scene, substeps=4, time_step=0.002, integrator="leapfrog", threads=2)
    return model, task.record(600, seed=3)


@pytest.fixture(scope="module")
def ball():
    task = ball_throw.TASK
    model = cmbrl.ComplementarityModel(task.load_scene(), **task.model_options(), threads=2)
    return model, task.record(1500, seed=2)


def _wrong(model, change=1.3):
    """Masses and gears too small or too large in turn."""
    theta = model.parameters.copy()
    moved = [k for k, p in enumerate(model.scene.parameters) if p.group in ("mass", "gear")]
    theta[moved] *= np.where(np.arange(len(moved)) % 2, change, 1 / change)
    return model.with_parameters(theta)


def _objective_parts(model, data, horizon):
    evidence = Evidence.of(model, data)
    space = evidence.space
    scales = Scales.of(model.scene, data, huber=0.5)
    return space, evidence.loss(data.windows(horizon), horizon, scales)


@pytest.mark.parametrize("horizon", [1, 3])
def test_core_and_fit_agree_on_the_loss_and_its_gradient(hopper, horizon):
    model, data = hopper
    space, loss = _objective_parts(_wrong(model), data.select(slice(0, 150)), horizon)
    z = np.random.default_rng(0).normal(scale=0.05, size=len(space))
    assert loss.values(space.theta(z)[None])[0] == pytest.approx(loss.errors(space.theta(z)).mean, rel=1e-9)
    step = 1e-5
    moved = np.concatenate([z + step * np.eye(len(space)), z - step * np.eye(len(space))])
    inside = (moved >= space.z_low) & (moved <= space.z_high)
    free = inside[: len(space)].all(axis=1) & inside[len(space) :].all(axis=1)
    up, down = np.split(loss.values(space.theta(moved)), 2)
    numeric = (up - down) / (2 * step)
    gradient = loss.normal_equations(space, z).gradient
    np.testing.assert_allclose(gradient[free], numeric[free], rtol=1e-3, atol=1e-4 * np.abs(gradient).max())


def test_derivatives_in_the_impedance_of_a_soft_contact():
    """Cubes pressed into the board at all depths, against central differences of the same step."""
    scene = cmbrl.Scene.from_mjcf(cube_toss.TASK.scene_path, contact_law="mujoco")
    model = cmbrl.ComplementarityModel(scene, smoothing=cmbrl.Barrier(1e-6))
    names = [p.name for p in scene.parameters]
    theta = scene.parameter_vector()
    for name, value in {"low": 0.3, "high": 0.8, "width": 0.01}.items():
        theta[names.index(f"impedance_{name}.cube")] = value
    draw = np.random.default_rng(0)
    q = np.tile(scene.q0, (200, 1))
    q[:, 2] = 0.0524 - draw.uniform(0.0, 0.012, 200)
    v = draw.normal(scale=0.5, size=(200, 6))
    u = np.zeros((200, 0))
    _, _, _, slope = model.parameter_jacobian(q, v, u, theta)
    for name in ("impedance_low", "impedance_high", "impedance_width"):
        k = names.index(f"{name}.cube")
        step = 1e-5 * theta[k] * np.eye(len(theta))[k]
        numeric = (model.predict(q, v, u, theta + step).v_next - model.predict(q, v, u, theta - step).v_next) / (
            2 * step[k]
        )
        assert np.abs(numeric).max() > 0.01
        error = np.abs(slope[:, :, k] - numeric).max(axis=1) / np.abs(numeric).max()
        assert np.median(error) < 1e-6
        assert (error < 1e-4).mean() > 0.97  # the rest straddle the depth where the impedance curve bends


def test_every_parameter_that_the_log_can_tell_changes_the_loss(hopper):
    model, data = hopper
    space, loss = _objective_parts(model, data, 1)
    nominal = loss.values(space.nominal[None])[0]
    moved = loss.values(space.theta(0.3 * np.eye(len(space))))
    idle = {n for n, value in zip(space.names, moved, strict=True) if value == nominal}
    # Random actions from an upright start: neither torso, thigh nor leg reach the floor, nor each other. The foot's
    # impedance is the same at all depths, so over which depth it changes makes no difference; nor does where the hopper
    # stands, from which speed on friction would fall that does not fall, or a limit that no motor reaches.
    never = ("stribeck_speed", "force_limit")
    idle -= {"impedance_width.foot_geom", "bias.rootx", *(n for n in idle if n.startswith(never))}
    assert {n.split(".")[1].split("_")[0] for n in idle} <= {"torso", "thigh", "leg", "pairs"}
    for name in ("mass.foot", "damping.foot_joint", "armature.leg_joint", "gear.thigh_joint", "gravity"):
        assert name not in idle


def test_hopper_from_wrong_masses_and_gears(hopper):
    model, data = hopper
    result = cmbrl.fit(_wrong(model), data, horizon=1, budget=QUICK)
    loss = result.report["loss"]
    assert loss["held out, nominal"]["rmse"] > 0.15
    assert loss["held out, fitted"]["rmse"] < 0.05
    assert loss["held out, fitted"]["failures"] == 0
    assert {"mass", "gear"} & {name.split(".")[0] for name in result.report["fitted"]}


@pytest.mark.slow  # tests/test_cli.py fits with one thread, too
def test_threads_do_not_change_the_fit(hopper):
    model, data = hopper
    results = [
        cmbrl.fit(_wrong(model).with_settings(threads=n), data, groups=["mass", "gear"], budget=QUICK) for n in (1, 2)
    ]
    assert np.array_equal(results[0].model.parameters, results[1].model.parameters)
    first, second = (json.loads(json.dumps(r.report["loss"])) for r in results)
    assert first == second


def test_ball_parameters_are_recovered(ball):
    model, data = ball
    result = cmbrl.fit(model, data, groups=["restitution", "friction", "gravity"])
    assert result.parameters["restitution.ball"].value == pytest.approx(0.72, rel=0.02)
    assert result.parameters["friction.ball"].value == pytest.approx(0.2, rel=0.02)
    assert result.parameters["gravity"].value * 9.81 == pytest.approx(9.5, rel=0.02)


def test_saved_fit_comes_back(ball, tmp_path):
    model, data = ball
    result = cmbrl.fit(model, data, groups=["restitution", "friction"], budget=QUICK, folder=tmp_path)
    result.save(tmp_path)
    loaded = FitResult.load(tmp_path)
    assert loaded.parameters == result.parameters
    mjcf = {"file": "fitted.xml", "missing": ["restitution.ball"]}
    assert loaded.report == {**json.loads(json.dumps(result.report)), "mjcf": mjcf}
    arguments = data.q[:50], data.v[:50], data.u[:50]
    assert np.array_equal(loaded.model.predict(*arguments).v_next, result.model.predict(*arguments).v_next)
    assert (tmp_path / "report.txt").read_text().rstrip() == loaded.report_text()
    for damage, message in (
        ({"format": 0}, "not a fit of this version"),
        ({"format": 3, "parameters": 3}, "damaged"),
    ):
        write_record(tmp_path / "fit.json", damage)
        with pytest.raises(UserError, match=message):
            FitResult.load(tmp_path)
    with pytest.raises(UserError, match="no such file"):
        FitResult.load(tmp_path / "nowhere")


def test_a_bare_model_gets_the_substeps_of_the_log(hopper):
    model, data = hopper
    bare = cmbrl.ComplementarityModel(model.scene, integrator=model.integrator, time_step=model.time_step)
    assert bare.substeps == 1 < model.substeps
    result = cmbrl.fit(bare, data, groups=["gear"], method="gauss-newton", budget=QUICK)
    assert result.model.substeps == model.substeps
    with pytest.raises(UserError, match="not a whole number of time steps"):
        cmbrl.fit(bare.with_settings(time_step=0.003), data, groups=["gear"])


@pytest.mark.parametrize(
    ("dt", "substeps"), [(0.005001, 3), (0.002, 1), (0.0015, 1), (0.0040001, 2), (0.0100071, 5), (0.0105, 6)]
)
def test_the_time_step_of_the_file_is_shortened_for_a_log_that_it_does_not_divide(hopper, dt, substeps):
    bare = cmbrl.ComplementarityModel(hopper[0].scene)
    found = bare.for_log(dt)
    assert found.substeps == substeps
    assert found.time_step <= bare.time_step
    assert found.dt == pytest.approx(dt, rel=1e-3)
