"""Rewards that are sums of what environments report."""

from __future__ import annotations

from dataclasses import replace

import torch

from cmbrl.mdp import Total, inside
from cmbrl.registry import load_task

STEP = tuple(torch.arange(1.0, 1.0 + n, dtype=torch.float64)[None] / 10 for n in (6, 6, 3, 6, 6))


def test_a_total_evaluates_its_info_once_and_is_the_reward():
    calls = []

    def info(*step):
        calls.append(step)
        return {"seen": step[0][:, 0], "first": step[0][:, 1], "second": step[1][:, 2]}

    mdp = replace(load_task("hopper").mdp(), info=info, reward=Total(info, ("first", "second")))
    score, told = mdp.score(*STEP)
    assert len(calls) == 1
    assert score.tolist() == [0.2 + 0.3]
    assert torch.equal(mdp.reward(*STEP), score)
    assert list(told) == ["seen", "first", "second"]


def test_terms_alone_are_a_reward_where_nothing_else_is_asked_for():
    """A method of an object is another object each time, so that a process is not to be told by which one it holds."""

    class Counted:
        calls: tuple[str, ...] = ()

        def earned(self, *step):
            self.calls += ("earned",)
            return {"first": step[0][:, 1]}

        def info(self, *step):
            self.calls += ("info",)
            return {"first": step[0][:, 1], "seen": step[0][:, 0]}

    counted = Counted()
    mdp = replace(load_task("hopper").mdp(), info=counted.info, reward=Total(counted.earned, ("first",)))
    score, _ = mdp.score(*STEP)
    assert counted.calls == ("info",)
    assert torch.equal(mdp.reward(*STEP), score)
    assert counted.calls == ("info", "earned")


def test_another_reward_or_info_counts_alone():
    """A process with one of the two replaced takes neither number from the old one."""
    mdp = load_task("hopper").mdp()
    expected, told = mdp.score(*STEP)
    quiet, nothing = replace(mdp, info=None).score(*STEP)
    assert torch.equal(quiet, expected)
    assert nothing == {}
    mine, same = replace(mdp, reward=lambda *step: -step[2][:, 0]).score(*STEP)
    assert mine.tolist() == [-0.1]
    assert same.keys() == told.keys()
    other, less = replace(mdp, info=lambda *step: {"x": step[0][:, 0]}).score(*STEP)
    assert torch.equal(other, expected)
    assert list(less) == ["x"]


def test_inside_is_strict_and_false_for_nan():
    q = torch.tensor([[0.0], [1.0], [torch.nan], [0.5]], dtype=torch.float64)
    low, high = torch.tensor([-1.0, -1.0]), torch.tensor([1.0, torch.inf])
    assert inside(q, torch.zeros_like(q), low, high).tolist() == [True, False, False, True]
