"""Results do not depend on threads, on the order of a batch, on its size, or on the instruction set."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.states import Ranges, random_states
from cmbrl.contact import Barrier, Gaussian
from cmbrl.data.transitions import Transitions
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.windows import Scales, Windows
from cmbrl.native import Core
from cmbrl.scene import Scene

from ..scene.conftest import GYMNASIUM

CUBE = Path(__file__).parents[2] / "tasks/cube_toss/scene.xml"
HOPPER = next(file for file in GYMNASIUM if file.stem == "hopper")
CALM = Ranges(gap=(-0.002, 0.01), speed=2.0)
NAMES = ("q_next", "v_next", "status", "iterations", "residual", "jacobian", "impulse")


@pytest.fixture(params=[HOPPER, CUBE], ids=["hopper", "cube"])
def model(request: pytest.FixtureRequest) -> ComplementarityModel:
    return ComplementarityModel(Scene.from_mjcf(request.param), substeps=2, smoothing=Barrier(1e-4))


def batch(model: ComplementarityModel, count: int = 203) -> tuple[np.ndarray, ...]:
    return random_states(model.scene, count, np.random.default_rng(0), CALM)


def instruction_sets(scene: Scene) -> list[Core]:
    found = []
    for name in ("sse2", "avx2", "avx512"):
        with suppress(ValueError):  # not this processor's
            found.append(Core(scene.core.to_native(), isa=name))
    return found


def test_one_and_two_threads_give_the_same_bits(model: ComplementarityModel) -> None:
    q, v, u = batch(model)
    both = model.with_settings(threads=2)
    one, two = (m.predict(q, v, u, parameter_jacobian=True, impulse=True) for m in (model, both))
    for name in NAMES:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name), err_msg=name)
    g = np.random.default_rng(1).normal(size=(2, len(q), model.scene.nv))
    backward = []
    for m in (model, both):
        tape = m.stepper.forward(q, v, u, m.parameters, tape=True)["tape"]
        back = m.stepper.backward(u, m.parameters, tape, *g, want_theta=True)
        backward.append({k: np.array(x) for k, x in back.items()})
    for name, x in backward[0].items():
        np.testing.assert_array_equal(x, backward[1][name], err_msg=name)


@pytest.fixture
def studded(tmp_path: Path) -> ComplementarityModel:
    """Two bodies of 200 balls each, over a plane."""
    balls = "".join(f'<geom size=".02" pos="{x / 10} {y / 10} 0"/>' for x in range(20) for y in range(10))
    body = '<body pos="0 {} 1"><freejoint/>{}</body>'
    file = tmp_path / "studded.xml"
    file.write_text(
        '<mujoco><default><geom mass=".1"/></default><worldbody><geom type="plane" size="9 9 1"/>'
        + body.format(-1.5, balls)
        + body.format(1.5, balls)
        + "</worldbody></mujoco>"
    )
    return ComplementarityModel(Scene.from_mjcf(file), substeps=2)


def test_states_with_many_rows_among_others(studded: ComplementarityModel) -> None:
    """Every ninth state has 400 rows, others none or 200: packed by their kind, they are what they are alone."""
    scene, rng = studded.scene, np.random.default_rng(0)
    q, v = np.tile(scene.q0, (90, 1)), 0.1 * rng.normal(size=(90, scene.nv))
    q[:, 2] = np.where(np.arange(90) % 9 == 4, 0.019, 1.0)
    q[:, 9] = np.where(np.arange(90) % 3 == 1, 0.019, 1.0)
    u, g = np.zeros((90, 0)), rng.normal(size=(2, 90, scene.nv))

    def both(model: ComplementarityModel, k: np.ndarray) -> dict[str, np.ndarray]:
        out = model.stepper.forward(q[k], v[k], u[k], model.parameters, tape=True, impulse=True)
        back = model.stepper.backward(u[k], model.parameters, out["tape"], *(x[k] for x in g), want_theta=True)
        return {name: np.array(x) for name, x in (out | back).items() if name != "tape"}

    one, two = (both(m, np.arange(90)) for m in (studded, studded.with_settings(threads=2)))
    assert set(np.count_nonzero(one["impulse"][..., 0], axis=1) // 200) == {0, 1, 2}
    assert not one["status"].any()
    for name, x in one.items():
        np.testing.assert_array_equal(two[name], x, err_msg=name)
    for k in (0, 1, 4, 40):
        for name, x in both(studded, np.array([k])).items():
            scale = 1e-9 * np.abs(x).max(initial=1.0)
            np.testing.assert_allclose(one[name][[k]], x, rtol=0, atol=scale, err_msg=name)


def test_states_sorted_by_their_rows_come_back_in_order(studded: ComplementarityModel) -> None:
    """Heights of both bodies at random: 0 to 400 rows a state, and every result where the caller looks for it."""
    scene, rng = studded.scene, np.random.default_rng(1)
    q, v, u = np.tile(scene.q0, (40, 1)), 0.1 * rng.normal(size=(40, scene.nv)), np.zeros((40, 0))
    q[:, [2, 9]] = rng.choice([0.019, 0.5], (40, 2))
    q[7] = np.nan
    order = rng.permutation(40)
    first, second = (studded.predict(q[k], v[k], u[k], impulse=True) for k in (np.arange(40), order))
    rows = np.count_nonzero(first.impulse[..., 0] > 0, axis=1)
    assert set(rows) == {0, 200, 400}
    assert first.status[7] == 2
    assert np.isnan(first.v_next[7]).all()
    for name in ("q_next", "v_next", "impulse"):
        x = getattr(first, name)
        scale = 1e-9 * max(1.0, np.nanmax(np.abs(x)))
        np.testing.assert_allclose(getattr(second, name), x[order], rtol=0, atol=scale, err_msg=name)
        one = studded.predict(q[:1], v[:1], u[:1], impulse=True)
        np.testing.assert_allclose(getattr(one, name), x[:1], rtol=0, atol=scale, err_msg=name)


def test_loss_of_candidates_is_the_same_on_two_threads(model: ComplementarityModel) -> None:
    q, v, u = batch(model, 80)
    r = model.predict(q, v, u)
    rng, nv = np.random.default_rng(2), model.scene.nv
    theta = model.parameters * rng.uniform(0.9, 1.0, (13, len(model.parameters)))
    log = Transitions(q=q, v=v, u=u, q_next=r.q_next, v_next=r.v_next, dt=model.dt, episode=np.zeros(len(q)))
    windows = Windows(log, np.arange(79), 1, Scales(np.ones(nv), np.ones(nv), 1.0))
    one, two = (m.candidate_losses(theta, windows) for m in (model, model.with_settings(threads=2)))
    np.testing.assert_array_equal(one, two)
    assert (one > 0).all()


def test_order_and_size_of_a_batch_do_not_matter(model: ComplementarityModel) -> None:
    q, v, u = batch(model)
    whole = model.predict(q, v, u, parameter_jacobian=True)
    order = np.random.default_rng(3).permutation(len(q))
    shuffled = model.predict(q[order], v[order], u[order], parameter_jacobian=True)
    single = model.predict(q[:1], v[:1], u[:1], parameter_jacobian=True)
    for name in ("q_next", "v_next", "jacobian"):
        x = getattr(whole, name)
        scale = 1e-12 * max(1.0, np.abs(x).max())
        np.testing.assert_allclose(getattr(shuffled, name), x[order], rtol=0, atol=scale)
        np.testing.assert_allclose(getattr(single, name), x[:1], rtol=0, atol=scale)


@pytest.mark.parametrize("smoothing", [Barrier(1e-4), Gaussian(length=0.01)], ids=["barrier", "gaussian"])
def test_instruction_sets_agree(model: ComplementarityModel, smoothing: Barrier | Gaussian) -> None:
    model = model.with_settings(smoothing=smoothing, path_tolerance=1e-10)
    q, v, u = batch(model, 50)
    cores = instruction_sets(model.scene)
    results = [core.forward(q, v, u, model.parameters, model.stepper.options, jacobian=True) for core in cores]
    assert len({core.isa for core in cores}) == len(cores)
    for other in results[1:]:
        for name in ("q_next", "v_next"):
            np.testing.assert_allclose(other[name], results[0][name], rtol=0, atol=1e-9)
        size = np.abs(results[0]["jacobian"]).max()
        np.testing.assert_allclose(other["jacobian"], results[0]["jacobian"], rtol=0, atol=1e-6 * size)


def test_few_states_take_narrow_packs(model: ComplementarityModel) -> None:
    """As many as a pack of a narrower instruction set holds: its results, and those of wide packs to round-off."""
    best, known = Core(model.scene.core.to_native()), instruction_sets(model.scene)
    narrower = [core for core in known if core.width < best.width]
    if not narrower:
        pytest.skip("this processor's packs are all alike")
    q, v, u = batch(model, 4)
    few, narrow, wide = (
        core.forward(q, v, u, model.parameters, model.stepper.options, jacobian=True)
        for core in (best, narrower[-1], known[-1])
    )
    for name in ("q_next", "v_next", "jacobian"):
        np.testing.assert_array_equal(few[name], narrow[name], err_msg=name)
        size = max(1.0, np.abs(wide[name]).max())
        np.testing.assert_allclose(few[name], wide[name], rtol=0, atol=1e-9 * size, err_msg=name)


def test_substeps_chain(model: ComplementarityModel) -> None:
    """Two substeps are two steps, in value and in Jacobian."""
    model = model.with_settings(integrator="semi-implicit")
    q, v, u = batch(model, 30)
    nv, once = model.scene.nv, model.with_settings(substeps=1)
    two = model.predict(q, v, u, parameter_jacobian=True)
    first = once.predict(q, v, u, parameter_jacobian=True)
    second = once.predict(first.q_next, first.v_next, u, parameter_jacobian=True)
    np.testing.assert_allclose(second.v_next, two.v_next, rtol=0, atol=1e-12)
    chained = second.jacobian[:, :, : 2 * nv] @ first.jacobian
    chained[:, :, 2 * nv :] += second.jacobian[:, :, 2 * nv :]
    np.testing.assert_allclose(chained, two.jacobian, rtol=0, atol=1e-9 * np.abs(chained).max())


def test_empty_batch(model: ComplementarityModel) -> None:
    r = model.predict(*(x[:0] for x in batch(model, 3)), jacobian=True)
    assert r.q_next.shape == (0, model.scene.nq)
    assert r.jacobian.shape[0] == 0
