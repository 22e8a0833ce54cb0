"""Trials of policies in the model alone: late commands, pushes, and what their failures say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import cmbrl
from cmbrl.envs.evaluation import Evaluation
from cmbrl.envs.trials import (
    Disturbed,
    _loose,
    failed,
    foretold,
    of_draws,
    quits,
    stands,
    trials,
    unlearned,
    will_fail,
    without_action,
)
from cmbrl.mdp import MDP
from cmbrl.models.named import nominal_model
from cmbrl.registry import load_task

from ..train import slider

FREE = """<mujoco><worldbody><geom type="plane" size="9 9 1"/><body pos="0 0 1"><freejoint/><geom size=".1"/></body>
</worldbody></mujoco>"""
CART = """<mujoco><worldbody><body><joint name="x" type="slide" axis="1 0 0"/><geom size=".1"/></body></worldbody>
{actuator}</mujoco>"""
MOTOR = '<actuator><motor joint="x"/></actuator>'
ROPE = """<tendon><fixed name="rope"><joint joint="x" coef="1"/></fixed></tendon>
<actuator><motor tendon="rope"/></actuator>"""


def test_a_late_pushed_model() -> None:
    model = nominal_model(load_task("hopper"))
    q = torch.tensor([[0.0, 2.0, 0.0, -0.5, -0.5, 0.0]], dtype=torch.float64).repeat(8, 1)
    v, u = torch.zeros(8, 6, dtype=torch.float64), torch.ones(8, 3, dtype=torch.float64)
    late = Disturbed(model, late=1)
    assert torch.equal(late.step(q, v, u)[1], model.step(q, v, u)[1])
    assert torch.equal(late.step(q, v, 0 * u)[1], model.step(q, v, u)[1])
    assert torch.equal(late.step(q, v, u)[1], model.step(q, v, 0 * u)[1])
    pushed, plain = Disturbed(model, push=0.3, every=2, base=(0,)), model.step(q, v, u)[1]
    assert torch.equal(pushed.step(q, v, u)[1], plain)
    push = pushed.step(q, v, u)[1] - plain
    assert set(push[:, 0].round(decimals=6).tolist()) == {-0.3, 0.3}
    assert not push[:, 1:].any()


def test_a_push_of_a_free_body_has_one_size_and_many_directions() -> None:
    model = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(FREE))
    assert _loose(model.scene) == (0, 1)
    q = torch.tensor([[0.0, 0, 1, 1, 0, 0, 0]], dtype=torch.float64).repeat(16, 1)
    v, u = torch.zeros(16, 6, dtype=torch.float64), torch.zeros(16, 0, dtype=torch.float64)
    push = Disturbed(model, push=0.3, every=1, base=(0, 1)).step(q, v, u)[1] - model.step(q, v, u)[1]
    assert torch.allclose(push[:, :2].norm(dim=1), torch.full((16,), 0.3, dtype=torch.float64))
    assert len(push[:, 0].round(decimals=6).unique()) == 16
    assert not push[:, 2:].any()


@pytest.mark.parametrize(("actuator", "base"), [("", (0,)), (MOTOR, ()), (ROPE, ())])
def test_what_a_motor_drives_is_not_pushed(actuator: str, base: tuple[int, ...]) -> None:
    assert _loose(cmbrl.Scene.from_mjcf(CART.format(actuator=actuator))) == base


def test_the_hopper_is_pushed_along_its_track() -> None:
    scene = nominal_model(load_task("hopper")).scene
    assert [scene.coordinate_names[k] for k in _loose(scene)] == ["rootx"]


def test_trials_of_a_policy_that_stops_and_of_one_that_runs_away(tmp_path: Path) -> None:
    model, mdp = cmbrl.ComplementarityModel(slider.scene(tmp_path)), slider.mdp(40)
    stops = trials(lambda o: (-2 * o[:, :1] - 2 * o[:, 1:]).clamp(-1, 1), mdp, model, 8)
    assert set(stops) == {"draws", "late", "parameters"}  # the motor drives the only coordinate
    assert not will_fail(failed(stops))
    runs_away = failed(trials(lambda o: torch.ones(len(o), 1), mdp, model, 8))
    assert runs_away == {"draws": 1.0, "late": 1.0, "parameters": 1.0}
    assert "will probably fail" in foretold(runs_away)


def test_a_file_may_be_off_and_the_draws_of_a_fit_tell_by_how_much(tmp_path: Path) -> None:
    """A block that a motor pushes is as heavy as the file says, or up to 20 % lighter or heavier."""
    model, mdp = cmbrl.ComplementarityModel(slider.scene(tmp_path)), slider.mdp(40)
    found = trials(lambda o: torch.full((len(o), 1), 0.1), mdp, model, 8)
    assert not np.array_equal(found["parameters"].returns, found["draws"].returns)
    drawn = model.with_settings(candidates=model.parameters[None])
    assert "parameters" not in trials(lambda o: torch.zeros(len(o), 1), mdp, drawn, 8)


def test_a_policy_of_a_file_that_stands_little_is_asked_for_a_log() -> None:
    for name in ("late", "parameters"):
        shares = {"draws": 0.0, name: 0.4}
        assert "may fail in a robot that is not quite its file, fit a log" in foretold(shares, fitted=False)
        assert "fit a log" not in foretold(shares)
        assert "fit a log" not in foretold({"draws": 0.0, name: 0.2}, fitted=False)
    assert foretold({"draws": 0.0, "late": 0.1, "parameters": 0.2}, fitted=False).endswith(
        "10 % with commands a step late, 20 % with parameters off by up to 20 %"
    )


PUCK = """<mujoco><option timestep=".004" cone="elliptic"/><worldbody><geom type="plane" size="9 9 .1" friction="1"/>
<body pos="0 0 .0499"><freejoint/><geom type="box" size=".2 .2 .05" mass="2" friction="1"/><site name="s"/></body>
</worldbody><actuator><motor site="s" gear="40 0 0 0 0 0"/></actuator></mujoco>"""


def puck_process() -> MDP:
    """A puck at rest that must not leave the floor."""
    at_rest = torch.tensor([[0.0, 0, 0.0499, 1, 0, 0, 0]], dtype=torch.float64)
    return MDP(
        observations=6, actions=1, observe=lambda q, v: v, terminated=lambda q, v: q[:, 2] > 0.0515, dt=0.02,
        episode_steps=25, reward=lambda q, v, action, q_next, v_next: torch.ones_like(q[:, 0]),
        reset=lambda count, generator: (at_rest.repeat(count, 1), torch.zeros(count, 6, dtype=torch.float64)),
    )  # fmt: skip


def test_a_policy_that_earns_no_more_than_no_action_is_told() -> None:
    model = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(PUCK), substeps=5, sliding="coulomb")
    idle = without_action(puck_process(), model, 4).returns.mean()
    rests = of_draws(lambda o: torch.zeros(len(o), 1), puck_process(), model, 4).returns.mean()
    assert "it has learned nothing, train longer" in unlearned({"policy": float(rests), "no action": float(idle)})
    assert unlearned({"policy": float(idle) + 1.0, "no action": float(idle)}) == ""
    assert unlearned({}) == ""
    for hardly in (-590.0, -610.0):
        assert "a machine that stays at its start" in unlearned({"policy": hardly, "no action": -600.0})
    assert "gentler actions" in unlearned({"policy": -650.0, "no action": -600.0})
    assert unlearned({"policy": -580.0, "no action": -600.0}) == ""
    assert unlearned({"policy": 0.5, "no action": 0.0}) == ""
    assert "since the reward has no derivative" in unlearned({"policy": 0.0, "no action": 0.0}, slopes=False)


def test_a_policy_that_leans_on_a_law_of_sliding_is_told() -> None:
    """What slides is lifted under the convex law alone."""
    model = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(PUCK), substeps=5, sliding="coulomb")
    slides = failed(trials(lambda o: torch.ones(len(o), 1), puck_process(), model, 4))
    assert (slides["draws"], slides["law"]) == (0.0, 1.0)
    assert not will_fail(slides)
    assert not stands(slides)
    assert "leans on the model's law of sliding" in foretold(slides)
    rests = failed(trials(lambda o: torch.zeros(len(o), 1), puck_process(), model, 4))
    assert stands(rests)
    assert "leans" not in foretold(rests)


def test_a_policy_that_leans_on_the_models_steps_is_told() -> None:
    """Under exact Coulomb a puck that slides stays on the floor; in MuJoCo's step it is lifted."""
    coulomb = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(PUCK), sliding="coulomb")
    model = coulomb.with_settings(substeps=1, time_step=0.02)
    assert failed(trials(lambda o: torch.ones(len(o), 1), puck_process(), model, 4))["mujoco"] == 1.0
    assert failed(trials(lambda o: torch.zeros(len(o), 1), puck_process(), model, 4))["mujoco"] == 0.0
    told = foretold({"draws": 0.0, "law": 0.1, "mujoco": 0.75})
    falls = foretold({"draws": 0.4, "law": 0.1})
    assert "it may fail in the robot" in falls
    assert "leans" not in falls
    assert "75 % with MuJoCo's step of the file: it leans on how the model steps" in told


def test_an_episode_that_earns_half_has_failed() -> None:
    def found(*returns: float) -> Evaluation:
        ends = np.zeros(len(returns), dtype=bool)
        return Evaluation(np.array(returns), np.full(len(returns), 9), ends)

    shares = failed({"draws": found(10.0, 12.0, 8.0, 4.0), "late": found(6.0, 5.0, 4.0, 3.0)})
    assert shares == {"draws": 0.25, "late": 0.5}  # usual: 9
    assert failed({"draws": found(-2.0, -2.9, -3.1)})["draws"] == pytest.approx(0.0)
    far = {"draws": found(-4.0, -8.0, -9.0, -15.0)}  # a goal twice as far away costs twice as much
    assert failed(far)["draws"] == 0.25
    assert failed(far, found(-80.0, -60.0))["draws"] == 0.0
    assert failed({"draws": found(-8.0, -9.0, -60.0)}, found(-80.0, -60.0))["draws"] == pytest.approx(1 / 3)
    assert failed({"draws": found(10.0, 12.0, 8.0, 4.0)}, found(2.0, 1.0))["draws"] == 0.25
    far_goals = {"draws": found(-10.0, -9.0, -45.0, -40.0), "late": found(-9.0, -9.0, -45.0, -70.0)}
    assert failed(far_goals, found(-50.0, -45.0, -90.0, -60.0)) == {"draws": 0.0, "late": 0.25}  # of 38
    assert failed(far_goals, found(-40.0, -30.0))["draws"] == 0.5, "starts are not known to be the same"
    assert failed({"draws": found(4.0, 4.0, 0.0, 0.0)}, found(5.0, 5.0, 0.0, 0.0))["draws"] == 0.5


def test_of_a_fit_an_extra_step_of_lateness_is_a_margin_and_no_alarm() -> None:
    """Its draws have the delays that its log leaves open; a file has none."""
    told = foretold({"draws": 0.02, "late": 0.94, "pushed": 0.1})
    assert "94 % with commands a step later than in the fit, 10 % with pushes (the late ones are no forecast" in told
    assert "no forecast" not in foretold({"draws": 0.02, "late": 0.1})
    assert "no forecast" not in foretold({"draws": 0.6, "late": 0.94}), "under the draws it fails as well"
    assert "with commands a step late: it may fail" in foretold({"draws": 0.02, "late": 0.94}, fitted=False)


def test_of_a_policy_that_was_trained_on_the_file_no_fit_is_asked_for() -> None:
    for share in (0.4, 1.0):
        assert "policy of the file" in foretold({"draws": share, "late": 0.0})
        assert "train longer" in foretold({"draws": share, "late": 0.0})
        told = foretold({"draws": share, "late": 0.0}, fitted=False)
        assert "train longer" in told
        assert "--start" not in told
        assert "another log" not in told


def test_a_loop_is_not_asked_for_what_it_does_not_take() -> None:
    """It begins with policies of the file by itself, refuses --start, and records its own log."""
    for share in (0.4, 1.0):
        told = foretold({"draws": share, "late": 0.0}, loop=True)
        assert "train longer" in told
        assert "--set rounds=2" in told
        assert "--start" not in told
        assert "another log" not in told


def test_a_task_whose_episodes_cost_less_the_sooner_they_end_is_told_so() -> None:
    mdp = slider.mdp()
    lengths = np.array([20, 60, 100, 100])

    def ended(returns: list[float], terminated: list[bool]) -> Evaluation:
        return Evaluation(np.array(returns), lengths, np.array(terminated))

    cost, half = [-20.0, -60.0, -50.0, -10.0], [True, True, False, False]
    assert "steps earn -0.5 in the mean" in quits(ended(cost, half), mdp)
    assert quits(ended(cost, [True, False, False, False]), mdp) == ""
    assert quits(ended([-value for value in cost], half), mdp) == ""
    assert quits(ended(cost, half), replace(mdp, shaping=lambda q, v: q[:, 0])) == ""
