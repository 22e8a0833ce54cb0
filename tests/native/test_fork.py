"""A child made by fork steps a model of its parent, with as many threads."""

from __future__ import annotations

import multiprocessing
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection

import numpy as np
import pytest

from cmbrl.bench.states import Ranges, random_states
from cmbrl.contact import Barrier
from cmbrl.contact.solvers.native import solve
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.named import nominal_model
from cmbrl.registry import load_task
from cmbrl.scene import Scene

from ..scene.conftest import GYMNASIUM

HOPPER = next(file for file in GYMNASIUM if file.stem == "hopper")
pytestmark = pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")


def in_child(work: Callable[[], np.ndarray], seconds: float = 30) -> np.ndarray:
    def send(end: Connection) -> None:
        end.send(work())

    ours, theirs = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=send, args=(theirs,))
    child.start()
    try:
        assert ours.poll(seconds), "the child hangs"
        return ours.recv()
    finally:
        child.kill()
        child.join()


@pytest.mark.parametrize("threads", [1, 2])
def test_a_child_steps_to_the_same_bits(threads: int) -> None:
    model = ComplementarityModel(Scene.from_mjcf(HOPPER), smoothing=Barrier(1e-4), threads=2)
    q, v, u = random_states(model.scene, 300, np.random.default_rng(0), Ranges())
    parent = model.predict(q, v, u).v_next
    model.stepper.threads = threads
    np.testing.assert_array_equal(in_child(lambda: model.predict(q, v, u).v_next), parent)
    np.testing.assert_array_equal(in_child(lambda: model.predict(q, v, u).v_next), parent)
    np.testing.assert_array_equal(model.predict(q, v, u).v_next, parent)


def test_a_child_solves_contact_problems() -> None:
    model = ComplementarityModel(Scene.from_mjcf(HOPPER))
    q, v, u = random_states(model.scene, 100, np.random.default_rng(0), Ranges())
    problems = model.contact_problems(q, v, u)
    sizes = [p.J.shape for p in problems]
    most = max(set(sizes), key=sizes.count)
    problems = [p for p in problems if p.J.shape == most]
    parent = solve(problems, threads=2).v
    np.testing.assert_array_equal(in_child(lambda: solve(problems, threads=2).v), parent)


def test_asynchronous_environments_of_gymnasium() -> None:
    gymnasium = pytest.importorskip("gymnasium")
    from cmbrl.envs.registration import make_model

    model = nominal_model(load_task("hopper")).with_settings(threads=2)
    q, v, u = random_states(model.scene, 300, np.random.default_rng(0), Ranges())
    expected = model.predict(q, v, u).v_next

    class AlsoSteps(gymnasium.Wrapper):  # one environment is one row, which needs no second thread
        def step(self, action: np.ndarray) -> tuple:
            np.testing.assert_array_equal(model.predict(q, v, u).v_next, expected)
            return self.env.step(action)

    def make() -> gymnasium.Env:
        return AlsoSteps(make_model("hopper", model))

    environments = gymnasium.vector.AsyncVectorEnv([make, make], context="fork")
    try:
        environments.reset(seed=0)
        for _ in range(3):
            environments.step_async(np.zeros(environments.action_space.shape, np.float32))
            observation, *_ = environments.step_wait(timeout=30)
        assert np.isfinite(observation).all()
    finally:
        environments.close(terminate=True)


def test_a_fork_in_the_middle_of_a_batch() -> None:
    """Another thread of the parent holds the model's lock while it forks; nobody would release it in the child."""
    model = ComplementarityModel(Scene.from_mjcf(HOPPER), 8, smoothing=Barrier(1e-6), threads=2)
    states = random_states(model.scene, 200, np.random.default_rng(0), Ranges())
    expected = model.predict(*states).v_next
    other = threading.Thread(target=model.predict, args=[np.tile(x, (100, 1)) for x in states])
    other.start()
    time.sleep(0.05)
    np.testing.assert_array_equal(in_child(lambda: model.predict(*states).v_next), expected)
    assert other.is_alive(), "the batch was too short to test anything"
    other.join()
