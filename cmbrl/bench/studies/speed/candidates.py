"""What it costs to score parameter candidates, per candidate and state, in three ways.

Alone: one candidate after the other, each on a batch of states, one state a lane (``candidate_losses`` of one).
States packed: the same by plain steps (``predict``).
Candidates packed: a batch of candidates on one state after the other, one candidate a lane (``candidate_losses``). Its
lanes share the state, and with it the contacts and nearly the number of solver iterations.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cmbrl.bench.peers.mujoco_steps import Visited
from cmbrl.bench.timing import Spread, Work, interleaved
from cmbrl.data.transitions import Transitions
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.windows import Scales, Windows

STATES = 256  #: at most; spread over the visited ones
ALONE = 8  #: candidates that go alone in a turn; their cost does not depend on their number


def compare_candidates(
    model: ComplementarityModel, visited: Visited, candidates: int, repeats: int, seed: int
) -> dict[str, Any]:
    """Seconds of the three ways; ``gain`` and ``gain_over_states`` are the ratios of the first two to the last."""
    chosen = np.linspace(0, len(visited.q) - 1, min(STATES, len(visited.q))).astype(int)
    arrays = {name: getattr(visited, name)[chosen] for name in ("q", "v", "u", "q_next", "v_next")}
    rows = Transitions(**arrays, dt=model.dt, episode=np.arange(len(chosen)))
    scale = np.ones(model.scene.nv)
    windows = Windows(rows, np.arange(len(chosen)), 1, Scales(scale, scale, 1.0))
    theta = draw(model, candidates, seed)
    alone = theta[:ALONE]

    def loss(of: np.ndarray) -> object:
        return model.candidate_losses(of, windows)

    n = len(chosen)
    work: Work = {
        "one": (lambda: [loss(row[None]) for row in alone], n * len(alone)),
        "states": (lambda: [model.predict(rows.q, rows.v, rows.u, theta=row) for row in alone], n * len(alone)),
        "candidates": (lambda: loss(theta), n * len(theta)),
    }
    seconds = interleaved(work, repeats)
    one, states, packed = (seconds[name] for name in work)
    return {
        "candidates": candidates,
        "alone": Spread.of(one),
        "states_packed": Spread.of(states),
        "candidates_packed": Spread.of(packed),
        "gain": Spread.of(one / packed),
        "gain_over_states": Spread.of(states / packed),
    }


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
