"""Augmented random search with all directions side by side on one batched model.

Mania, Guy & Recht 2018 (arXiv 1803.07055), version V2-t: a linear policy of scaled observations. The search of
`cmbrl.train.ars` tries one direction after the other, so in equal seconds most of its time would go to Python.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from cmbrl.envs.simulation import Simulation
from cmbrl.mdp import MDP
from cmbrl.models.protocol import Model
from cmbrl.train.ars import ARSConfig
from cmbrl.train.policies.policy import Architecture, Policy


class BatchedARS:
    """``update`` is one step of the search: two episodes of ``episode_steps`` for each direction."""

    def __init__(self, mdp: MDP, model: Model, config: ARSConfig, episode_steps: int, seed: int = 0) -> None:
        self.mdp, self.model, self.config, self.episode_steps = mdp, model, config, episode_steps
        self.generator = torch.Generator().manual_seed(seed)
        self.simulation = Simulation(mdp, model, 2 * config.directions, seed)
        self.policy = Policy(Architecture(mdp.observations, mdp.actions, hidden=(), squash="clip"))
        layer = self.policy.net[-1]
        assert isinstance(layer, nn.Linear)
        self.layer = layer
        with torch.no_grad():
            self.layer.weight.zero_()
        self.iteration = 0

    @torch.no_grad()
    def update(self) -> dict[str, float]:
        """One step; returns its metrics."""
        c, weights = self.config, self.layer.weight
        directions = torch.randn(c.directions, *weights.shape, generator=self.generator)
        trial = torch.cat([weights + c.deviation * directions, weights - c.deviation * directions])
        returns = self._returns(trial)
        up, down = returns.view(2, -1)
        chosen = torch.maximum(up, down).topk(min(c.best, c.directions)).indices
        spread = torch.cat([up[chosen], down[chosen]]).std() + 1e-6
        step = torch.einsum("d,dij->ij", (up - down)[chosen].float(), directions[chosen])
        weights.add_(c.rate / (len(chosen) * float(spread)) * step)
        self.iteration += 1
        return {"return": float(returns.mean()), "steps": float(self.simulation.steps_taken)}

    def _returns(self, weights: Tensor) -> Tensor:
        """Returns (B,) of one episode of each of the policies (B, n_a, n_o)."""
        simulation, seen = self.simulation, []
        simulation.restart()
        running = torch.ones(len(weights), dtype=torch.bool)
        total = torch.zeros(len(weights), dtype=torch.float64)
        for _ in range(self.episode_steps):
            observation = simulation.observe()
            seen.append(observation[running].float())
            scaled = self.policy.normaliser(observation.float())
            step = simulation.step(observation, self.policy.squash(torch.einsum("bij,bj->bi", weights, scaled)))
            total += torch.where(running, step.reward.nan_to_num() + self.config.alive, 0.0)
            running &= ~(step.terminated | step.truncated)
            if not running.any():
                break
        self.policy.normaliser.update(torch.cat(seen))
        return total
