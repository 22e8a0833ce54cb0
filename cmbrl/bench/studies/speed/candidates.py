"""What it costs to score parameter candidates: a pack of candidates on one state against one candidate after the other.

Per candidate and state, three ways:
  one by one: one candidate on one state at a time, a pack with a single useful lane (``candidate_loss`` of one);
  states packed: one candidate on a batch of different states, one state a lane (``predict``);
  candidates packed: a batch of candidates on one state after the other, one candidate a lane (``candidate_loss``):
    lanes share the state, so they share contacts and nearly the number of solver iterations.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cmbrl.bench.studies.speed.mujoco_peer import Visited
from cmbrl.bench.timing import Spread, interleaved
from cmbrl.data.transitions import Transitions
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.windows import Scales, Windows

STATES = 256  #: at most; spread over the visited ones
ALONE = 8  #: candidates that go one by one in a turn: their cost does not depend on their number


def compare_candidates(
    model: ComplementarityModel,
    visited: Visited,
    candidates: int,
    repeats: int,
    seed: int,
    progress: Callable[[int], object] | None = None,
) -> tuple[Spread, Spread, Spread, Spread, Spread]:
    """Seconds one by one, with states packed, with candidates packed; ratios of the first two over the last."""
    chosen = np.linspace(0, len(visited.q) - 1, min(STATES, len(visited.q))).astype(int)
    q, v, u = (np.ascontiguousarray(x[chosen]) for x in (visited.q, visited.v, visited.u))
    q_next, v_next = (np.ascontiguousarray(x[chosen]) for x in (visited.q_next, visited.v_next))
    log = Transitions(q=q, v=v, u=u, q_next=q_next, v_next=v_next, dt=model.dt, episode=np.zeros(len(q)))
    one = np.ones(model.scene.nv)
    windows = Windows(log, np.arange(len(chosen)), 1, Scales(one, one, 1.0))
    theta = draw(model, candidates, seed)
    alone = theta[:ALONE]

    def loss(of: np.ndarray) -> None:
        model.candidate_loss(of, windows)

    def one_by_one() -> None:
        for row in alone:
            loss(row[None])

    def states_packed() -> None:
        for row in alone:
            model.predict(q, v, u, theta=row)

    n = len(chosen)
    work: dict[str, tuple[Callable[[], object], int]] = {
        "one": (one_by_one, n * len(alone)),
        "states": (states_packed, n * len(alone)),
        "candidates": (lambda: loss(theta), n * len(theta)),
    }
    s = interleaved(work, repeats, progress=progress)
    packed = s["candidates"]
    return (
        Spread.of(s["one"]),
        Spread.of(s["states"]),
        Spread.of(packed),
        Spread.of(s["one"] / packed),
        Spread.of(s["states"] / packed),
    )


def draw(model: ComplementarityModel, count: int, seed: int) -> np.ndarray:
    """Candidates (count, np) near the model: scales within 5 %, other parameters 5 % of the way to a bound."""
    rng = np.random.default_rng(seed)
    theta = np.tile(model.parameters, (count, 1))
    for k, p in enumerate(model.scene.parameters):
        noise = 0.05 * rng.uniform(-1, 1, count)
        if p.transform == "log":
            theta[:, k] *= np.exp(noise)
        else:
            theta[:, k] += np.where(noise > 0, noise * (p.high - theta[:, k]), noise * (theta[:, k] - p.low))
        theta[:, k] = np.clip(theta[:, k], p.low, p.high)
    return theta
