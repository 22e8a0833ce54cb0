"""Ctrl-C ends a native call within half a second, and the model steps on."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from cmbrl.bench.states import Ranges, random_states
from cmbrl.contact import Barrier
from cmbrl.contact.solvers.native import Batch
from cmbrl.data.transitions import Transitions
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.windows import Scales, Windows
from cmbrl.scene import Scene

from ..scene.conftest import GYMNASIUM

HOPPER = next(file for file in GYMNASIUM if file.stem == "hopper")
DELAY, ANSWER = 0.2, 0.5  # [s]


@contextmanager
def interrupted() -> Iterator[None]:
    timer = threading.Timer(DELAY, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    start = time.perf_counter()
    try:
        with pytest.raises(KeyboardInterrupt):
            yield
    finally:
        timer.cancel()
    assert DELAY / 2 < time.perf_counter() - start < DELAY + ANSWER


def calls(model: ComplementarityModel, count: int) -> dict[str, Callable[[], object]]:
    """Native calls of seconds and more."""
    few = random_states(model.scene, 200, np.random.default_rng(0), Ranges())
    q, v, u = (np.tile(x, (count // 200, 1)) for x in few)
    log = Transitions(q=q, v=v, u=u, q_next=q, v_next=v, dt=model.dt, episode=np.zeros(len(q)))
    windows = Windows(log, np.arange(len(q) - 50), 50, Scales(np.ones(model.scene.nv), np.ones(model.scene.nv), 1.0))
    long = model.with_settings(substeps=2**30)
    problems = Batch.of([p for p in model.contact_problems(*few) if p.J.shape[0] == 2][:8])
    arrays = {name: x for name, x in vars(problems).items() if x is not None}
    many = Batch(**{name: np.repeat(x, count // 10, axis=0) for name, x in arrays.items()})
    return {
        "many rows": lambda: model.predict(q, v, u),
        "jacobian": lambda: model.predict(*(x[: count // 4] for x in (q, v, u)), jacobian=True),
        "many substeps": lambda: long.predict(*few),
        "loss": lambda: model.candidate_losses(np.tile(model.parameters, (64, 1)), windows),
        "problems": lambda: [many.native().solve(1e-13, np.full(len(many.M), 1e-9), model.threads) for _ in range(100)],
    }


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("call", ["many rows", "jacobian", "many substeps", "loss", "problems"])
def test_an_interrupted_call(call: str, threads: int) -> None:
    model = ComplementarityModel(Scene.from_mjcf(HOPPER), 8, smoothing=Barrier(1e-6), threads=threads)
    q, v, u = random_states(model.scene, 150, np.random.default_rng(0), Ranges())
    before = model.predict(q, v, u).v_next
    work = calls(model, 200_000)[call]
    with interrupted():
        work()
    np.testing.assert_array_equal(model.predict(q, v, u).v_next, before)


def test_waiting_for_another_threads_batch_is_interrupted() -> None:
    model = ComplementarityModel(Scene.from_mjcf(HOPPER), 8, smoothing=Barrier(1e-6))
    states = random_states(model.scene, 200, np.random.default_rng(0), Ranges())
    rows = [np.tile(x, (250, 1)) for x in states]
    other = threading.Thread(target=model.predict, args=rows)
    other.start()
    time.sleep(0.05)
    with interrupted():
        model.predict(*states)
    other.join()


def test_a_signal_handler_that_steps_the_model_is_refused() -> None:
    model = ComplementarityModel(Scene.from_mjcf(HOPPER), 8, smoothing=Barrier(1e-6))
    states = random_states(model.scene, 200, np.random.default_rng(0), Ranges())
    rows = [np.tile(x, (250, 1)) for x in states]
    before = signal.signal(signal.SIGUSR1, lambda *_: model.predict(*states))
    timer = threading.Timer(DELAY, os.kill, (os.getpid(), signal.SIGUSR1))
    timer.start()
    try:
        with pytest.raises(RuntimeError, match="in the middle of a batch"):
            model.predict(*rows)
    finally:
        timer.join()
        signal.signal(signal.SIGUSR1, before)
