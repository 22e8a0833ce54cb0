"""What a policy earns in its model in whole episodes, and what is kept by that."""

from __future__ import annotations

import copy
import math

import numpy as np
import torch

from cmbrl.envs.checked_gradient import reward_slopes
from cmbrl.envs.simulation import Simulation
from cmbrl.envs.trials import failed, of_draws, quits, trials, unlearned, without_action
from cmbrl.mdp import MDP
from cmbrl.models.protocol import Model
from cmbrl.train.policies.policy import observed_by
from cmbrl.train.trainer import Trainer

COST, SURE = 0.01, 3.0  # share of a return, and standard errors, by which a run that goes on may end below its start


class JudgedTrainer(Trainer):
    """A trainer on ``model`` that tries its policy there, in episodes of the task's own length (``whole``)."""

    mdp: MDP  #: that it trains on
    whole: MDP  #: that its policy is tried on: trials see what an evaluation does
    model: Model
    simulation: Simulation
    begun_with: dict[str, torch.Tensor]  #: the policy of another run; empty: none
    _failed: tuple[dict[str, torch.Tensor], dict[str, float]] | None = None  # weights last tried, and shares

    def failed_trials(self) -> dict[str, float]:
        """Of whole episodes, from starts as in an evaluation; none where a curriculum chooses those too.

        Then ``earned`` and ``advice`` are known too.
        """
        mdp = self._tried()
        if mdp.curriculum:
            return {}
        weights = self.policy.state_dict()
        if self._failed is not None and all(torch.equal(x, weights[name]) for name, x in self._failed[0].items()):
            return dict(self._failed[1])  # at the end of its updates it may have been tried already: that takes minutes
        found, idle = trials(self.policy, mdp, self.model), without_action(mdp, self.model)
        returns = {"policy": found["draws"].returns, "no action": idle.returns}
        self.earned = {name: float(each.mean()) for name, each in returns.items()}
        self.advice = quits(found["draws"], mdp) or unlearned(self.earned, reward_slopes(mdp, "the task")[0])
        self._failed = copy.deepcopy(weights), failed(found, idle)
        return dict(self._failed[1])

    def _tried(self) -> MDP:
        """The process of trials."""
        return self.whole if self.judged is None else observed_by(self.policy, self.judged)

    def _idle(self) -> float:
        """Mean return of training's episodes without action; 0 where a curriculum has their starts."""
        return 0.0 if self.mdp.curriculum else float(without_action(self.mdp, self.model).returns.mean())

    def _earned(self) -> float:
        """Mean return of whole episodes without noise, from an evaluation's starts; 0 where a curriculum has them."""
        mdp = self._tried()
        return 0.0 if mdp.curriculum else float(of_draws(self.policy, mdp, self.model).returns.mean())

    def _keep_what_was_better(self) -> None:
        """Gives the policy the weights that it began with, where going on has cost it some of their return.

        Both are tried in the same episodes, so that little is told from nothing: the share COST of that return, or of
        what it is above that of no action, and SURE standard errors of the difference. Parameters are those that
        training draws, so that what goes on under other friction does so for that.
        """
        mdp, own = self._tried(), copy.deepcopy(self.policy.state_dict())

        def earned() -> np.ndarray:
            table = self.simulation.disturbance.parameters
            return of_draws(self.policy, mdp, self.model, parameters=table).returns

        after = earned()
        self.policy.load_state_dict(self.begun_with)
        before, idle = earned(), without_action(mdp, self.model).returns
        cost, noise = float((before - after).mean()), float((before - after).std()) / math.sqrt(len(after))
        if cost > max(SURE * noise, COST * max(abs(before.mean()), (before - idle).mean())):
            self.kept = 0
        else:
            self.policy.load_state_dict(own)
