"""Intervals cover the truth, also of a wrong model; what the data cannot tell is named."""

from types import SimpleNamespace

import numpy as np
import pytest

import cmbrl
from cmbrl.fitting.choice.polish import _same_motion
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.surveyed import Survey
from cmbrl.fitting.outcome.discrepancy import Discrepancy
from cmbrl.fitting.outcome.identify import _flat_directions, identify
from cmbrl.fitting.outcome.ratios import beside, ratios
from cmbrl.fitting.search.folds import draw_starts
from cmbrl.fitting.search.gauge import common_factors, nearest
from cmbrl.fitting.search.gauss_newton import gauss_newton
from cmbrl.fitting.search.loss_values import NormalEquations
from cmbrl.fitting.search.objective import Objective
from cmbrl.fitting.search.space import Space
from cmbrl.fitting.state import Journal
from cmbrl.models.windows import Scales
from cmbrl.scene.records import Parameter


def _identify(carts, data, columns, place=False, sets=()):
    model = carts.model()
    evidence = Evidence.of(model, data)
    space = evidence.space
    loss = evidence.loss(data.windows(1), 1, Scales.of(model.scene, data, 5.0))
    objective = Objective(loss, space, space.columns(columns), strength=1e-6)
    found = gauss_newton(objective, np.zeros(len(objective.space)), 20, Journal(None, ""))
    right = np.zeros((len(space), len(space)))  # the model is right
    known = identify(space, found.z, objective.active, loss.normal_equations(space, found.z), right, sets)
    return (space, known, found.z) if place else (space, known)


def test_intervals_cover_the_truth_as_often_as_they_say(carts):
    covered = []
    for seed in range(60):
        data = carts.record(carts.truth(1, damping_0=1.5), 12, 20, seed=seed, noise=0.01)
        _, known = _identify(carts, data, ["damping", "gear"])
        covered += [known.low[1] <= 1.5 <= known.high[1], known.low[3] <= 1.0 <= known.high[3]]
    assert 0.88 <= np.mean(covered) <= 1.0  # 95 % asked, 120 tries: three standard errors are 6 %


def test_the_unit_of_force_is_a_flat_direction(carts):
    data = carts.record(carts.model(), 8, 30, noise=1e-3)
    _, known = _identify(carts, data, ["mass", "damping", "frictionloss", "gear", "bumper"])
    directions = [d["parameters"] for d in known.directions]
    assert {"bumper": 1.0} in directions
    scale = next(d for d in directions if "mass.0" in d)
    assert set(scale) == {"mass.0", "damping.0", "frictionloss.0", "gear.0"}
    assert min(scale.values()) > 0.99  # all by the same factor


def test_ratios_are_known_where_sizes_are_not(carts):
    data = carts.record(carts.truth(1, gear_0=0.7), 8, 30, noise=1e-3)
    space, known, z = _identify(carts, data, ["mass", "damping", "frictionloss", "gear"], place=True)
    together = [k for k, name in enumerate(space.names) if name.endswith(".0")]
    found = ratios(space, z, known.every, together)
    told = {found["reference"]: [1.0, 1.0, 1.0], **found["parameters"]}
    assert set(told) == {"mass.0", "damping.0", "frictionloss.0", "gear.0"}
    value = {name: numbers[0] for name, numbers in told.items()}
    assert value["gear.0"] / value["mass.0"] == pytest.approx(0.7, rel=0.01)
    for name, (_, low, high) in found["parameters"].items():
        k = space.names.index(name)
        assert high / low < 0.5 * known.high[k] / known.low[k]
    assert ratios(space, z, known.every, together[:1]) is None


def test_masses_that_were_not_chosen_leave_the_unit_of_force_open(carts):
    """Masses are 1.3 times the file's; the other forces make up for it, and no motion tells."""
    truth = carts.truth(1, mass_0=1.3, damping_0=1.5)
    data = carts.record(truth, 8, 30, noise=1e-3)
    unit, chosen = ["mass", "damping", "frictionloss", "gear"], ["damping", "frictionloss", "gear"]
    names = Evidence.of(carts.model(), data).space.names
    sets = [[k for k, name in enumerate(names) if name in ("mass.0", "damping.0", "frictionloss.0", "gear.0")]]
    _, alone, z = _identify(carts, data, chosen, place=True)
    space, known, same = _identify(carts, data, chosen, place=True, sets=sets)
    _, all_of_them = _identify(carts, data, unit)
    gear = names.index("gear.0")
    assert (z == same).all()
    assert alone.high[gear] < 1.0
    assert known.low[gear] < 1.0 < known.high[gear]
    widths = [np.log(x.high[gear] / x.low[gear]) for x in (known, all_of_them)]
    assert widths[0] == pytest.approx(widths[1], rel=0.2)  # as if masses had been chosen
    assert np.allclose(known.covariance, alone.covariance)  # of draws, whose masses are the file's
    told = ratios(space, z, known.wide, [k for k in sets[0] if names[k] != "mass.0"])
    true = dict(zip(names, truth.parameters, strict=False))
    unit_of_it = true[told["reference"]] / space.nominal[names.index(told["reference"])]
    assert set(told["parameters"]) >= {"damping.0"} - {told["reference"]}
    for name, (_, low, high) in told["parameters"].items():
        assert low < true[name] / unit_of_it < high
    moved = [k for k in sets[0] if names[k] != "mass.0"]
    held = beside(space, z, known.every, known.wide, moved, [names.index("mass.0")])
    assert held["reference"] == "mass.0"
    assert set(held["parameters"]) >= {"gear.0", "damping.0"}
    for name, (_, low, high) in held["parameters"].items():
        assert low < true[name] / true["mass.0"] < high
        assert high / low < 1.3


def test_what_was_not_fitted_may_be_wrong():
    """A centre of mass that a fit has left at the file's: the mass that stands in for it is hardly known."""
    offered = [
        Parameter("mass.a", "mass", 1.0, 0.2, 5.0, "log", "1"),
        Parameter("com_z.a", "com_z", 0.0, -0.1, 0.1, "linear", "m"),
    ]
    space, z, none = Space.of(offered, np.array([1.0, 0.0])), np.zeros(2), np.zeros((2, 2))
    hessian = np.array([[1.0, 0.98], [0.98, 1.0]])
    episodes = 1e-6 * np.random.default_rng(0).normal(size=(8, 2))
    told = NormalEquations(np.zeros(2), hessian, episodes, independent=1e2, variance=1e-2)
    mass, both = np.array([True, False]), np.array([True, True])
    alone, beside_it, fitted = (
        identify(space, z, mass, told, none), identify(space, z, mass, told, none, free=both),
        identify(space, z, both, told, none),
    )  # fmt: skip
    assert beside_it.high[0] == pytest.approx(fitted.high[0])
    assert np.log(beside_it.high[0]) > 3 * np.log(alone.high[0])
    assert beside_it.low[1] == beside_it.high[1] == 0.0
    np.testing.assert_array_equal(beside_it.covariance, alone.covariance)  # of draws, whose centre is the file's


def test_parameters_without_any_information_are_not_mixed():
    root = np.array([[2.0, -2.0, 0.0, 0.0]])
    found = _flat_directions(root, ["a", "b", "c", "d"])
    assert [d["parameters"] for d in found] == [{"c": 1.0}, {"d": 1.0}, {"a": 1.0, "b": 1.0}]


def test_what_is_not_fitted_is_seen_or_not(carts):
    data = carts.record(carts.model(), 8, 30, noise=1e-3)
    space, known = _identify(carts, data, ["damping"])
    assert [n for k, n in enumerate(space.names) if known.unseen[k]] == ["bumper"]
    assert known.low[0] == known.high[0] == 1.0
    assert known.low[1] < 1.0 < known.high[1]
    assert not known.flat.any()


SLIDER = """<mujoco><option timestep="0.02" gravity="0 0 0"/><worldbody><body><joint name="x" type="slide" axis="1 0 0"
  damping="6" stiffness="60"/><geom size="0.1" mass="1"/></body></worldbody>
  <actuator><motor name="x" joint="x" gear="30"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def slider():
    """A robot, its log by a twentieth of the time step, and parameters of the fit over one step."""
    model = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(SLIDER))
    truth = model.with_settings(time_step=0.001, substeps=20)
    rng, episodes, steps = np.random.default_rng(0), 100, 40
    q, v = np.zeros((2, steps + 1, episodes, 1))
    u = rng.uniform(-1, 1, (steps, episodes, 1))
    for k in range(steps):
        step = truth.predict(q[k], v[k], u[k])
        q[k + 1], v[k + 1] = step.q_next, step.v_next
    rows = [np.swapaxes(x, 0, 1).reshape(-1, 1) for x in (q[:-1], v[:-1], u, q[1:], v[1:])]
    names = ("q", "v", "u", "q_next", "v_next")
    log = cmbrl.Transitions(
        **dict(zip(names, rows, strict=True)), episode=np.repeat(np.arange(episodes), steps), dt=0.02
    )
    return model, truth, log


def _widened(model, log):
    """A fit over one step of what matters here, its covariance by a wrong model, and the space."""
    evidence = Evidence.of(model, log)
    space = evidence.space
    active = space.columns(["damping", "gear"])
    loss = evidence.loss(log.windows(1), 1, *evidence.scales(1, 0.5))
    z = gauss_newton(
        Objective.at(loss, space, active, np.zeros(len(space))), np.zeros(len(space)), 20, Journal(None, "")
    ).z
    found = Discrepancy(evidence, Survey(1, None, {}), 0.5, 0, 1000, Journal(None, "")).covariance(z, active)
    return space, z, active, found, loss.normal_equations(space, z)


def test_a_wrong_time_step_widens_intervals_until_they_hold(slider):
    model, _, log = slider
    space, z, active, wrong, equations = _widened(model, log)
    assert np.allclose(wrong, wrong.T)
    assert np.linalg.eigvalsh(wrong).min() > -1e-12
    assert not wrong[~active].any()
    holds = []
    for added in (np.zeros_like(wrong), wrong):
        known = identify(space, z, active, equations, added)
        holds.append(((known.low <= space.nominal) & (space.nominal <= known.high))[active])
    assert not holds[0].all()  # the truth is the file: too sure of what repairs the time step
    assert holds[1].all()


def test_a_right_model_keeps_its_intervals(slider):
    """The log refutes other integrators, so they do not count."""
    model, truth, log = slider
    own = _widened(truth.with_settings(threads=1), log)[3]
    wrong = _widened(model, log)[3]
    assert 1e3 * np.trace(own) < np.trace(wrong)


def test_a_log_that_is_explained_exactly_has_intervals() -> None:
    """What it tells of one direction is so much that rounding takes the prior of the others."""
    told = NormalEquations(np.zeros(2), np.ones((2, 2)), np.zeros((1, 2)), independent=1e5, variance=0.0)
    evidence = SimpleNamespace(space=SimpleNamespace(precision=np.eye(2)))
    discrepancy = Discrepancy(evidence, Survey(1, None, {}), 0.5, 0, 100, Journal(None, ""))  # type: ignore[arg-type]
    step = discrepancy._step(np.array([0.3, -0.2]), np.arange(2), told)
    assert np.isfinite(step).all()
    assert abs(step.sum()) < 1e-6  # along what is told, nothing moves
    assert np.abs(step).max() < 1.0


def test_the_unit_of_force_of_a_parameter_that_may_be_negative():
    """A friction that grows with the coordinate, or falls: its lower bound has no logarithm."""
    offered = [
        Parameter("mass.a", "mass", 1.0, 0.02, 50.0, "log", "1"),
        Parameter("friction_slope.a", "friction_slope", 0.0, -9.0, 9.0, "linear", "N m/rad"),
    ]
    space = Space.of(offered, np.array([1.0, 0.0]))
    near = space.theta(nearest(space, space.z(np.array([3.0, 0.6])), [[0, 1]]))
    assert near[0] == pytest.approx(1.0, rel=0.05)
    assert near[1] / near[0] == pytest.approx(0.2)


def test_the_unit_of_force_is_the_one_nearest_to_the_file(carts):
    """Masses, motors and friction at three times the file's move as the file's do: the prior tells their size."""
    model = carts.model(2)
    data = carts.record(carts.truth(2, gear_1=0.9), episodes=8, steps=30, noise=1e-3)
    evidence = Evidence.of(model, data)
    space = evidence.space
    loss = evidence.loss(draw_starts(data, 1, 1000, 0), 1, Scales.of(model.scene, data, 2.0))
    free = space.columns(["mass", "damping", "frictionloss", "gear"])
    of_each = common_factors(model.scene.core, free[: len(model.parameters)])
    assert len(of_each) == 2  # the carts do not touch
    z = space.z(np.where(free, 3.0 * space.nominal, space.nominal))
    near = nearest(space, z, of_each)
    before, after = loss.values(space.theta(np.stack([z, near])))
    assert after == pytest.approx(before, rel=1e-9)
    np.testing.assert_allclose(space.theta(near), space.nominal, rtol=0.02)
    assert _same_motion(evidence, loss, z, near)
    limited = space.z(np.where(space.columns(["gear"]), 3.0 * space.nominal, space.nominal))  # motors that do not scale
    assert not _same_motion(evidence, loss, z, limited)
    one = space.columns(["gear"])[: len(model.parameters)]
    assert common_factors(model.scene.core, one) == []  # the masses are known, and with them the unit


@pytest.mark.parametrize("seed", range(5))
def test_a_log_that_tells_nearly_all_exactly_leaves_the_unit_of_force_open(seed: int) -> None:
    """Its information has 22 digits, those of doubles are 16: intervals were no numbers, or held rounding for a unit.

    Parameters 0 to 4 share a factor that no motion tells, so that it is known as well as five priors tell it.
    """
    rng, n, episodes = np.random.default_rng(seed), 8, 6
    offered = [Parameter(f"mass.{k}", "mass", 1.0, 0.2, 5.0, "log", "1") for k in range(n)]
    space, z = Space.of(offered, np.ones(n)), rng.normal(size=n)
    theta, slope = space.theta(z), space.slope(z)
    factor = np.where(np.arange(n) < 5, theta / slope, 0.0)
    rows = 1e3 * rng.normal(size=(200, n)) * np.logspace(0.0, -3.0, n)
    rows -= np.outer(rows @ factor, factor) / (factor @ factor)
    rows += 1e-12 * np.abs(rows).max() * rng.normal(size=rows.shape)  # what a solver leaves
    scores = 1e-6 * rng.normal(size=(episodes, 200)) @ rows
    told = NormalEquations(
        scores.sum(axis=0), rows.T @ rows, scores, independent=1e3, variance=1e-11, root=np.linalg.qr(rows, mode="r")
    )
    known = identify(space, z, np.ones(n, dtype=bool), told, np.zeros((n, n)), [list(range(5))])
    assert np.isfinite(known.low).all()
    for covariance in (known.covariance, known.every, known.apart, known.wide):
        assert np.linalg.eigvalsh(covariance).min() > -1e-12
    alone = np.sqrt(1.0 / (factor @ space.precision @ factor))  # of the factor's logarithm
    assert np.log(known.high[:5] / known.low[:5]) == pytest.approx(np.full(5, 2 * 1.96 * alone), rel=0.5)
    assert (np.log(known.high[5:] / known.low[5:]) < 0.1 * alone).all()
