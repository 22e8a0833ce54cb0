"""Several logs in one fit: windows and noise of each, held out over all, and whether they agree."""

import json
from dataclasses import replace

import numpy as np
import pytest

import cmbrl
from cmbrl.errors import UserError
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.noise import sensor_noise
from cmbrl.fitting.outcome.agreement import cause
from cmbrl.models.windows import blocks_of

GROUPS = ["gear", "damping"]
BOTH = {"gear_0": 0.7, "gear_1": 1.3}


@pytest.fixture
def pair(carts):
    """Two logs of the same carts."""
    truth = carts.truth(2, **BOTH)
    return [carts.record(truth, episodes=8, steps=30, seed=seed, noise=0.01) for seed in (0, 1)]


def _fit(carts, logs, **options):
    return cmbrl.fit(carts.model(2), logs, groups=GROUPS, method="gauss-newton", horizon=1, **options)


def test_logs_of_one_robot_agree_and_make_one_fit(carts, pair):
    result = _fit(carts, pair)
    assert result.report["data"]["episodes"] == 16
    assert [log["name"] for log in result.report["logs"]] == ["log 1", "log 2"]
    assert all(log["agrees"] and not log["moved"] for log in result.report["logs"])
    assert "The logs agree" in result.report_text()
    for name, value in BOTH.items():
        assert result.parameters[name.replace("_", ".")].value == pytest.approx(value, rel=0.1)


def test_a_log_of_another_state_of_the_robot_is_named(carts, pair):
    oiled = carts.record(carts.truth(2, **BOTH, damping_1=4.0), episodes=8, steps=30, seed=2, noise=0.01)
    result = _fit(carts, {"monday": pair[0], "tuesday": pair[1], "friday": oiled})
    found = {log["name"]: log for log in result.report["logs"]}
    assert not found["friday"]["agrees"]
    moved = found["friday"]["moved"][0]
    assert moved["parameter"] == "damping.1"
    assert moved["low"] < 4.0 < moved["high"]
    assert moved["others_low"] < 1.0 < moved["others_high"]
    text = " ".join(result.report_text().split())
    assert "THE LOGS DISAGREE" in text
    assert "monday and tuesday agree. friday differs from monday and tuesday: alone, a fit predicts" in text
    assert found["monday"]["agrees"]
    assert found["tuesday"]["agrees"]
    assert moved["apart"]["unit"] == "times"
    assert moved["apart"]["low"] < 4.0 < moved["apart"]["high"]
    assert found["friday"]["explained"] > 0.9
    assert result.report_text().startswith("The logs disagree (friday differs): fit them apart. ")
    assert "likely joints that were warmer, oiled or worn" in text


def test_a_log_that_is_too_short_to_be_held_out_ends_no_fit(carts, pair):
    """One episode, whose parts have as many rows as are predicted at once, or fewer."""
    short = carts.record(carts.truth(2, **BOTH), episodes=1, steps=60, seed=1, noise=0.01)
    for steps, compared in ((8, True), (20, False)):
        result = cmbrl.fit(carts.model(2), {"long": pair[0], "short": short}, groups=GROUPS, horizon=steps)
        found = {log["name"]: log for log in result.report["logs"]}
        assert all(log["agrees"] for log in found.values())
        assert found["short"]["compared"] == compared
        assert ("short could not be compared" in " ".join(result.report_text().split())) != compared


def test_each_log_is_held_out_by_its_own_episodes_and_a_single_episode_in_parts(carts):
    truth = carts.truth(1)
    single = carts.record(truth, episodes=1, steps=80)
    evidence = Evidence.of(carts.model(1), [single, carts.record(truth, episodes=3, steps=20)])
    log, blocks = evidence.log, blocks_of(evidence.log)
    assert log.recording.tolist() == [0] * 80 + [1] * 60
    assert len(np.unique(blocks[log.recording == 0])) == 8
    assert len(np.unique(blocks[log.recording == 1])) == 3
    assert not set(blocks[log.recording == 0]) & set(blocks[log.recording == 1])
    assert len(log.windows(20)) == 61 + 3  # none reaches from one log into the other


def test_each_log_has_its_own_noise(carts, pair):
    """The noisy log weighs less and its starts are free; its noise does not loosen the other one."""
    draw = np.random.default_rng(0)
    clean = pair[0]
    q, q_next = clean.q.copy(), clean.q_next.copy()
    error = 0.01 * draw.normal(size=(len(q) + 1, 2))
    noisy = replace(clean, q=q + error[:-1], q_next=q_next + error[1:])
    evidence = Evidence.of(carts.truth(2, **BOTH), [clean, noisy])
    noise = sensor_noise(evidence, evidence.space.nominal)
    assert noise is not None
    np.testing.assert_allclose(noise[1][:2], 0.01, rtol=0.2)
    np.testing.assert_array_equal(noise[0][:2], 0.0)
    starts = evidence.log.windows(4)[::7]
    loss = evidence.loss(starts, 4, *evidence.scales(4, 0.3, noise)).settled(evidence.space.nominal)
    moved = np.abs(loss.windows.offset).max(axis=1)
    of = loss.windows.recording
    assert moved[of == 1].min() > 100 * moved[of == 0].max()
    total = loss.values(evidence.space.nominal[None])[0]
    assert total == pytest.approx(loss.errors(evidence.space.nominal).mean, rel=1e-5)


def test_gradient_of_the_loss_over_logs_with_noise_of_their_own(carts, pair):
    evidence = Evidence.of(carts.model(2), pair)
    noise = np.array([[2e-3, 2e-3, 0.02, 0.0], [1e-2, 2e-3, 0.04, 0.03]])
    space = evidence.space
    loss = evidence.loss(evidence.log.windows(3)[::5], 3, *evidence.scales(3, 50.0, noise))
    z = 0.1 * np.ones(len(space))
    found = loss.settled(space.theta(z)).normal_equations(space, z).gradient

    def value(at):
        return loss.settled(space.theta(at)).errors(space.theta(at)).mean

    for k in range(len(space) - 1):
        step = 1e-5 * np.eye(len(space))[k]
        assert found[k] == pytest.approx((value(z + step) - value(z - step)) / 2e-5, rel=1e-3, abs=1e-7)


def test_the_report_is_json(carts, pair, tmp_path):
    result = _fit(carts, pair, folder=tmp_path)
    json.dumps(result.report)
    again = _fit(carts, pair, folder=tmp_path)  # from the journal
    assert again.report["logs"] == result.report["logs"]


def test_mistakes_name_the_log(carts, pair):
    other_rate = replace(pair[1], dt=0.04)
    with pytest.raises(UserError, match=r"log 2 has a sample every 0.04 s, log 1 every 0.02 s: bring them to one rate"):
        _fit(carts, [pair[0], other_rate])
    with pytest.raises(UserError, match="give Transitions or a PositionLog"):
        _fit(carts, [])
    with pytest.raises(UserError, match=r"log 2: log of another robot"):
        _fit(carts, [pair[0], carts.record(carts.truth(1), 2, 20)])


def test_causes_are_named_by_group():
    assert "payload" in cause("com_x")
    assert "floor" in cause("softness_time")
    assert "worn" in cause("friction_slope")
    assert "this parameter" in cause("bumper")
