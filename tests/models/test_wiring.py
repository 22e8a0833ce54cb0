"""Late commands step by step: the same as through a log, differentiable, and at rest when an episode begins."""

from pathlib import Path

import numpy as np
import pytest
import torch

from cmbrl import ComplementarityModel, Scene, Transitions
from cmbrl.envs.disturbance import Disturbance, parameter_sets
from cmbrl.envs.simulation import Simulation
from cmbrl.mdp import MDP, never
from cmbrl.models.between.observation import Observation
from cmbrl.models.between.robots import Robots, wiring_of
from cmbrl.models.between.wiring import Wiring
from cmbrl.models.protocol import rollout

DT = 0.01
ARM = """
<mujoco><worldbody><body>
  <joint name="a" axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/>
  <body pos=".3 0 0"><joint name="b" axis="0 1 0" damping=".1"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/>
</body></body></worldbody>
<actuator><position joint="a" kp="20" kv="1" gear="2"/><motor joint="b"/></actuator></mujoco>
"""
LATE = [(0.0, 0.02), (0.004, 0.0), (0.01, 0.0), (0.02, 0.013), (0.027, 0.03), (0.0, 0.0)]


@pytest.fixture
def arm(tmp_path: Path) -> Scene:
    (tmp_path / "arm.xml").write_text(ARM)
    return Scene.from_mjcf(tmp_path / "arm.xml")


def model_of(
    arm: Scene, delay: float, lag: float, bias: float = 0.0, lead: float = 0.0, integral: float = 0.0, ramp: float = 0.0
) -> ComplementarityModel:
    observation = {"delay.command": delay, "lag.command": lag, "bias.a": bias, "bias.b": -bias}
    servo = arm.actuator_names[0]
    observation |= {f"lead.{servo}": lead, f"integral.{servo}": integral, f"ramp.{servo}": ramp}
    return ComplementarityModel(arm, time_step=DT, observation=observation)


def commands(rows: int, count: int = 3) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(0).normal(size=(rows, count, 2)))


@pytest.mark.parametrize(("lead", "ramp"), [(0.0, 0.0), (0.04, 0.0), (0.04, 0.02)])
@pytest.mark.parametrize(("delay", "lag"), LATE)
def test_commands_arrive_as_a_log_says(arm: Scene, delay: float, lag: float, lead: float, ramp: float) -> None:
    """Also those before the first one: a servo held it, a motor was off."""
    given = commands(40)
    log = Transitions(
        q=np.zeros((120, 2)), v=np.zeros((120, 2)), u=given.transpose(0, 1).reshape(120, 2).numpy(),
        q_next=np.zeros((120, 2)), v_next=np.zeros((120, 2)), dt=DT, episode=np.repeat(np.arange(3), 40),
    )  # fmt: skip
    model = model_of(arm, delay, lag, bias=0.03, lead=lead, ramp=ramp)
    expected = model.seen(log).u.reshape(3, 40, 2)
    wiring = model.wiring
    assert wiring is not None
    memory, found = wiring.begin(3), []
    for command in given:
        _, control, memory = wiring.arrive(memory, command)
        found.append(control + wiring.shift)
    np.testing.assert_allclose(torch.stack(found, dim=1).numpy(), expected, atol=1e-8)


@pytest.mark.parametrize(("lead", "ramp"), [(0.0, 0.0), (0.04, 0.0), (0.04, 0.02)])
@pytest.mark.parametrize(("delay", "lag"), LATE[:-1])
def test_the_derivative_of_a_rollout_in_its_commands(
    arm: Scene, delay: float, lag: float, lead: float, ramp: float
) -> None:
    wiring = model_of(arm, delay, lag, lead=lead, ramp=ramp).wiring
    assert wiring is not None

    def arrived(given: torch.Tensor) -> torch.Tensor:
        memory, found = wiring.begin(1), []
        for command in given:
            _, control, memory = wiring.arrive(memory, command)
            found.append(control)
        return torch.cat(found)

    assert torch.autograd.gradcheck(arrived, commands(5, 1).requires_grad_(), atol=1e-9)


def test_no_process_acts_before_it_is_told(arm: Scene) -> None:
    """How far commands are ahead is told of a log's samples; what that leaves of the lag is the robot's."""
    observer = Observation.of(arm, DT, step=0.2 * DT)
    late = {"ahead.command": 0.4 * DT}
    assert Wiring.of(observer, observer.vector(late), arm.nq) is None
    wiring = Wiring.of(observer, observer.vector(late | {"lag.command": 3.0 * DT}), arm.nq)
    assert wiring is not None
    assert float(wiring.delay) == 0.0
    assert float(wiring.lag) == pytest.approx(2.6 * DT)


def test_a_model_without_lateness_is_stepped_as_it_is(arm: Scene) -> None:
    model = model_of(arm, 0.0, 0.0)
    assert model.wiring is None
    robots = Robots(model, 2)
    assert robots.memory.shape == (2, 0)
    assert robots.step == model.step
    assert wiring_of(object()) is None
    psi = np.array([*np.zeros(9), 1e-6, 0.0])  # far below a step
    assert Wiring.of(Observation.of(arm, DT), psi, arm.nq) is None


def process(arm: Scene, length: int) -> MDP:
    def reset(count: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.zeros(count, 2, dtype=torch.float64), torch.zeros(count, 2, dtype=torch.float64)

    return MDP(
        observations=4, actions=2, observe=lambda q, v: torch.cat([q, v], dim=1), terminated=never, reset=reset,
        reward=lambda q, v, a, q_next, v_next: -q_next.square().sum(dim=1), dt=DT, episode_steps=length,
    )  # fmt: skip


@pytest.mark.parametrize("integral", [0.0, 5.0])
def test_a_simulation_moves_as_the_log_that_it_would_leave(arm: Scene, integral: float) -> None:
    """Measured states and commands, read through the observation, are exact transitions of the model."""
    model, given = model_of(arm, 0.013, 0.02, bias=0.05, lead=0.01, integral=integral, ramp=0.01), commands(30, 1)
    simulation = Simulation(process(arm, 30), model, 1)
    states = [(simulation.q, simulation.v)]
    for command in given[:-1]:
        simulation.step(simulation.observe(), command)
        states.append((simulation.q, simulation.v))
    q, v = (torch.cat(x).numpy() for x in zip(*states, strict=True))
    rows = len(given) - 1
    log = Transitions(
        q=q[:-1], v=v[:-1], u=given[:-1, 0].numpy(), q_next=q[1:], v_next=v[1:], dt=DT, episode=np.zeros(rows, int)
    )
    seen = model.seen(log)
    found = model.predict(seen.q, seen.v, seen.u)
    np.testing.assert_allclose(found.q_next, seen.q_next, atol=1e-9)
    np.testing.assert_allclose(found.v_next, seen.v_next, atol=1e-7)
    start, told = (torch.from_numpy(np.stack([x, x])) for x in (seen.q, seen.q))
    moved = torch.tensor([[0.0, 0.0], [0.1, -0.1]]).double()  # the second one starts elsewhere, and so does the robot
    path, _ = rollout(
        model, start[:, 0] + moved, torch.zeros(2, 2).double(), torch.from_numpy(np.stack([seen.u] * 2)), told
    )
    np.testing.assert_allclose(path[0].numpy(), seen.q_next, atol=1e-8)
    other = Simulation(process(arm, 30), model, 1)
    other.q = other.q + moved[1:]
    for command in given[:-1]:
        other.step(other.observe(), command)
    np.testing.assert_allclose(path[1, -1].numpy(), other.q[0].numpy() - np.array([0.05, -0.05]), atol=1e-8)


def test_robots_have_delay_lag_and_bias_of_their_own(arm: Scene) -> None:
    """And leads: draws of all of these, side by side, move as one model of each does alone."""
    late = [(0.013, 0.02, 0.05, 0.0), (0.0, 0.0, 0.0, 0.01), (0.031, 0.0, -0.02, 0.01), (0.0, 0.025, 0.01, 0.0)]
    models, given = [model_of(arm, *each) for each in late], commands(20, 4)
    theta = models[0].parameters * np.linspace(0.9, 1.0, 4)[:, None]
    theta = np.maximum(theta, [p.low for p in arm.parameters])
    sets = [np.append(x, m.observer.vector(m.observation)) for x, m in zip(theta, models, strict=True)]
    together = Robots(models[0].with_settings(candidates=np.array(sets)), 4)
    apart = [Robots(model.with_parameters(x), 1) for model, x in zip(models, theta, strict=True)]
    own = torch.from_numpy(np.array(sets))
    q = v = torch.zeros(4, 2, dtype=torch.float64)
    singly = [(q[:1], v[:1]) for _ in apart]
    for command in given:
        q, v = together.step(q, v, command, own)
        singly = [robot.step(*state, command[[k]]) for k, (robot, state) in enumerate(zip(apart, singly, strict=True))]
    torch.testing.assert_close(q, torch.cat([state[0] for state in singly]), rtol=1e-9, atol=1e-11)
    torch.testing.assert_close(v, torch.cat([state[1] for state in singly]), rtol=1e-9, atol=1e-9)


def test_sets_without_any_effect_are_stepped_too(arm: Scene) -> None:
    """As where a fit knows its delay to be none."""
    model = model_of(arm, 0.0, 0.0)
    sets = np.append(model.parameters, np.zeros(len(model.observer)))[None]
    robots, state = Robots(model.with_settings(candidates=sets), 1), torch.zeros(1, 2, dtype=torch.float64)
    found = robots.step(state, state, commands(1, 1)[0], torch.from_numpy(sets))
    torch.testing.assert_close(found[1], model.step(state, state, commands(1, 1)[0])[1], rtol=0, atol=0)


def test_the_derivative_of_a_rollout_of_robots_of_their_own_in_its_commands(arm: Scene) -> None:
    model = model_of(arm, 0.013, 0.02)
    between = [[*np.zeros(5), 0.02 * (d > 0.0), 0.01 * (lag > 0.0), 0.0, 0.0, d, lag] for d, lag in LATE]
    sets = np.stack([np.append(model.parameters, row) for row in between])
    wiring = model.with_settings(candidates=sets).wiring
    assert wiring is not None
    robots = wiring.rows(torch.from_numpy(sets[:, len(model.parameters) :]))

    def arrived(given: torch.Tensor) -> torch.Tensor:
        memory, found = robots.begin(len(LATE)), []
        for command in given:
            _, control, memory = robots.arrive(memory, command)
            found.append(control)
        return torch.cat(found)

    assert torch.autograd.gradcheck(arrived, commands(5, len(LATE)).requires_grad_(), atol=1e-9)


def test_every_episode_has_a_delay_of_its_own(arm: Scene) -> None:
    """Also where the fit itself has none, and after an episode's end."""
    model = model_of(arm, 0.0, 0.0)
    sets = np.stack([np.append(model.parameters, [*np.zeros(9), d, 0.0]) for d in (0.0, 0.02)])
    model = model.with_settings(candidates=sets)
    simulation = Simulation(process(arm, 4), model, 16, disturbance=Disturbance(parameters=parameter_sets(model, 0.0)))
    push, seen = torch.ones(16, 2, dtype=torch.float64), []
    for _ in range(2):
        delays = simulation.theta[:, -2].clone()
        assert set(delays.tolist()) == {0.0, 0.02}
        simulation.step(simulation.observe(), push)
        assert all(len(simulation.v[delays == d].unique(dim=0)) == 1 for d in (0.0, 0.02))
        assert len(simulation.v.unique(dim=0)) == 2
        for _ in range(3):
            simulation.step(simulation.observe(), push)
        seen.append(delays)
    assert not torch.equal(*seen)
    state = simulation.state()
    simulation.step(simulation.observe(), push)
    after = simulation.v.clone()
    simulation.restore(state)
    simulation.step(simulation.observe(), push)
    torch.testing.assert_close(simulation.v, after, rtol=0, atol=0)


def test_gradients_flow_through_late_commands_and_stop_where_they_are_cut(arm: Scene) -> None:
    model = model_of(arm, 0.02, 0.0)  # two steps
    simulation = Simulation(process(arm, 30), model, 1)
    first = torch.full((1, 2), 0.1, dtype=torch.float64, requires_grad=True)
    rewards = [simulation.step(simulation.observe(), first if k == 0 else torch.zeros(1, 2)).reward for k in range(4)]
    slopes = [torch.autograd.grad(r.sum(), first, retain_graph=True, allow_unused=True)[0] for r in rewards]
    assert [bool(s is not None and s[0, 1].abs() > 0) for s in slopes] == [False, False, True, True]
    simulation.detach()
    assert not simulation.step(simulation.observe(), torch.zeros(1, 2)).reward.requires_grad


def test_an_episode_begins_at_rest_and_a_restored_one_goes_on(arm: Scene) -> None:
    model, given = model_of(arm, 0.015, 0.02), commands(12, 2)
    simulation = Simulation(process(arm, 6), model, 2)

    def run(some: torch.Tensor) -> torch.Tensor:
        return torch.stack([simulation.step(simulation.observe(), u).next_observation for u in some])

    torch.testing.assert_close(run(given[:6]), run(given[:6]), rtol=0, atol=0)  # the second time, after a restart
    run(given[:3])
    kept = simulation.state()
    later = run(given[3:5])
    simulation.restore(kept)
    torch.testing.assert_close(run(given[3:5]), later, rtol=0, atol=0)
