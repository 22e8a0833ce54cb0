"""The G1: its file against the reference, and tracking as a decision process on the model and in MuJoCo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from cmbrl.envs.evaluation import evaluate_model, evaluate_real
from cmbrl.envs.of_task import decision_process, real_system, trial_process
from cmbrl.envs.simulation import Simulation
from cmbrl.errors import UserError
from cmbrl.imitation import tracking as terms
from cmbrl.imitation.tracking import Tracking
from cmbrl.mdp import MDP
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.registry import load_task
from cmbrl.tasks.g1 import ROBOT, _warm_up

REFERENCE = Path(__file__).parents[3] / "shared/models/g1_reference.xml"
NU = 29


@pytest.fixture(scope="module")
def model() -> ComplementarityModel:
    task = load_task("g1")
    return ComplementarityModel(task.load_scene(), **task.model_options())


@pytest.fixture(scope="module")
def tracking(model: ComplementarityModel) -> Tracking:
    return Tracking(ROBOT, model.scene, _warm_up(model.scene))


@pytest.fixture(scope="module")
def mdp(tracking: Tracking) -> MDP:
    return tracking.training()


def on_the_reference(tracking: Tracking, frame: int, count: int = 2) -> tuple[torch.Tensor, torch.Tensor]:
    memory = np.concatenate([[frame], np.zeros(NU)])
    q = np.concatenate([tracking.motion.q[frame], memory])
    return torch.from_numpy(np.tile(q, (count, 1))), torch.from_numpy(np.tile(tracking.motion.v[frame], (count, 1)))


@pytest.mark.skipif(not REFERENCE.exists(), reason="needs ../shared/models")
def test_the_file_is_the_published_robot() -> None:
    ours, reference = (mujoco.MjModel.from_xml_path(str(path)) for path in (load_task("g1").scene_path, REFERENCE))
    mass = []
    q = ours.qpos0 + np.r_[np.zeros(7), 0.5 * np.random.default_rng(0).normal(size=NU)]
    for m in (ours, reference):
        data, full = mujoco.MjData(m), np.zeros((m.nv, m.nv))
        data.qpos[:] = q
        mujoco.mj_forward(m, data)
        mujoco.mj_fullM(m, data, full)
        mass.append(full)
    np.testing.assert_allclose(*mass, atol=1e-6)
    for name in ("jnt_range", "actuator_gainprm", "actuator_biasprm", "actuator_forcerange"):
        np.testing.assert_allclose(getattr(ours, name), getattr(reference, name), rtol=1e-6)


def test_perfect_tracking_earns_everything(tracking: Tracking, mdp: MDP) -> None:
    before, after = on_the_reference(tracking, 10), on_the_reference(tracking, 11)
    with torch.no_grad():
        told = tracking.info(*before, torch.zeros(2, NU, dtype=torch.float64), *after)
    for name, (weight, _) in terms.TERMS.items():
        np.testing.assert_allclose(told[name], tracking.dt * weight, rtol=1e-12)
    assert float(told["body_position_error_cm"].max()) == 0
    assert not mdp.terminated(*after).any()
    observation = mdp.observe(*after)
    assert observation.shape == (2, mdp.observations)
    np.testing.assert_allclose(observation[:, 2 * NU : 2 * NU + 3], 0, atol=1e-12)  # the anchor's error


def test_the_rewards_derivative_is_that_of_the_reward(tracking: Tracking) -> None:
    rng = np.random.default_rng(0)
    start = tracking.training().reset(3, torch.Generator().manual_seed(0))
    q, v = tracking.training().reset(3, torch.Generator().manual_seed(1))
    action = torch.from_numpy(rng.uniform(-1, 1, (3, NU)))

    def value(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        return tracking.training().reward(*start, action, q, v) + tracking.observe(q, v).sum(1)

    q, v = q.requires_grad_(), v.requires_grad_()
    gq, gv = torch.autograd.grad(value(q, v).sum(), (q, v))
    at, speed, scene = q.detach().numpy(), v.detach().numpy(), tracking.scene

    def shifted(s: float) -> tuple[torch.Tensor, torch.Tensor]:
        robot = scene.integrate(at[:, :36], s * dq)
        return torch.from_numpy(np.concatenate([robot, at[:, 36:]], axis=1)), torch.from_numpy(speed + s * dv)

    for _ in range(5):
        dq, dv = rng.normal(size=(2, 3, scene.nv))
        ends = [shifted(s) for s in (1e-6, -1e-6)]
        slope = (value(*ends[0]) - value(*ends[1])) / 2e-6
        moved = (ends[0][0] - ends[1][0]) / 2e-6
        np.testing.assert_allclose((gq * moved).sum(1) + (gv * torch.from_numpy(dv)).sum(1), slope.detach(), rtol=1e-5)


def test_gradients_reach_the_actions_through_steps(model: ComplementarityModel, mdp: MDP) -> None:
    simulation = Simulation(mdp, model, 4, seed=0)
    action = torch.zeros(4, NU, requires_grad=True)
    total = torch.zeros((), dtype=torch.float64)
    for _ in range(3):
        total = total + simulation.step(simulation.observe(), action).reward.sum()
    total.backward()
    assert action.grad is not None
    assert torch.isfinite(action.grad).all()
    assert (action.grad.abs().sum(1) > 0).all()


def test_frames_and_actions_are_remembered(model: ComplementarityModel, mdp: MDP) -> None:
    simulation = Simulation(mdp, model, 4, seed=0)
    frame = simulation.q[:, -1 - NU].clone()
    action = torch.full((4, NU), 0.1, dtype=torch.float64)
    step = simulation.step(simulation.observe(), action)
    goes_on = ~(step.terminated | step.truncated)
    np.testing.assert_array_equal(simulation.q[goes_on, -1 - NU], frame[goes_on] + 1)
    np.testing.assert_array_equal(simulation.q[goes_on, -NU:], action[goes_on])
    assert simulation.q.shape == (4, 36 + 1 + NU)


def test_falls_end_episodes_and_the_last_frame_cuts_them(tracking: Tracking, mdp: MDP) -> None:
    q, v = on_the_reference(tracking, tracking.last, 3)
    assert mdp.truncated is not None
    assert mdp.truncated(q, v).all()
    assert not mdp.terminated(q, v).any()
    q[0, 2] += 0.3
    q[1, 3:7] = torch.tensor([np.cos(0.8), np.sin(0.8), 0, 0])
    assert mdp.terminated(q, v).tolist() == [True, True, False]


def test_without_a_policy_it_falls_alike_in_model_and_mujoco(model: ComplementarityModel) -> None:
    task = load_task("g1")
    trial = trial_process(task)
    assert trial.episode_steps == 600

    def still(observation: torch.Tensor) -> torch.Tensor:
        return torch.zeros(len(observation), trial.actions)

    real = evaluate_real(still, trial, real_system(task), 3, seed=0, keep=True)
    ours = evaluate_model(still, trial, model, 3, seed=0)
    assert real.terminated.all()
    assert ours.terminated.all()
    np.testing.assert_allclose(real.lengths, ours.lengths, atol=4)
    np.testing.assert_allclose(real.returns, ours.returns, rtol=0.05)
    assert real.info["body_position_error_cm"].shape == (3,)
    assert real.q[0].shape[1] == 36


def test_logs_hold_the_robot_alone() -> None:
    data = load_task("g1").record(30, seed=0)
    assert data.q.shape == (30, 36)
    assert data.u.shape == (30, NU)
    assert decision_process(load_task("g1")).memory == 1 + NU


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"anchor": "head"}, "'head' is not among the tracked bodies"),
        ({"tracked": ROBOT.tracked[::-1]}, "the first tracked body has to be the root, 'pelvis'"),
        ({"posture": {"left_kne_joint": 0.1}}, "no joint 'left_kne_joint': did you mean 'left_knee_joint'"),
    ],
)
def test_a_robot_that_does_not_fit_its_scene_is_refused(tracking: Tracking, changes: dict, told: str) -> None:
    with pytest.raises(UserError, match=told):
        Tracking(replace(ROBOT, **changes), tracking.scene, tracking.motion)


def test_a_scene_without_servos_is_refused(tracking: Tracking) -> None:
    with pytest.raises(UserError, match=r"needs position servos.*drives="):
        Tracking(ROBOT, load_task("hopper").load_scene(), tracking.motion)


def test_flight_and_depth_are_measured(tracking: Tracking) -> None:
    """The own motion never leaves the ground; a reference that hops is kept in flight only by a robot that does."""
    before, after = on_the_reference(tracking, 10), on_the_reference(tracking, 11)
    still = torch.zeros(2, NU, dtype=torch.float64)
    with torch.no_grad():
        told = tracking.info(*before, still, *after)
    assert "flight_kept" not in told
    assert float(told["penetration_mm"].max()) < 1e-6
    sunk = (after[0].clone(), after[1])
    sunk[0][:, 2] -= 0.004
    q = tracking.motion.q.copy()
    q[11:21, 2] += 0.1
    hopping = Tracking(ROBOT, tracking.scene, replace(tracking.motion, q=q))
    with torch.no_grad():
        assert tracking.info(*before, still, *sunk)["penetration_mm"].numpy() == pytest.approx(4.0, abs=1e-6)
        assert hopping.info(*before, still, *after)["flight_kept"].tolist() == [0.0, 0.0]
        up = on_the_reference(hopping, 11)
        assert hopping.info(*before, still, *up)["flight_kept"].tolist() == [len(q) / 10] * 2
