"""The loop on a small scale: what it counts, what it keeps, and that it goes on where it stopped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import cmbrl
from cmbrl.contact.smoothing import Gaussian
from cmbrl.envs.evaluation import Evaluation
from cmbrl.errors import UserError
from cmbrl.files import read_json
from cmbrl.fitting import Budget, FitResult, fit
from cmbrl.fitting.played import fit_or_played, with_play
from cmbrl.registry import load_task
from cmbrl.scene.writing.played import gaps_of
from cmbrl.train.loop import Loop
from cmbrl.train.loop_config import LoopConfig
from cmbrl.train.running.run import TrainingRun
from cmbrl.train.setup import set_up

pytest.importorskip("gymnasium", reason="the hopper's real system is Gymnasium's MJCF")
SMALL = LoopConfig(
    iterations=12, rounds=2, policies=2, further=0, trial=0.5, transitions=120, more=60, environments=8, horizon=4,
    actor_hidden=(16,), critic_hidden=(16,), score_episodes=4, draws=8,
)  # fmt: skip
LITTLE = Budget().shrunk(0.05)  # how good a fit is does not matter here


@pytest.fixture(scope="module")
def fits():
    return {}


@pytest.fixture(autouse=True)
def each_fit_once(fits, monkeypatch):
    """Most loops here fit the same log, which takes seconds and gives the same fit (tests/fitting/test_fit.py)."""

    def once(model, data, **options):
        arrays = (model.parameters, data.q, data.v, data.u, data.q_next, data.v_next)
        key = (*(array.tobytes() for array in arrays), model.smoothing, model.backward_smoothing, *options.items())
        if key not in fits:
            fits[key] = fit_or_played(model, data, budget=LITTLE, **options)
        return fits[key]

    monkeypatch.setattr("cmbrl.train.loop.fit_or_played", once)


@pytest.fixture
def make_loop():
    task = load_task("hopper")
    model = cmbrl.ComplementarityModel(task.load_scene(), smoothing=cmbrl.Barrier(1e-4), **task.model_options())
    return lambda config=SMALL, **extra: Loop(task.mdp(), model, config, seed=3, system=task.system, **extra)


def test_rounds_trials_and_transitions_are_counted(make_loop):
    """A round: two trials of 2 updates, then 2 more of the better one."""
    loop, ahead = make_loop(), []
    rows = [(ahead.append(loop.ahead), loop.update())[1] for _ in range(SMALL.iterations)]
    fits, tries = "real transitions, and a fit of the model to them", "trials of the policy in the model"
    assert ahead == 2 * [fits, tries, *2 * ["", tries]]  # told before updates that take minutes
    assert SMALL.shac().iterations == 4
    assert [row["transitions"] for row in rows] == 6 * [120] + 6 * [180]
    assert ["score" in row for row in rows] == 6 * [False, True]
    assert loop.round == 2
    fitted = loop.model
    assert fitted is not None
    assert fitted.candidates.shape == (8, len(fitted.parameters))  # a prompt robot: of delay and lag, the sum is told
    assert not np.allclose(fitted.parameters, loop.nominal.parameters)


def test_the_better_of_the_trials_goes_on(make_loop):
    loop = make_loop()
    rows = [loop.update() for _ in range(4)]
    told = [(row["score"], row["stands"]) for row in rows[1::2]]
    assert [(one["score"], one["stands"]) for one in loop.contest.tried] == told
    chosen = max(loop.contest.tried, key=lambda one: one["score"])["trainer"]
    for name, value in loop.policy.state_dict().items():
        torch.testing.assert_close(value, chosen["policy"][name], rtol=0, atol=0)


FALLS, STANDS = {"stands": 0.0}, {"stands": 1.0}


def outcome(returns, falls):
    return Evaluation(np.array(returns), np.full(len(returns), 1000), np.full(len(returns), falls))


def test_scores_are_the_mean_of_both_laws_of_sliding(make_fitted, monkeypatch):
    """A policy that hardly moves stands everything: one that hops and would fall under the other law is worth more."""
    lazy = {"draws": outcome([1000.0, 1100.0], False), "law": outcome([1100.0, 1000.0], False)}
    hops = {"draws": outcome([3400.0, 3500.0], False), "law": outcome([700.0, 800.0], True)}
    loop = make_fitted(replace(SMALL, rounds=1, iterations=6))
    monkeypatch.setattr("cmbrl.train.contest.trials", lambda *_: told.pop(0))
    told = [hops, lazy]
    rows = [loop.update() for _ in range(4)]
    assert [(row.get("score"), row.get("stands")) for row in rows[1::2]] == [(2100.0, 0.0), (1050.0, 1.0)]
    for name, value in loop.policy.state_dict().items():
        torch.testing.assert_close(value, loop.contest.tried[0]["trainer"]["policy"][name], rtol=0, atol=0)


@pytest.fixture
def make_fitted(make_loop, monkeypatch):
    """Loops whose fit is the nominal model."""

    def make(config):
        loop = make_loop(config=config)
        known = loop.nominal.with_settings(candidates=loop.nominal.parameters[None])
        monkeypatch.setattr(loop, "_execute", lambda: None)
        monkeypatch.setattr(loop, "_fit", lambda: setattr(loop, "model", known))
        return loop

    return make


@pytest.mark.parametrize("trial", [0.5, 1.0])
def test_further_policies_are_trained_while_the_best_fails(make_fitted, monkeypatch, tmp_path, trial):
    """Three are allowed; the second of them stands and is the best so far. A restored run counts the same."""
    config = replace(SMALL, iterations=round(8 * (0.5 + 0.5 * trial)), rounds=1, policies=1, further=3, trial=trial)
    each = config.trial_updates()
    told = [{"score": 2.0, **FALLS}, {"score": 1.0, **STANDS}, {"score": 3.0, **STANDS}, {"score": 5.0, **STANDS}]
    loop, again = make_fitted(config), make_fitted(config)
    monkeypatch.setattr(loop, "_judge", iter(told).__next__)
    outcome = TrainingRun(loop, tmp_path / "run", {}).train(config.iterations)
    assert outcome.iteration == config.iterations + 2 * each
    assert loop.further == 2 * each
    assert [one["stands"] for one in loop.contest.tried] == [0.0, 1.0, 1.0]
    assert loop.round == 1
    again.restore(loop.state())
    assert again.further == loop.further
    if trial == 1.0:
        for name, value in loop.policy.state_dict().items():
            torch.testing.assert_close(value, loop.contest.tried[2]["trainer"]["policy"][name], rtol=0, atol=0)


def test_further_policies_end(make_fitted, monkeypatch):
    config = replace(SMALL, iterations=4, rounds=1, policies=2, further=1, trial=1.0)
    loop = make_fitted(config)
    monkeypatch.setattr(loop, "_judge", lambda: {"score": 1.0, **FALLS})
    rows = 0
    while loop.round == 0:
        loop.update()
        rows += 1
    assert rows == config.iterations + loop.further == 6


def test_policies_but_the_first_begin_on_the_file(make_loop):
    """Two updates of four there, then the same policy goes on on the fit, its rate too; also after a restart."""
    config = replace(SMALL, rounds=1, iterations=8, trial=1.0)
    loop, again = make_loop(config=config), make_loop(config=config)
    models, rates = [], []
    for k in range(config.iterations):
        if k == 5:  # between the policy's first and second update
            again.restore(loop.state())
            loop = again
        loop.update()
        models.append(loop.trainer.model is loop.nominal)
        rates.append(loop.trainer.optimiser.rate / config.actor_rate)
        if k == 5:
            assert loop.trainer.iteration == 2
    assert models == 3 * [False] + 2 * [True] + 3 * [False]
    assert rates[6:] == pytest.approx([0.5, 0.25])


def test_what_was_learned_on_the_file_goes_on_on_the_fit(make_loop, monkeypatch):
    loop = make_loop(config=replace(SMALL, rounds=1, iterations=8, trial=1.0))
    for _ in range(5):
        loop.update()
    kept = []
    carry_over = loop._carry_over

    def watched():
        kept.append({name: value.clone() for name, value in loop.policy.state_dict().items()})
        carry_over()

    monkeypatch.setattr(loop, "_carry_over", watched)
    loop.update()
    for name, value in loop.policy.state_dict().items():
        torch.testing.assert_close(value, kept[0][name], rtol=0, atol=0)


def test_the_next_round_begins_with_the_last_one_s_policy(make_loop):
    loop = make_loop()
    for _ in range(6):
        loop.update()
    assert loop.round == 1
    before = {name: value.clone() for name, value in loop.policy.net.state_dict().items()}
    loop._execute()
    loop._fit()
    loop._begin_policy()
    for name, value in loop.policy.net.state_dict().items():
        torch.testing.assert_close(value, before[name], rtol=0, atol=0)


def test_a_run_of_one_round_is_restored_when_it_is_over(make_loop):
    """It has no policy of a round before."""
    loop, again = make_loop(), make_loop()
    loop.config = again.config = replace(SMALL, rounds=1)
    while loop.round == 0:
        loop.update()
    again.restore(loop.state())
    for name, value in again.policy.state_dict().items():
        torch.testing.assert_close(value, loop.policy.state_dict()[name], rtol=0, atol=0)


def test_transitions_are_counted_and_not_steps_of_the_process(make_loop):
    """One step of the process may hold its action for several of them."""
    loop = make_loop()
    held = replace(loop.mdp, repeat=5)
    loop.mdp = loop.recording.mdp = held
    loop._execute()
    assert loop._transitions() == SMALL.transitions


def test_a_given_log_counts_and_only_the_rest_is_recorded(make_loop):
    log = load_task("hopper").record(100, seed=5)
    loop = make_loop(data=log)
    assert loop.update()["transitions"] == 120
    assert loop.recording.transitions == 20


@pytest.mark.parametrize("stop", [1, 3, *(pytest.param(k, marks=pytest.mark.slow) for k in (5, 7))])
def test_it_goes_on_bit_for_bit(make_loop, stop):
    through, stopped, resumed = make_loop(), make_loop(), make_loop()
    for _ in range(stop):
        through.update()
        stopped.update()
    resumed.restore(stopped.state())
    for _ in range(2):
        a, b = through.update(), resumed.update()
        assert a == b


def test_the_fit_is_left_as_a_run_folder_of_cmbrl_fit(make_loop, tmp_path):
    loop = make_loop()
    loop.update()
    loop.keep(tmp_path)
    kept = FitResult.load(tmp_path / "fit")
    np.testing.assert_array_equal(kept.model.parameters, loop.model.parameters)
    np.testing.assert_allclose(kept.candidates(SMALL.draws, seed=3), loop.model.candidates)
    for count, drawn in (("5", kept.candidates(5, seed=2)), ("0", None)):  # as `cmbrl train --model` takes it
        given = {"draws": count, "environments": "2"}
        trainer = set_up("hopper", "shac", str(tmp_path / "fit"), given, seed=2).trainer()
        parameters = trainer.simulation.disturbance.parameters
        assert (parameters is None) == (drawn is None)
        if drawn is not None:
            assert {tuple(row) for row in parameters} <= {tuple(row) for row in drawn}


def test_a_soft_derivative_is_for_the_policy_and_not_for_the_fit(make_loop):
    loop, soft = make_loop(), make_loop()
    soft.nominal = soft.nominal.with_settings(backward_smoothing=Gaussian(1e-3))
    for one in (loop, soft):
        one.update()
    np.testing.assert_array_equal(loop.model.candidates, soft.model.candidates)
    assert soft.model.backward_smoothing == Gaussian(1e-3)
    assert soft.model.smoothing == loop.model.smoothing


def test_where_a_trial_is_all_of_it_the_best_policy_counts(make_loop):
    loop = make_loop(config=replace(SMALL, iterations=8, rounds=1, trial=1.0))
    scores = [loop.update().get("score") for _ in range(8)]
    assert [score is not None for score in scores] == 2 * [False, False, False, True]
    assert loop.round == 1
    chosen = max(loop.contest.tried, key=lambda one: one["score"])["trainer"]
    for name, value in loop.policy.state_dict().items():
        torch.testing.assert_close(value, chosen["policy"][name], rtol=0, atol=0)


def test_it_says_what_its_fit_is_worth_and_which_policy_was_kept(make_loop, tmp_path):
    loop = make_loop(config=replace(SMALL, iterations=4, rounds=1, trial=1.0))
    assert dict(loop.remarks) == {}
    TrainingRun(loop, tmp_path, {}).train(4)
    told = read_json(tmp_path / "train.json")["remarks"]
    assert (tmp_path / "fit" / "report.txt").read_text().split()[:6] == told["fit"].split()[:6]
    earned = ", ".join(f"{one['score']:.4g}" for one in loop.contest.tried)
    assert told[""] == f"of 2 policies the best is kept; in the model they earn, at their ends, {earned}"
    again = make_loop(config=loop.config)
    again.restore(loop.state())
    assert again.remarks == told


@pytest.mark.parametrize("trial", [0.0, 1.5, float("nan")])
def test_a_trial_is_a_share(trial):
    with pytest.raises(UserError, match="must be a share"):
        LoopConfig(trial=trial)


def test_what_a_fit_with_play_found_is_trained_on_kept_and_restored(make_loop, monkeypatch, tmp_path):
    """On the task's file, which has no play; the fit's file is beside it, since no other file has this play."""

    def with_the_play(model, data, **options):
        return fit(with_play(model, {"leg_joint": 0.01}), data, budget=LITTLE, **options)

    monkeypatch.setattr("cmbrl.train.loop.fit_or_played", with_the_play)
    loop, resumed = make_loop(), make_loop()
    loop.update()
    own = [p.name for p in loop.nominal.scene.parameters]
    values = {name: p.value for name, p in loop.fitted.parameters.items()}
    np.testing.assert_allclose(loop.model.parameters, [values[name] for name in own])
    told = loop.fitted.candidates(1).shape[1] > len(loop.fitted.model.parameters)  # delay, lag or biases
    assert loop.model.candidates.shape == (8, len(own) + told * len(loop.model.observer.parameters))
    resumed.restore(loop.state())
    loop.keep(tmp_path)
    assert loop.update() == resumed.update()
    kept = FitResult.load(tmp_path / "fit")
    assert gaps_of(kept.model.scene) == pytest.approx({"leg_joint": 0.01})
    assert {name: p.value for name, p in kept.parameters.items()} == values
