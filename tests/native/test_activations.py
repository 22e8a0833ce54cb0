"""Actuators with a state: steps of MuJoCo's, activation included, and derivatives against differences."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from cmbrl import ComplementarityModel, Scene, UserError
from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.envs.simulation import Simulation
from cmbrl.mdp import MDP, never

ARM = """<mujoco><option timestep=".01" integrator="{integrator}"/><worldbody><body>
<joint name="shoulder" axis="0 1 0" damping=".3"/><geom type="capsule" size=".04" fromto="0 0 0 .4 0 0"/>
<body pos=".4 0 0"><joint name="elbow" axis="0 0 1" armature=".02"/>
<geom type="capsule" size=".03" fromto="0 0 0 .3 0 0"/><site name="tip" pos=".3 0 0"/></body></body></worldbody>
<actuator>{actuators}</actuator></mujoco>"""
KINDS = {
    "filter": '<general joint="shoulder" dyntype="filter" dynprm=".05" gainprm="20"/>',
    "filter of a servo": '<general joint="shoulder" dyntype="filter" dynprm=".03" gainprm="30" biastype="affine" '
    'biasprm="0 -30 -2" gear="1.5"/>',
    "filterexact, early": '<general joint="elbow" dyntype="filterexact" dynprm=".04" gainprm="9" actearly="true"/>',
    "filterexact at once": '<general joint="elbow" dyntype="filterexact" dynprm="0" gainprm="9"/>',
    "intvelocity": '<intvelocity joint="shoulder" kp="40" kv="1" actrange="-.5 .5"/>',
    "integrator, early": '<general joint="elbow" dyntype="integrator" actlimited="true" actrange="-.02 .03" '
    'actearly="true" gainprm="3" ctrllimited="true" ctrlrange="-1 1"/>',
    "filter, bounds": '<general joint="shoulder" dyntype="filter" dynprm=".02" actlimited="true" actrange="-.3 .2" '
    'gainprm="20" forcelimited="true" forcerange="-3 4" ctrllimited="true" ctrlrange="-1 1"/>',
    "filter on a site": '<general site="tip" gear="0 0 3 0 .2 0" dyntype="filter" dynprm=".05"/>',
    "two and a motor": '<general joint="elbow" dyntype="filterexact" dynprm=".04" gainprm="5"/><motor joint="elbow"/>'
    '<general joint="shoulder" dyntype="integrator" gainprm="5"/>',
}


def write(folder: Path, kind: str, integrator: str = "Euler") -> Path:
    path = folder / "arm.xml"
    path.write_text(ARM.format(integrator=integrator, actuators=KINDS[kind]), encoding="utf-8")
    return path


def states(scene: Scene, count: int) -> list[np.ndarray]:
    """With activations anywhere within their bounds."""
    rng = np.random.default_rng(0)
    q, v, u = (rng.normal(size=(count, size)) for size in (scene.nq, scene.nv, scene.nu))
    low, high = np.clip(np.reshape(scene.core.state_range, (-1, 2)), -1.0, 1.0).T
    return [q, v, np.concatenate([u, rng.uniform(low, high, (count, len(low)))], axis=1)]


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
@pytest.mark.parametrize("kind", KINDS)
def test_steps_are_those_of_mujoco(kind: str, integrator: str, tmp_path: Path) -> None:
    """A control step of three physics steps: next state and next activation to round-off."""
    file = write(tmp_path, kind, integrator)
    scene, model = Scene.from_mjcf(file), mujoco.MjModel.from_xml_path(str(file))
    ours = ComplementarityModel(scene, substeps=3)
    q, v, u = states(scene, 30)
    found = ours.predict(q, v, u)
    assert ours.activations is not None
    activation = ours.activations.next(torch.from_numpy(u)).numpy()
    data = mujoco.MjData(model)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.ctrl[:], data.act[:] = q[k], v[k], u[k, : scene.nu], u[k, scene.nu :]
        mujoco.mj_step(model, data, 3)
        np.testing.assert_allclose(found.v_next[k], data.qvel, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(found.q_next[k], data.qpos, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(activation[k], data.act, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
@pytest.mark.parametrize("kind", KINDS)
def test_derivatives(kind: str, integrator: str, tmp_path: Path) -> None:
    """In q, v, commands, activations and parameters, time constants among them; RK4 files take shifted steps."""
    scene = Scene.from_mjcf(write(tmp_path, kind, integrator))
    row = compare(ComplementarityModel(scene, substeps=3), *states(scene, 8), 40)
    wanted = {"q", "v", "u"} | ({"time_constant"} if ".0" in KINDS[kind].split("dynprm=")[-1][:5] else set())
    assert wanted <= set(row["kinds"])
    assert row["worst"] <= 1e-6, row


@pytest.mark.parametrize("kind", ["filter", "filter, bounds", "two and a motor"])
def test_the_derivative_of_the_next_activation(kind: str, tmp_path: Path) -> None:
    model = ComplementarityModel(Scene.from_mjcf(write(tmp_path, kind)), substeps=3)
    u = torch.from_numpy(states(model.scene, 6)[2]).requires_grad_()
    theta = torch.from_numpy(model.parameters).requires_grad_()
    assert model.activations is not None
    assert torch.autograd.gradcheck(model.activations.next, (u, theta), atol=1e-8)
    other = model.with_parameters(model.parameters * np.where(names(model) == "time_constant", 1.5, 1.0)).activations
    assert other is not None
    assert not torch.equal(other.next(u), model.activations.next(u))


def names(model: ComplementarityModel) -> np.ndarray:
    return np.array([p.group for p in model.scene.parameters])


def test_steps_shifted_by_half_are_nearer_to_a_fine_simulation(tmp_path: Path) -> None:
    """RK4 files: the force takes the mean of the activation before and after, so that the error falls with h^2.

    Without damping, which is implicit and of first order.
    """
    file = write(tmp_path, "filter", "RK4")
    file.write_text(file.read_text().replace('damping=".3"', ""))
    scene, model = Scene.from_mjcf(file), mujoco.MjModel.from_xml_path(str(file))
    q, v, u = states(scene, 20)
    data, truth = mujoco.MjData(model), np.empty_like(v)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.ctrl[:], data.act[:] = q[k], v[k], u[k, :1], u[k, 1:]
        mujoco.mj_step(model, data, 4)
        truth[k] = data.qvel
    coarse, fine = (
        ComplementarityModel(scene, time_step=0.04 / n, substeps=n, integrator="midpoint").predict(q, v, u).v_next
        for n in (8, 16)
    )
    assert np.abs(fine - truth).max() < 0.35 * np.abs(coarse - truth).max()


def test_a_process_on_the_robot_carries_its_activations(tmp_path: Path) -> None:
    """Rewards and states of an episode are MuJoCo's, and the first command's effect has a derivative."""
    file = write(tmp_path, "two and a motor")
    scene, model = Scene.from_mjcf(file), mujoco.MjModel.from_xml_path(str(file))

    def reset(count: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.zeros(count, 2, dtype=torch.float64), torch.zeros(count, 2, dtype=torch.float64)

    mdp = MDP(
        observations=4, actions=3, observe=lambda q, v: torch.cat([q, v], dim=1), terminated=never, reset=reset,
        reward=lambda q, v, a, q_next, v_next: q_next.sum(dim=1), dt=0.02, episode_steps=5,
    )  # fmt: skip
    simulation = Simulation(mdp, ComplementarityModel(scene, substeps=2), 2)
    data = mujoco.MjData(model)
    actions = torch.from_numpy(np.random.default_rng(1).uniform(-1, 1, (5, 1, 3))).requires_grad_()
    for action in actions:
        data.ctrl[:] = action.detach().numpy()[0]
        mujoco.mj_step(model, data, 2)
        step = simulation.step(simulation.observe(), action.expand(2, -1))
        np.testing.assert_allclose(step.next_observation[0, :2].detach().numpy(), data.qpos, atol=1e-9)
    (slope,) = torch.autograd.grad(step.reward.sum(), actions)
    assert (slope[0] != 0).any()
    assert simulation.robots.memory.abs().sum() == 0  # the next episode begins at rest


BETWEEN = '<general joint="elbow" dyntype="filter" dynprm=".02" actlimited="true" actrange=".1 .6" gainprm="3"/>'
HASTY = '<general joint="elbow" dyntype="filter" dynprm=".006" actlimited="true" actrange="-.4 .6" gainprm="3"/>'


@pytest.mark.parametrize("kind", [*KINDS, "limits that leave 0 out", "shorter than a step"])
def test_along_a_log_they_are_those_of_its_steps(kind: str, tmp_path: Path) -> None:
    """From 0 in each episode, and with the derivatives that differences have."""
    path = tmp_path / "arm.xml"
    actuators = {"limits that leave 0 out": BETWEEN, "shorter than a step": HASTY} | KINDS
    path.write_text(ARM.format(integrator="Euler", actuators=actuators[kind]), encoding="utf-8")
    model = ComplementarityModel(Scene.from_mjcf(path), substeps=3)
    activations, nu, rng = model.activations, model.scene.nu, np.random.default_rng(0)
    assert activations is not None
    episode, control = np.repeat([0, 1, 4], [7, 1, 5]), rng.normal(size=(13, nu))
    columns = [k for k in activations.column if k >= 0]
    times = model.parameters[columns]
    rows = activations.along(episode, control, times)
    now = np.zeros((1, len(activations)))
    for k, row in enumerate(rows):
        now = now if k and episode[k] == episode[k - 1] else np.zeros_like(now)
        np.testing.assert_allclose(row[nu:], now[0], atol=1e-14)
        now = activations.next(torch.from_numpy(np.append(control[k], now)[None])).numpy()
    slope = np.concatenate([rng.normal(size=(13, nu, 2)), np.zeros((13, nu, len(times)))], axis=2)
    same, found = activations.slopes_along(episode, control, slope, times)
    np.testing.assert_array_equal(same, rows)
    for n, psi in enumerate(np.eye(slope.shape[2]) * 1e-7):
        ahead, behind = (
            activations.along(episode, control + sign * slope @ psi, times + sign * psi[2:]) for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(found[:, :, n], (ahead - behind) / 2e-7, atol=1e-6, rtol=1e-6)


def test_ignored_they_act_at_once_and_muscles_are_refused_by_name(tmp_path: Path) -> None:
    file = write(tmp_path, "filter")
    scene = Scene.from_mjcf(file, ignore="actuator_dynamics")
    assert scene.core.nstate == 0
    assert "acts at once" in scene.left_out[0].why
    file.write_text(
        ARM.format(integrator="Euler", actuators='<muscle name="biceps" joint="elbow" lengthrange=".1 .5"/>')
    )
    with pytest.raises(UserError, match="'biceps' is not supported: dynamics muscle"):
        Scene.from_mjcf(file)
