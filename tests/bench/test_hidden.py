"""Hidden systems: each family changes what it says and only that; what is made of the results."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from cmbrl.bench.studies.hidden import families, judge, pairs, plots, trials, truth
from cmbrl.bench.studies.hidden import study as hidden
from cmbrl.bench.studies.hidden.arms import FIT, NOMINAL, ON_POLICY, ORACLE, arms
from cmbrl.bench.studies.hidden.cells import taught
from cmbrl.bench.studies.hidden.flaws import Flaws, play_of
from cmbrl.bench.studies.hidden.hidden_system import Hidden, HiddenSystem
from cmbrl.bench.studies.hidden.plan import FAMILIES, FLOOR, OUTSIDE, PARAMETERS, PAYLOAD, QUICK, SCENES, Plan
from cmbrl.bench.studies.hidden.without_data import randomised
from cmbrl.bench.studies.mission.runs import random_log
from cmbrl.bench.study import Settings
from cmbrl.fitting.fitted_parameter import FITTED, FLAT, FittedParameter
from cmbrl.fitting.result import FitResult
from cmbrl.jobs import Runner
from cmbrl.models.named import nominal_model
from cmbrl.registry import load_task
from cmbrl.scene import Scene
from cmbrl.system import MujocoSystem

pytest.importorskip("gymnasium", reason="the robots are Gymnasium's")
pytestmark = pytest.mark.filterwarnings("ignore:compiler attribute")  # of the half-cheetah's file
DERIVED = (
    "M0",
    "invweight0",
    "subtreemass",
    "length0",
    "acc0",
    "meaninertia",
    "extent",
    "meanmass",
    "meansize",
    "poscom0",
    "bvh_aabb",
    "dof_length",
)


def numbers(model):
    """Every number of a compiled model by name, but for what the compiler derives from the others."""
    found = {}
    for owner, prefix in ((model, ""), (model.opt, "opt."), (model.stat, "stat.")):
        for name in dir(owner):
            value = getattr(owner, name)
            if name.startswith("_") or callable(value) or name.endswith(DERIVED):
                continue
            if isinstance(value, float | np.ndarray):
                found[prefix + name] = np.array(value)
    return found


def differing(one, other):
    a, b = numbers(one), numbers(other)
    return {name for name in a if not np.array_equal(a[name], b[name], equal_nan=True)} - {"stat.center"}


@pytest.fixture(scope="module")
def files():
    return {scene: mujoco.MjModel.from_xml_path(load_task(scene).scene_path) for scene in SCENES}


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize(
    ("family", "changes"),
    [
        (PARAMETERS, {"body_mass", "body_inertia", "actuator_gear", "dof_damping", "geom_friction"}),
        (PAYLOAD, {"body_mass", "body_inertia", "body_ipos", "body_iquat", "body_sameframe"}),
        (FLOOR, {"geom_solref", "geom_solimp", "geom_friction"}),
        (OUTSIDE, {"dof_frictionloss"}),
    ],
)
def test_a_family_changes_what_it_says_and_only_that(files, scene, family, changes):
    nominal, drawn = files[scene], Hidden(scene, family, 3).file_like
    found = differing(nominal, drawn)
    assert found <= changes
    assert changes - found <= {"body_iquat", "body_sameframe"}  # an inertial frame may already be general
    again = families.changed(scene, load_task(scene).scene_path, family, 3)
    assert differing(again, drawn) == set()
    assert set() < differing(Hidden(scene, family, 4).file_like, drawn) <= found


@pytest.mark.parametrize("scene", SCENES)
def test_sizes_of_the_changes(files, scene):
    nominal = files[scene]
    for draw in range(10):
        drawn = Hidden(scene, PARAMETERS, draw).file_like
        mass = drawn.body_mass[1:] / nominal.body_mass[1:]
        np.testing.assert_allclose(drawn.body_inertia[1:], nominal.body_inertia[1:] * mass[:, None])
        driven = families.motor_dofs(nominal)
        for ratio in (
            mass,
            drawn.actuator_gear[:, 0] / nominal.actuator_gear[:, 0],
            drawn.dof_damping[driven] / nominal.dof_damping[driven],
        ):
            assert ((ratio >= 0.7) & (ratio <= 1.3)).all()
            assert np.ptp(ratio) > 0.01
        friction = drawn.geom_friction[:, 0] / nominal.geom_friction[:, 0]
        assert np.ptp(friction) < 1e-12
        assert 0.5 <= friction[0] <= 1.5
        floor = Hidden(scene, FLOOR, draw).file_like
        for values, low, high in (
            (floor.geom_solref[:, 0], 0.01, 0.05),
            (floor.geom_friction[:, 0], 0.7, 1.0),
            (floor.geom_solimp[:, 1], 0.7, 0.95),
        ):
            assert np.ptp(values) == 0.0
            assert low <= values[0] <= high
        loss = Hidden(scene, OUTSIDE, draw).file_like.dof_frictionloss[driven] / np.abs(nominal.actuator_gear[:, 0])
        assert ((loss >= 0.01) & (loss <= 0.04)).all()


def test_a_payload_is_what_mujoco_compiles_of_a_sphere():
    task = load_task("hopper")
    model = mujoco.MjModel.from_xml_path(task.scene_path)
    place = np.array([0.12, 0.0, -0.05])
    families.add_sphere(model, model.body("torso").id, 4.0, 0.08, place)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    spec = mujoco.MjSpec.from_file(task.scene_path)
    spec.body("torso").add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.08, 0, 0), pos=place, mass=4.0, contype=0, conaffinity=0
    )
    other = spec.compile()
    path = []
    for one in (model, other):
        data = mujoco.MjData(one)
        data.qpos[3:] = -0.3
        for k in range(500):
            data.ctrl[:] = np.sin(0.01 * k + np.arange(3))
            mujoco.mj_step(one, data)
        path.append(np.concatenate([data.qpos, data.qvel]))
    np.testing.assert_allclose(path[0], path[1], atol=1e-9)
    assert model.body_mass.sum() == pytest.approx(files_mass(task) + 4.0)


def files_mass(task):
    return mujoco.MjModel.from_xml_path(task.scene_path).body_mass.sum()


@pytest.mark.parametrize("family", FAMILIES[:3])
def test_within_a_file_a_hidden_robot_steps_as_mujoco_does(family):
    found = Hidden("hopper", family, 1)
    task = found.task
    own = found.systems()()
    other = MujocoSystem(task.scene_path, 4, change=lambda m: copied(found.file_like, m))
    q, v = np.array([0.0, 1.25, 0.0, 0.0, 0.0, 0.0]), np.zeros(6)
    own.reset(q, v)
    other.reset(q, v)
    for k in range(30):
        u = np.sin(0.3 * k + np.arange(3))
        np.testing.assert_allclose(np.hstack(own.step(u)), np.hstack(other.step(u)), atol=1e-12)
    assert len(own.path) == 31
    assert own.dt == task.control_dt


def copied(source, target):
    for name in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_sameframe", "actuator_gear",
                 "dof_damping", "geom_friction", "geom_solref", "geom_solimp"):  # fmt: skip
        getattr(target, name)[:] = getattr(source, name)
    mujoco.mj_setConst(target, mujoco.MjData(target))


@pytest.mark.parametrize("scene", SCENES)
def test_outside_has_the_flaws_that_it_says(files, scene):
    found, nominal = Hidden(scene, OUTSIDE, 2), files[scene]
    model, own = found.real
    assert model.opt.timestep == 1e-3
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    np.testing.assert_array_equal(model.body_mass, nominal.body_mass)
    np.testing.assert_array_equal(model.actuator_gear, nominal.actuator_gear)
    assert (model.actuator_dyntype == mujoco.mjtDyn.mjDYN_FILTEREXACT).all()
    assert (model.actuator_dynprm[:, 0] == 0.02).all()
    steps = own.late * 1e-3 / found.task.control_dt
    assert 1.0 <= steps <= 2.0
    for k in range(nominal.nu):
        name = nominal.joint(int(nominal.actuator_trnid[k, 0])).name
        driven, play = model.joint(name), model.joint(play_of(name))
        low, high = play.range
        assert np.deg2rad(0.3) <= high - low <= np.deg2rad(1.0)
        assert low == -high
        assert play.stiffness[0] == play.frictionloss[0] == 0.0
        np.testing.assert_array_equal(driven.range, nominal.joint(name).range)
        assert driven.frictionloss[0] == found.file_like.joint(name).frictionloss[0] > 0
        assert driven.damping[0] == nominal.joint(name).damping[0]
    assert own.noise_q.shape == (nominal.nq,)
    assert (own.noise_v > own.noise_q).all()


def still(flaws_of, seed=0, scene="hopper"):
    """A robot of the outside family with some of its flaws alone."""
    found = Hidden(scene, OUTSIDE, 2)
    names = [found.file_like.joint(k).name for k in range(found.file_like.njnt)]
    return HiddenSystem(found.real[0], 0.008, names, flaws_of, np.random.default_rng(seed))


def test_delay_lag_and_backlash_act():
    q, v, u = np.array([0.0, 2.0, 0.0, -0.5, -0.5, 0.0]), np.zeros(6), np.ones(3)
    prompt, late = still(Flaws()), still(Flaws(late=12))
    for robot in (prompt, late):
        robot.reset(q, v)
        robot.step(u)
    assert prompt.data.act[0] == pytest.approx(1 - np.exp(-8 / 20), abs=1e-6)  # 8 ms of a lag of 20 ms
    assert not late.data.act.any()
    late.step(u)
    assert late.data.act[0] == pytest.approx(1 - np.exp(-4 / 20), abs=1e-6)  # 16 ms, less 12 of delay
    for _ in range(20):
        prompt.step(np.array([1.0, -1.0, 1.0]))
    plays = [prompt.data.joint(play_of(name)).qpos[0] for name in ("thigh_joint", "leg_joint", "foot_joint")]
    gaps = [prompt.model.joint(play_of(name)).range[1] for name in ("thigh_joint", "leg_joint", "foot_joint")]
    assert (np.abs(plays) > 1e-5).all()  # each has left its middle
    assert (np.abs(plays) < 2 * np.array(gaps)).all()  # and the stops hold


def test_noise_is_seen_and_not_lived():
    noise = np.full(6, 1e-3)
    noisy, quiet = still(Flaws(noise_q=noise, noise_v=10 * noise)), still(Flaws())
    q, v = np.array([0.0, 2.0, 0.0, -0.5, -0.5, 0.0]), np.zeros(6)
    seen = []
    for robot in (noisy, quiet):
        robot.reset(q, v)
        seen.append([np.hstack(robot.step(np.zeros(3))) for _ in range(300)])
    true = [np.hstack(state) for state in noisy.path[1:]]
    np.testing.assert_array_equal(true, seen[1])
    error = np.std(np.array(seen[0]) - true, axis=0)
    np.testing.assert_allclose(error, [*noise, *10 * noise], rtol=0.2)


def test_logs_and_draws_are_reproducible_and_noise_differs_between_robots():
    found = [Hidden("hopper", OUTSIDE, 5) for _ in range(2)]
    mdp = load_task("hopper").mdp()
    logs = [random_log(mdp, one.systems(), 30, 7) for one in found]
    for name in ("q", "v", "u", "q_next", "v_next"):
        np.testing.assert_array_equal(getattr(logs[0], name), getattr(logs[1], name))
    make = found[0].systems()
    robots = [make(), make()]
    q, v = np.array([0.0, 1.25, 0.0, 0.0, 0.0, 0.0]), np.zeros(6)
    for robot in robots:
        robot.reset(q, v)
    assert not np.array_equal(robots[0].step(np.zeros(3))[0], robots[1].step(np.zeros(3))[0])
    np.testing.assert_array_equal(robots[0].path[1][0], robots[1].path[1][0])


def test_returns_are_those_of_true_states():
    found, mdp = Hidden("hopper", OUTSIDE, 1), load_task("hopper").mdp()
    told = judge.real(lambda o: torch.full((len(o), 3), 0.5), mdp, found, 3)
    robot = found.systems()()
    q, v = mdp.reset(3, torch.Generator().manual_seed(9_000))
    robot.reset(q[0].numpy(), v[0].numpy())
    for _ in range(told["lengths"][0]):
        robot.step(np.full(3, 0.5))
    way = robot.path[-1][0][0] - robot.path[0][0][0]
    alive = told["lengths"][0] * (1 - 3 * 0.25e-3) - 1  # the step of the fall earns no survival
    assert told["falls"][0]
    assert told["last"][0] == pytest.approx(robot.path[-1][0].tolist())
    assert told["returns"][0] == pytest.approx(way / 0.008 + alive, abs=1e-6)


def test_true_parameters_are_found_and_intervals_judged():
    task = load_task("hopper")
    scene, found = task.load_scene(), Hidden("hopper", PARAMETERS, 0).file_like
    nominal = mujoco.MjModel.from_xml_path(task.scene_path)
    true = Scene.from_mjcf(found)
    values = truth.true_parameters(scene, true)
    names = [p.name for p in scene.parameters]
    ratio = found.body("leg").mass[0] / nominal.body("leg").mass[0]
    assert values[names.index("mass.leg")] == pytest.approx(ratio)
    assert values[names.index("damping.leg_joint")] == pytest.approx(found.joint("leg_joint").damping[0])
    assert values[names.index("friction.foot_geom")] == pytest.approx(found.geom("foot_geom").friction[0])
    same = [k for k, p in enumerate(scene.parameters) if p.group in ("com_x", "armature", "softness_time", "gravity")]
    np.testing.assert_allclose(values[same], scene.parameter_vector()[same], rtol=1e-9)
    payload = truth.true_parameters(scene, Scene.from_mjcf(Hidden("hopper", PAYLOAD, 0).file_like))
    theta = np.where(np.isfinite(payload), payload, scene.parameter_vector())
    theta[[p.group == "softness_scale" for p in scene.parameters]] = 1.0
    bodies = slice(0, scene.layout.dof(0))
    np.testing.assert_allclose(
        scene.physical_vector(theta)[bodies], Scene.from_mjcf(Hidden("hopper", PAYLOAD, 0).file_like).core.P[bodies],
        rtol=1e-9, atol=1e-12,
    )  # fmt: skip
    parameters = {p.name: FittedParameter(p.nominal, p.low, p.high, p.nominal, FLAT) for p in scene.parameters}
    for name, low, high in (("mass.leg", 0.9, 1.1), ("mass.foot", 0.0, 9.0)):
        centre = values[names.index(name)]
        parameters[name] = FittedParameter(centre, centre * low, centre * high, 1.0, FITTED)
    off = values[names.index("damping.leg_joint")]
    parameters["damping.leg_joint"] = FittedParameter(off * 2, off * 1.5, off * 3, 1.0, FITTED)
    told = truth.coverage(FitResult(nominal_model(task, scene), parameters, {}), true)
    assert {p["name"]: p["holds"] for p in told} == {"mass.leg": True, "mass.foot": True, "damping.leg_joint": False}


def test_randomisation_varies_what_may_be_wrong():
    model = nominal_model(load_task("hopper"))
    ratio = randomised(model, 0.2, 50, 3).candidates / np.where(model.parameters == 0, 1, model.parameters)
    varied = {p.group for p, column in zip(model.scene.parameters, ratio.T, strict=True) if np.ptp(column) > 1e-9}
    assert varied == {"mass", "gear", "damping", "friction", "softness_time"}
    assert 0.3 < np.ptp(ratio[:, [p.group == "gear" for p in model.scene.parameters]]) <= 0.4


def test_area_and_hits():
    assert trials.area([0.9, 0.8, 0.1], [True, True, False]) == 1.0
    assert trials.area([0.5, 0.5], [True, False]) == 0.5
    assert trials.area([0.1, 0.9, 0.2], [True, False, False]) == 0.0
    assert trials.area([0.1, 0.9], [True, True]) is None
    assert trials.hits([0.2, 0.0, 0.1, 0.0], [True, True, False, False], 0.1) == {
        "found": 1, "missed": 1, "false": 1, "quiet": 1,
    }  # fmt: skip


def real(value, fell):
    return {"returns": [value - 5.0, value + 5.0], "lengths": [9, 9], "falls": [fell, fell]}


def parameter(group, value, truth, low, high):
    about = {"name": f"{group}.leg", "group": group, "nominal": 1.0, "value": value, "truth": truth}
    return {**about, "low": low, "high": high, "holds": low <= truth <= high}


def made_up(draws=10, gain=100.0):
    """Results in which draw k earns 100 k nominal, randomised 30 more, fit ``gain`` and oracle 200 more."""
    cells = []
    fitted = [parameter("mass", 1.09, 1.1, 1.0, 1.2), parameter("gear", 1.3, 0.8, 1.2, 1.4)]
    places = [(family, k) for family in FAMILIES for k in range(draws)]
    for scene in SCENES:
        run = {"scene": scene, "seed": 0, "failed": None, "cpu": 1.0}
        for arm, more in ((NOMINAL, 0.0), ("randomised 0.15", 10.0), ("randomised 0.3", 30.0)):
            tried = [{"family": family, "draw": k, "real": real(100.0 * k + more, True)} for family, k in places]
            cells.append({**run, "arm": arm, "trials": None, "tried": tried})
        for family, k in places:
            one = {"returns": [1.0, 2.0], "lengths": [9, 9], "falls": [k < 3, False]}
            cell = {**run, "family": family, "draw": k, "trials": dict.fromkeys(trials.TRIALS, one)}
            cells.append({**cell, "arm": FIT, "parameters": fitted, "real": real(100.0 * k + gain, k < 3)})
            cell["trials"] = {**cell["trials"], trials.LAW: one}  # the other cells are from before it
            cells.append({**cell, "arm": ORACLE, "real": real(100.0 * k + 200.0, k < 3)})
    return cells


def test_tables_of_made_up_results(tmp_path, monkeypatch):
    drawn = {}
    monkeypatch.setattr(plots, "save", lambda figure, path: drawn.setdefault(path.name, figure))
    section = hidden.section(made_up(), tmp_path, Plan())
    by_title = {table.title: table for table in section.tables}
    row = dict(zip(by_title["hopper: the same draw by other arms"].columns[:3],
                   by_title["hopper: the same draw by other arms"].rows[0][:3], strict=True))  # fmt: skip
    assert row == {"family": PARAMETERS, "arm": FIT, "- nominal": 100.0}
    cells = by_title["hopper: the same draw by other arms"].rows[0]
    assert cells[5] == "10 of 10"
    assert cells[6] == pytest.approx(70.0)  # less the better width
    assert cells[10] == pytest.approx(0.5)  # half of the way
    assert cells[12:] == pytest.approx([0.5, 0.5, 0.5])
    assert by_title["hopper: real returns, draw by draw"].rows[0][2].startswith("0, 100, 200")
    covered = by_title["Intervals"].rows[0]
    assert covered[3:7] == [10, 20, 0.5, 0.5]
    assert covered[7] == "gear 0%, mass 100%"
    foretold = {row[1]: row for row in by_title["Falls foretold"].rows if row[0] == "hopper"}
    assert foretold["falls: all"][2:] == [80, 24, 1.0, 0.1, 24, 0, 0, 56, 1.0]
    assert foretold["falls: law"][2:4] == [40, 12]
    assert foretold["spread"][4] == 0.5
    axes = drawn["hidden.png"].axes
    assert len(axes) == len(SCENES) * len(FAMILIES)
    lines = axes[0].get_lines()
    np.testing.assert_allclose(lines[3].get_ydata(), [300, 400, 500])  # draw 3
    np.testing.assert_allclose(lines[-1].get_ydata(), 100.0 * np.arange(10) + 30)  # the better width


def test_an_unfinished_pair_and_a_lost_policy_are_said():
    cells = [cell for cell in made_up() if cell.get("draw", 0) < 2]
    lost = next(c for c in cells if c["arm"] == FIT and c["family"] == FLOOR and c["draw"] == 1)
    lost["real"] = None
    runs = pairs.Runs.of(cells)
    assert runs.returns("hopper", FLOOR, FIT) == {0: 100.0, 1: 0.0}
    found = pairs.Difference.of(runs.returns("hopper", FLOOR, FIT), runs.returns("hopper", FLOOR, NOMINAL))
    assert (found.wins, found.count) == (1, 2)
    assert found.low == -100.0
    assert pairs.Difference.of({0: 1.0}, {}) is None
    level = pairs.Way.of({0: 100.0, 1: 100.0}, {0: 150.0, 1: 150.0}, {0: 101.0, 1: 101.0})
    assert (level.median, level.counted, level.count, level.ratio) == (None, 0, 2, None)


def test_jobs_go_draw_by_draw_and_fit_and_oracle_lead():
    made = [job.name for job in hidden.jobs(Plan(), SCENES, 300)]
    assert len(set(made)) == len(made)
    base = len(SCENES) * 3 * 3
    assert all(NOMINAL in name or "randomised" in name for name in made[:base])
    assert made[base : base + 2] == [f"hopper-{PARAMETERS}-0-{FIT}-300", f"hopper-{PARAMETERS}-0-{ORACLE}-300"]
    first = [name for name in made[base:] if name.endswith("-300")]
    assert made[base : base + len(first)] == first
    assert sum(ON_POLICY in name for name in made) == len(SCENES) * 10
    assert all(OUTSIDE in name for name in made if ON_POLICY in name)
    assert sum("fit of 100" in name for name in made) == len(SCENES) * Plan().extra_draws
    assert made[-1] == f"cheetah-{OUTSIDE}-0-{ORACLE}-310"


def test_a_cell_is_the_same_again():
    small = replace(QUICK, loop={"hopper": {**QUICK.loop["hopper"], "policies": 1, "iterations": 1}})
    found = [taught("hopper", OUTSIDE, 0, ORACLE, 5, small) for _ in range(2)]
    for cell in found:
        del cell["cpu"], cell["wall"]
    assert found[0] == found[1]
    assert found[0]["trials"].keys() == {*trials.TRIALS, trials.LAW}
    assert "falls: law" in trials.scores(found[0]["trials"])
    assert "parameters" not in found[0]


@pytest.mark.slow
def test_quick_study_has_every_arm(tmp_path, monkeypatch):
    pytest.importorskip("stable_baselines3")
    monkeypatch.setattr(plots, "save", lambda figure, path: None)
    runner = Runner(tmp_path)
    section = hidden.STUDY.run(tmp_path, Settings(quick=True), runner)
    tried = {(c.get("family"), c["arm"]) for c in section.values["cells"]}
    expected = {(f, name) for name, arm in arms(QUICK).items() for f in arm.families if arm.available()}
    assert tried == expected | {(None, NOMINAL), (None, "randomised 0.3")}
    for cell in section.values["cells"]:
        assert cell["failed"] is None
        assert ("parameters" in cell) == (cell["arm"].startswith("fit"))
    assert [table.title for table in section.tables][:2] == [
        "hopper: real returns, draw by draw", "hopper: the same draw by other arms",
    ]  # fmt: skip
    kept = {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
    assert hidden.STUDY.run(tmp_path, Settings(quick=True), runner).tables == section.tables
    assert kept == {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
