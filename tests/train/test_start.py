"""A run that goes on from another one's policy: it acts as before, begins halfway, and is refused where it cannot."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from cmbrl import ComplementarityModel
from cmbrl.errors import UserError
from cmbrl.train.policies.file import save_policy
from cmbrl.train.policies.policy import Architecture, Policy
from cmbrl.train.shac import SHAC, SHACConfig
from cmbrl.train.start import carried_over, with_actions_of
from cmbrl.train.windows import judged
from cmbrl.train.windows.schedule import LEARNED

from . import slider

SMALL = SHACConfig(iterations=4, environments=16, horizon=8, actor_hidden=(16,), critic_hidden=(16,))


def trainer(folder: Path, delay: float = 0.0) -> SHAC:
    model = ComplementarityModel(slider.scene(folder), observation={"delay.command": delay})
    return SHAC(slider.mdp(), model, SMALL)


def trained(folder: Path) -> Policy:
    made = trainer(folder)
    for _ in range(4):
        made.update()
    save_policy(made.policy, folder / "run", {"task": "slider"})
    return made.policy


@pytest.mark.parametrize("late", [0, 2])
def test_it_acts_as_before_also_where_it_observes_more_of_its_last_actions(late: int, tmp_path: Path) -> None:
    before = trained(tmp_path)
    after = trainer(tmp_path, late * slider.DT)
    after.begin_with(carried_over(str(tmp_path / "run"), after.policy.architecture))
    seen = torch.randn(5, 2)
    actions = torch.rand(5, late)
    torch.testing.assert_close(after.policy(torch.cat([seen, actions], dim=1)), before(seen))
    weights = after.policy.net[0].weight.detach().clone()
    after.update()
    assert (after.policy.net[0].weight != weights).all()  # those of its last actions too


@pytest.mark.parametrize(("late", "asked", "count"), [(0, None, 2), (1, None, 2), (3, None, 3), (3, 2, 2), (0, 0, 0)])
def test_it_observes_as_many_last_actions_as_the_policy_it_begins_with(
    late: int, asked: int | None, count: int, tmp_path: Path
) -> None:
    """Or more where its model holds more, unless it was told how many: two fits tell a delay differently."""
    save_policy(Policy(Architecture(4, 1, (16,), last_actions=2)), tmp_path / "run", {"task": "slider"})
    model = ComplementarityModel(slider.scene(tmp_path), observation={"delay.command": late * slider.DT})
    config = with_actions_of(str(tmp_path / "run"), replace(SMALL, last_actions=asked), slider.mdp(), model)
    made = SHAC(slider.mdp(), model, config)
    assert made.policy.architecture.last_actions == count
    if count >= 2:
        made.begin_with(carried_over(str(tmp_path / "run"), made.policy.architecture))


class Chosen:
    """A curriculum that chooses nothing."""

    def ended(self, q: torch.Tensor, failed: torch.Tensor) -> None: ...

    def state(self) -> dict[str, Any]:
        return {}

    def restore(self, state: dict[str, Any]) -> None: ...


@pytest.mark.parametrize(
    ("rate", "curriculum", "judged", "kept"),
    [(3.0, None, False, 0), (0.0, None, False, None), (3.0, Chosen(), True, 0), (3.0, Chosen(), False, None)],
)
def test_a_policy_that_loses_by_going_on_is_kept(
    rate: float, curriculum: Chosen | None, judged: bool, kept: int | None, tmp_path: Path
) -> None:
    """Steps far too long ruin one that holds the block in the middle; of two that are as good the last is kept.

    Where a curriculum has the starts, as for motions, an evaluation's tell; without those nothing does.
    """
    model, mdp = ComplementarityModel(slider.scene(tmp_path)), slider.mdp()
    good = SHAC(mdp, model, replace(SMALL, iterations=60))
    for _ in range(60):
        good.update()
    before = copy.deepcopy(good.policy.state_dict())
    started = replace(mdp, curriculum=curriculum)
    going_on = SHAC(started, model, replace(SMALL, actor_rate=rate, discount=0.5, iterations=12))
    going_on.judged = mdp if judged else None
    going_on.begin_with(before)
    for _ in range(12):
        going_on.update()
    assert going_on.kept == kept
    same = [torch.equal(value, before[name]) for name, value in going_on.policy.state_dict().items()]
    assert all(same) == (kept == 0)


@pytest.mark.parametrize(
    ("lost", "spread", "kept"),
    [(0.025, 0.002, 0), (0.025, 0.2, None), (0.005, 0.0, None), (-0.1, 0.0, None)],
)
def test_a_little_that_is_lost_for_certain_counts(
    lost: float, spread: float, kept: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a return of 20: in pairs of the same episodes 2.5 % are seen, but not where they differ far more."""
    rng, asked = np.random.default_rng(0), iter(["after", "before"])
    common, apart = 20 + rng.normal(0, 5, 64), rng.normal(0, 1, 64)
    apart = 20 * (lost + spread * (apart - apart.mean()) / apart.std())

    def returns(*given: object, parameters: object) -> Any:
        assert parameters is made.simulation.disturbance.parameters  # those of `vary`, where it is given
        return SimpleNamespace(returns=common - apart if next(asked) == "after" else common)

    made = trainer(tmp_path)
    made.begin_with(made.policy.state_dict())
    monkeypatch.setattr(judged, "of_draws", returns)
    monkeypatch.setattr(judged, "without_action", lambda *given: SimpleNamespace(returns=np.zeros(64)))
    made._keep_what_was_better()
    assert made.kept == kept


def test_schedules_begin_halfway_also_after_a_restart(tmp_path: Path) -> None:
    trained(tmp_path)
    runs = [trainer(tmp_path) for _ in range(2)]
    runs[0].begin_with(carried_over(str(tmp_path / "run"), runs[0].policy.architecture))
    runs[0].update()
    assert runs[0].optimiser.rate == pytest.approx(SMALL.actor_rate * (1 - LEARNED))
    runs[1].restore(runs[0].state())
    for run in runs:
        run.update()
    rates = [run.optimiser.rate for run in runs]
    assert rates == [pytest.approx(SMALL.actor_rate * (1 - LEARNED) * 3 / 4)] * 2
    for a, b in zip(runs[0].policy.parameters(), runs[1].policy.parameters(), strict=True):
        assert torch.equal(a, b)


def test_the_policy_stays_until_the_critic_knows_it(tmp_path: Path) -> None:
    """Three memories of the discount in windows, at most a tenth of the updates; a fresh run moves at once."""
    trained(tmp_path)
    config = replace(SMALL, iterations=1000, discount=0.9)
    model = ComplementarityModel(slider.scene(tmp_path))
    fresh, going_on = (SHAC(slider.mdp(), model, config) for _ in range(2))
    going_on.begin_with(carried_over(str(tmp_path / "run"), going_on.policy.architecture))
    assert (fresh.listens, going_on.listens) == (0, 4)  # ceil(3 * 10 / 8)
    moved = []
    for _ in range(6):
        before = going_on.policy.net[0].weight.detach().clone()
        critic = going_on.critic.net[0].weight.detach().clone()
        going_on.update()
        moved.append(not torch.equal(going_on.policy.net[0].weight, before))
        assert not torch.equal(going_on.critic.net[0].weight, critic)
    assert moved == [False] * 4 + [True] * 2
    going_on.config = replace(config, iterations=20)
    assert going_on.listens == 2


@pytest.mark.parametrize(
    ("held", "wanted", "words"),
    [
        (Architecture(3, 1, (16,)), Architecture(2, 1, (16,)), "takes 3 observations and gives 1 actions.*has 2 and 1"),
        (Architecture(2, 1, (8, 4)), Architecture(2, 1, (16,)), "hidden 8,4.*16.*--set actor_hidden=8,4"),
        (Architecture(4, 1, (16,), last_actions=2), Architecture(2, 1, (16,)), "last 2 actions.*--set last_actions=2"),
        (Architecture(2, 1, (16,), squash="clip"), Architecture(2, 1, (16,)), "squash clip.*train it by shac or fopg"),
    ],
)  # fmt: skip
def test_another_policy_is_refused(held: Architecture, wanted: Architecture, words: str, tmp_path: Path) -> None:
    save_policy(Policy(held), tmp_path / "run", {"task": "slider"})
    with pytest.raises(UserError, match=f"--start .*run: .*{words}"):
        carried_over(str(tmp_path / "run"), wanted)
