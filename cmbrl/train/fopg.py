"""FOPG: policy gradients of returns through the model, over windows or whole episodes, by four estimators.

Pathwise (backpropagation through time), score function, their bounded mixture (AoBG) and total propagation (PIPPS):
the methods of :mod:`cmbrl.gradients` on a policy net. Each chooses messages to the net's outputs, one per sample and
step, from which the per-sample gradients follow. With a critic, SHAC's, the ends of windows are valued.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Literal

import torch
from torch import Tensor

from cmbrl.envs.simulation import Simulation, Step
from cmbrl.errors import UserError, did_you_mean
from cmbrl.gradients.aobg import BiasBound, aobg
from cmbrl.gradients.estimate import Estimate
from cmbrl.gradients.per_sample import per_sample_gradients
from cmbrl.gradients.pipps import Future, NoisyNode
from cmbrl.gradients.score import leave_one_out
from cmbrl.mdp import MDP
from cmbrl.models.protocol import Model
from cmbrl.settings import setting
from cmbrl.train.policies.policy import Architecture
from cmbrl.train.windows.config import WindowConfig, decayed
from cmbrl.train.windows.critic import BETAS, check_discount
from cmbrl.train.windows.learner import WindowLearner

ESTIMATORS = ("pathwise", "zeroth", "aobg", "pipps")
PLAIN_BETAS = (0.9, 0.999)  # of Adam where there is no critic


@dataclass(frozen=True)
class FOPGConfig(WindowConfig):
    """Settings of FOPG; our choice."""

    iterations: int = setting(500, "updates of the policy", least=1)
    samples: int = setting(
        64, "episodes side by side; aobg takes twice as many, half for each order", least=1, most=1_000_000
    )
    horizon: int | None = setting(None, "control steps of a window; overrides window; 0: a whole episode", least=0)
    restart: bool = setting(False, "start every window from a reset instead of where the last one ended")
    estimator: Literal["pathwise", "zeroth", "aobg", "pipps"] = setting(
        "pathwise", "gradient estimator: pathwise, zeroth (score function), aobg or pipps"
    )
    critic: bool = setting(False, "value the ends of windows by a critic")
    hidden: tuple[int, ...] = setting((32, 32), "hidden layers of the policy", least=1, most=8_192)
    norm: bool = setting(True, "LayerNorm in the policy")
    normalise: bool = setting(True, "standardise observations")
    squash: Literal["tanh", "clip"] = setting("tanh", "how the net's output is brought into [-1, 1]: tanh or clip")
    rate: float = setting(2e-3, "learning rate (Adam); falls linearly to 0", least=0)
    std: float = setting(0.2, "standard deviation of the noise on the net's output; only pathwise works at 0", least=0)
    std_end: float | None = setting(None, "the same at the end, reached geometrically; none: constant", above=0)
    bias: float = setting(math.inf, "gamma of aobg: largest bias allowed; inf: pure inverse variance", least=0)
    bias_delta: float = setting(0.05, "probability with which that bound may fail", least=0)
    bias_scale: float = setting(1.0, "bound on a zeroth-order sample, in units of the gradient", least=0)

    def __post_init__(self) -> None:
        if self.estimator not in ESTIMATORS:
            raise UserError(f"unknown estimator {self.estimator!r}: {did_you_mean(self.estimator, ESTIMATORS)}")
        if self.estimator != "pathwise" and not self.std > 0:
            raise UserError(f"estimator {self.estimator!r} with std = {self.std}: needs noise on the actions")
        if self.std_end is not None and not self.std > 0:
            raise UserError(f"std = {self.std} cannot fall to std_end = {self.std_end}: choose std above 0")
        if self.critic:
            check_discount(self.discount)

    def noise_std(self, progress: float) -> float:
        """Standard deviation of the noise when this share of the updates is done."""
        if self.std_end is None:
            return self.std
        return decayed(math.log(self.std), math.log(self.std_end), progress)


@dataclass(frozen=True)
class Window:
    """What a rollout of H steps left, (H, N, ...): the net's ``inputs``, its outputs, what was added to them, rewards.

    ``rewards`` are discounted from the start of the window or of the episode, with the critic's value of open ends;
    ``ended`` says where an episode did; ``steps`` are the simulation's.
    """

    inputs: Tensor
    outputs: list[Tensor]
    noise: Tensor  # of unit deviation; 0 for samples that are over
    rewards: list[Tensor]
    ended: list[Tensor]
    futures: list[Future]
    steps: list[Step]

    def total(self) -> Tensor:
        """Sum over samples and steps."""
        return torch.stack(self.rewards).sum()

    def returns_to_go(self) -> list[Tensor]:
        """Discounted rewards (N,) from each step to the end of its episode or of the window."""
        following = torch.zeros_like(self.rewards[0])
        found = []
        for reward, ended in zip(reversed(self.rewards), reversed(self.ended), strict=True):
            following = reward.detach() + torch.where(ended, 0.0, following)
            found.append(following)
        return found[::-1]


class FOPG(WindowLearner):
    """``update`` is one window (aobg: two, with noise of their own) and one step of Adam along the estimate."""

    title, remedy = "FOPG", "shorten the window, or smooth more"
    config: FOPGConfig

    def __init__(self, mdp: MDP, model: Model, config: FOPGConfig, seed: int = 0) -> None:
        c, mdp = config, config.process(mdp, model)
        super().__init__(
            mdp,
            model,
            c,
            seed,
            architecture=Architecture.of(mdp, c.hidden, norm=c.norm, squash=c.squash, normalise=c.normalise),
            rate=c.rate,
            betas=BETAS if c.critic else PLAIN_BETAS,
            count=c.samples,
            generator=torch.Generator().manual_seed(seed),
            # Its own generator, so that the noise of the windows does not depend on whether there is a critic.
            critic=torch.Generator().manual_seed(seed) if c.critic else None,
            batches=2 if c.estimator == "aobg" else 1,
            stagger=not c.restart,
        )
        self.std = c.noise_std(0.0)  #: of the noise in the present update
        self.weight = math.nan  #: AoBG's share of the first order
        self._windows: list[Window] = []  # of the last estimate

    def gradient(self, progress: float) -> dict[str, float]:
        """Rolls a window and leaves the clipped estimate in the policy; see the base class."""
        self.std = self.config.noise_std(progress)
        estimate = self.estimate()
        gradient = torch.from_numpy(estimate.mean).float()
        norm = float(gradient.norm())
        scale = min(1.0, self.config.clip / norm) if norm > 0 else 1.0
        parameters = list(self.policy.net.parameters())
        for p, part in zip(parameters, gradient.split([p.numel() for p in parameters]), strict=True):
            p.grad = -scale * part.view_as(p)
        metrics = {
            "gradient_norm": norm,
            "gradient_variance": estimate.total_variance,
            "failed_samples": float(estimate.failed),
        }
        return metrics | ({"first_order_weight": self.weight} if self.config.estimator == "aobg" else {})

    def learn(self) -> dict[str, float]:
        """Updates the normaliser, and the critic if there is one."""
        for window in self._windows:
            observations = torch.cat([step.observation.detach().float() for step in window.steps])
            self.policy.normaliser.update(observations[torch.isfinite(observations).all(dim=1)])
        windows, self._windows = [window.steps for window in self._windows], []
        return {} if self.critic is None else {"critic_loss": self.critic.fit(side_by_side(windows))}

    def estimate(self) -> Estimate:
        """Gradient of a window's expected return at the present policy (n,), in the order of the net's parameters."""
        c = self.config
        self._windows = []
        if c.estimator == "zeroth":
            return self._score(self.simulation)
        if c.estimator == "pipps":
            return self._total_propagation(self.simulation)
        first = self._pathwise(self.roll(self.simulation))
        if c.estimator == "pathwise":
            return first
        bound = BiasBound(c.bias, c.bias_delta, c.bias_scale)
        mixed, self.weight = aobg(first, self._score(self.simulations[1]), bound)
        return mixed

    def _total_propagation(self, simulation: Simulation) -> Estimate:
        """As pathwise, but at every noisy node of the graph path and score message are combined."""
        window = self.roll(simulation, nodes=True)
        for future, value in zip(window.futures, window.returns_to_go(), strict=True):
            future.value = value
        return self._pathwise(window)

    def _pathwise(self, window: Window) -> Estimate:
        """The derivative of the window's return in the net's outputs, with everything that follows from them."""
        messages = torch.autograd.grad(window.total(), window.outputs)
        return self._gathered(window, torch.stack(messages), derivatives=True)

    def _score(self, simulation: Simulation) -> Estimate:
        """Score function with rewards to go, minus the mean of the other samples' (their noise is independent)."""
        with torch.no_grad():
            window = self.roll(simulation)
        advantage = torch.stack([value - leave_one_out(value) for value in window.returns_to_go()])
        return self._gathered(window, advantage[..., None] * window.noise / self.std, derivatives=False)

    def _gathered(self, window: Window, messages: Tensor, derivatives: bool) -> Estimate:
        self._windows.append(window)
        inputs = window.inputs.transpose(0, 1)
        gradients = per_sample_gradients(self.policy.net, inputs, messages.float().transpose(0, 1))
        steps = len(window.rewards) * self.config.samples * self.mdp.repeat
        return Estimate(gradients.double().numpy(), steps, steps if derivatives else 0)

    def roll(self, simulation: Simulation, nodes: bool = False) -> Window:
        """A window with noise on the net's output; with ``nodes`` the noise is a node of total propagation."""
        c, policy = self.config, self.policy
        simulation.detach()
        if c.restart:
            simulation.restart()
        running = torch.ones(c.samples, dtype=torch.bool)  # false once the first episode is over, if windows restart
        discount = torch.ones(c.samples, dtype=torch.float64)
        noises, w = [], Window(torch.empty(0), [], torch.empty(0), [], [], [], [])
        with policy.held():
            for k in range(self.horizon):
                observation = simulation.observe()
                output = policy.drive(observation.float())
                noise = torch.randn(output.shape, generator=self.generator) * running[:, None]
                future = Future()
                noisy = NoisyNode.apply(output, noise, self.std, future) if nodes else output + self.std * noise
                step = simulation.step(observation, policy.squash(noisy))
                reward = self._valued(step, last=k == self.horizon - 1) + step.shaping
                w.rewards.append(torch.where(torch.isfinite(reward) & running, discount * reward, 0.0))
                ended = step.terminated | step.truncated
                discount = torch.where(ended, 1.0, c.discount * discount)
                running = running & ~ended if c.restart else running
                noises.append(noise)
                w.steps.append(step)
                w.outputs.append(output)
                w.ended.append(ended)
                w.futures.append(future)
                if not running.any():
                    break
        seen = [step.observation.detach().float() for step in w.steps]
        inputs = torch.stack([policy.normaliser(o) if c.normalise else o for o in seen])
        return Window(inputs, w.outputs, torch.stack(noises), w.rewards, w.ended, w.futures, w.steps)

    def _valued(self, step: Step, last: bool) -> Tensor:
        """The step's reward (N,), plus the critic's value of episodes that the window or a time limit cuts there."""
        if self.critic is None:
            return step.reward
        rows = (~step.terminated if last else step.truncated).nonzero()[:, 0]
        if not len(rows):
            return step.reward
        value = self.config.discount * self.critic.value(step.next_observation[rows].float())
        return step.reward.index_add(0, rows, value.double())


def side_by_side(windows: list[list[Step]]) -> list[Step]:
    """Windows of equal length as one window of all their rows."""
    rows = [f.name for f in fields(Step) if f.name != "info"]
    return [
        replace(steps[0], **{name: torch.cat([getattr(s, name) for s in steps]) for name in rows})
        for steps in zip(*windows, strict=True)
    ]
