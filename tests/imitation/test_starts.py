"""Where training episodes start: uniform at first, then before failures; and training that goes on where it stopped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl.envs.simulation import Simulation
from cmbrl.imitation.starts import UNIFORM, Starts
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.registry import load_task
from cmbrl.train.running.run import TrainingRun
from cmbrl.train.setup import set_up

FRAMES, DT = 500, 0.02


def starts() -> Starts:
    return Starts(FRAMES, DT, lambda q: (q, q[:, 0].long(), q))


def share(s: Starts, low: int, high: int) -> float:
    frames = s.draw(20_000, torch.Generator().manual_seed(0))
    assert 0 <= int(frames.min()) <= int(frames.max()) < FRAMES
    return float(((frames >= low) & (frames < high)).double().mean())


def test_uniform_without_failures() -> None:
    s = starts()
    s.ended(torch.full((10, 1), 120.0), torch.zeros(10, dtype=torch.bool))
    for low in range(0, FRAMES, 50):
        assert share(s, low, low + 50) == pytest.approx(0.1, abs=0.01)


def test_failures_draw_starts_before_them() -> None:
    s = starts()
    for _ in range(200):
        s.ended(torch.full((50, 1), 320.0), torch.ones(50, dtype=torch.bool))
    assert share(s, 150, 350) == pytest.approx(1 - UNIFORM * 0.6, abs=0.02)
    assert share(s, 300, 350) > share(s, 250, 300) > share(s, 200, 250) > share(s, 100, 150)


def test_the_state_is_all_that_a_draw_depends_on() -> None:
    one, other = starts(), starts()
    one.ended(torch.tensor([[10.0], [480.0]]), torch.tensor([True, True]))
    other.restore(one.state())
    one, other = (s.draw(50, torch.Generator().manual_seed(1)) for s in (one, other))
    np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_training_resumes_to_the_same_bits(tmp_path: Path) -> None:
    sizes = {"environments": "4", "horizon": "3", "actor_hidden": "8", "critic_hidden": "8", "iterations": "6"}
    for folder, parts in (("whole", (6,)), ("parts", (3, 6))):
        for k, iterations in enumerate(parts):
            trainer = set_up("g1", "shac", "nominal", sizes, threads=1).trainer()
            TrainingRun(trainer, tmp_path / folder, {}, resume=k > 0).train(iterations)
    weights = [(tmp_path / folder / "policy.safetensors").read_bytes() for folder in ("whole", "parts")]
    assert weights[0] == weights[1]


def test_a_restart_by_seed_forgets_failures() -> None:
    task = load_task("g1")
    model = ComplementarityModel(task.load_scene(), **task.model_options())
    assert task.mdp is not None
    simulation = Simulation(task.mdp(), model, 16, seed=3)
    first = simulation.q.clone()
    for _ in range(100):
        simulation.step(simulation.observe(), torch.zeros(16, 29))
    assert simulation.mdp.curriculum is not None
    assert simulation.mdp.curriculum.state()["failures"].sum() > 0
    simulation.restart(seed=3)
    np.testing.assert_array_equal(simulation.q, first)
