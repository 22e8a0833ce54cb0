"""Dojo's hopper and half-cheetah: the facts they are written from, and that they stand."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cmbrl.contact import Exact
from cmbrl.envs.evaluation import evaluate_model, evaluate_real
from cmbrl.envs.system_batch import SystemBatch
from cmbrl.models.named import nominal_model
from cmbrl.models.protocol import rollout
from cmbrl.tasks.dojo import CHEETAH, HOPPER
from cmbrl.tasks.dojo import mdp as processes

BOTH = pytest.mark.parametrize("task", [HOPPER, CHEETAH], ids=lambda task: task.name)
MASSES = {
    HOPPER: {"torso": 3.53429, "thigh": 3.92699, "leg": 2.71433, "foot": 5.08938},
    CHEETAH: {
        "torso": 6.36031, "bthigh": 1.5352, "bshin": 1.5809, "bfoot": 1.069, "fthigh": 1.42558, "fshin": 1.17885,
        "ffoot": 0.84986,
    },
}  # fmt: skip


@BOTH
def test_masses_and_contacts(task):
    scene = task.load_scene()
    assert scene.planar
    model = task.system().model
    for name, mass in MASSES[task].items():
        assert model.body(name).mass[0] == pytest.approx(mass, abs=1e-5)
    assert scene.total_mass == pytest.approx({HOPPER: 15.265, CHEETAH: 14.0}[task], abs=1e-3)
    assert sum(g.startswith("friction.") for g in (p.name for p in scene.parameters)) == {HOPPER: 5, CHEETAH: 9}[task]


def test_the_hoppers_lengths_and_radii_belong_to_its_masses():
    """Dojo's capsules of length L and radius r weigh 1,000 pi r^2 (L + r) kg."""
    model = HOPPER.system().model
    for name, mass in MASSES[HOPPER].items():
        radius, half = model.geom(name).size[:2]
        assert mass == pytest.approx(1000 * np.pi * radius**2 * (2 * half + radius), rel=1e-5)


def test_the_cheetahs_rest_posture_stands_on_both_feet():
    """The published rest height and pitch put both toes on the floor, to millimetres."""
    robot = CHEETAH.system()
    q = np.zeros(9)
    q[1:3] = processes.REST_HEIGHT, processes.REST_PITCH
    robot.reset(q, np.zeros(9))
    toes = [robot.data.geom(name).xpos[2] - 0.046 for name in ("btoe", "ftoe")]
    assert np.abs(toes).max() < 5e-3


@BOTH
def test_dropped_it_comes_to_stand_like_mujoco_and_the_floor_carries_its_weight(task):
    model = nominal_model(task, smoothing=Exact())
    q, _ = task.mdp().reset(1, torch.Generator().manual_seed(3))
    u = torch.zeros(1, 20, model.scene.nu, dtype=torch.float64)
    (q_real, _), (q_ours, v_ours) = (
        rollout(m, q, torch.zeros_like(q), u) for m in (SystemBatch(task.system, 1), model)
    )
    assert (q_real[:, -1] - q_ours[:, -1]).abs().max() < 0.02
    assert model.failures == 0
    step = model.predict(q_ours[:, -1].numpy(), v_ours[:, -1].numpy(), u[:, 0].numpy(), impulse=True)
    weight = 9.81 * model.scene.total_mass * model.dt
    assert step.impulse[0, :, 0].sum() == pytest.approx(weight, rel=0.02)


@BOTH
def test_springs_are_stable_at_the_long_step(task):
    """Nothing but springs and dampers, far from the floor: the energy of the joints goes down."""
    model = nominal_model(task, smoothing=Exact())
    q, v = task.mdp().reset(8, torch.Generator().manual_seed(0))
    q[:, 1] += 50.0
    u = torch.zeros(8, model.scene.nu, dtype=torch.float64)
    first = q[:, 3:].abs().max()
    for _ in range(30):
        q, v = model.step(q, v, u)
    assert torch.isfinite(q).all()
    assert q[:, 3:].abs().max() < first


def test_rewards_and_ends():
    hopper, cheetah = HOPPER.mdp(), CHEETAH.mdp()
    q = torch.zeros(4, 6, dtype=torch.float64)
    q[:, 1] = torch.tensor([1.25, 0.7, 1.25, 1.25])
    q[2, 2], q[3, 5] = 0.2, 100.0
    v = torch.full((4, 6), 12.0, dtype=torch.float64)
    action = torch.ones(4, 3, dtype=torch.float64)
    assert hopper.terminated(q, v).tolist() == [False, True, True, True]
    assert hopper.reward(q, v, action, q, v).tolist() == pytest.approx([12.1 - 3e-4] * 4)
    assert hopper.observe(q, v).shape == (4, 11)
    assert hopper.observe(q, v)[:, 5:].max() == 10.0
    wide = torch.full((2, 9), 0.5, dtype=torch.float64)
    assert cheetah.reward(wide, wide, torch.ones(2, 6), wide, wide).tolist() == pytest.approx([0.5 - 0.6] * 2)
    assert cheetah.observe(wide, wide).shape == (2, 18)
    assert not cheetah.terminated(wide, wide * torch.nan).any()


@BOTH
def test_random_actions_earn_finite_rewards_in_the_model_and_in_mujoco(task):
    mdp, generator = task.mdp(), torch.Generator().manual_seed(0)

    def actor(observation):
        return 2 * torch.rand(len(observation), mdp.actions, generator=generator) - 1

    model = nominal_model(task)
    inside = evaluate_model(actor, mdp, model, 8)
    world = evaluate_real(actor, mdp, task.system, 2)
    assert np.isfinite(inside.returns).all()
    assert np.isfinite(world.returns).all()
    assert model.failures == 0
    assert (inside.lengths == 80).all() == (task is CHEETAH)


@BOTH
def test_recording(task):
    log = task.record(30, seed=1)
    log.check(task.load_scene(), dt=task.control_dt)
    assert np.array_equal(task.record(10, seed=1).q_next, log.q_next[:10])
    assert log.actuator_names[0] == ("thigh" if task is HOPPER else "bthigh")
    pushed = task.record(3, behaviour=lambda observation: np.full(task.mdp().actions, 3.0))
    assert (pushed.u == 1.0).all()
