"""The problem that a step solves, on its own: the step's own answer solves it better the smaller kappa is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.states import bench_scene, random_states
from cmbrl.contact import Barrier
from cmbrl.contact.certificates import residuals
from cmbrl.contact.problem import ContactProblem
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene


def impulses(problem: ContactProblem, v_next: np.ndarray, contact: np.ndarray) -> np.ndarray:
    """Rows' impulses: those of contacts as the step reports them, those of limits from the momentum that is left."""
    impulse = np.zeros_like(problem.b)
    impulse[: len(contact)] = contact
    left = problem.M @ (v_next - problem.v_free) - np.einsum("crv,cr->v", problem.J, impulse)
    limit = problem.J[len(contact) :, 0]
    impulse[len(contact) :, 0] = limit @ left
    return impulse


@pytest.mark.parametrize("law", ["rigid", "mujoco", "logistic"])
@pytest.mark.parametrize("name", ["hopper", "cheetah", "cube_toss", "g1"])
def test_the_steps_answer_solves_the_exported_problem(name: str, law: str) -> None:
    scene = bench_scene(name, law)
    q, v, u = random_states(scene, 40, np.random.default_rng(1))
    worst, rows = [], 0
    for kappa in (1e-6, 1e-8, 1e-10):
        model = ComplementarityModel(scene, smoothing=Barrier(kappa), path_tolerance=1e-6, damping="coupled")
        answer = model.predict(q, v, u, impulse=True)
        active = model.stepper.core.rows(q, v, u, model.parameters, model.stepper.options)["active"].astype(bool)
        scores = []
        for k, problem in enumerate(model.contact_problems(q, v, u)):
            contact = answer.impulse[k, active[k, : len(answer.impulse[k])]]
            scores.append(residuals(problem, answer.v_next[k], impulses(problem, answer.v_next[k], contact)))
            rows += len(problem.mu)
        worst.append(max(s.natural_map for s in scores))
        assert max(s.dynamics for s in scores) < 1e-8
    assert rows > 150
    assert worst[1] < 0.2 * worst[0]
    assert worst[2] < 0.2 * worst[1]


def test_dry_friction_of_joints_is_part_of_the_free_velocity(tmp_path: Path) -> None:
    """A mass on a slide falls on a floor; friction of the joint takes 3 N of its weight: the rest is the floor's."""
    xml = """<mujoco><option timestep="0.01"/><worldbody><geom type="plane" size="1 1 1"/>
      <body pos="0 0 0.1"><joint type="slide" axis="0 0 1" frictionloss="3" solreffriction="1e-2 1"/>
      <geom type="sphere" size="0.1" mass="1"/></body></worldbody></mujoco>"""
    (tmp_path / "fall.xml").write_text(xml)
    scene = Scene.from_mjcf(tmp_path / "fall.xml", contact_law="rigid")
    model = ComplementarityModel(scene, smoothing=Barrier(1e-10))
    state = np.zeros((1, 1)), np.full((1, 1), -1.0), np.zeros((1, 0))
    (problem,) = model.contact_problems(*state)
    v_next = model.predict(*state).v_next[0]
    assert problem.v_free[0] > -1.0 - 9.81 * 0.01
    normal = problem.M[0, 0] * (v_next[0] - problem.v_free[0])
    impulse = np.zeros_like(problem.b)
    impulse[0, 0] = normal / problem.J[0, 0, 0]
    assert residuals(problem, v_next, impulse).natural_map < 1e-6
