"""The complementarity-model loop: fit, improve, execute, append, and again.

Zhang, Jin & Wang, "Adaptive Barrier Smoothing for First-Order Policy Gradient with Contact Dynamics" (ICML 2023),
algorithm 2. Of its own here: policies improve on draws from the fit's posterior, under velocity noise; several are
trained from different seeds, to the end or on trial, and the best goes on. Which one is decided by its return in the
model under these draws, never by a return in the real system. Without the noise, for that return ranks policies as the
real system does (rank correlation 0.99 over ten hoppers), and the one with noise does not (0.43).
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Self

import torch

from cmbrl.data.transitions import Transitions
from cmbrl.envs.evaluation import evaluate_model
from cmbrl.envs.mdp import MDP
from cmbrl.envs.recording import Recording
from cmbrl.envs.simulation import Disturbance, parameter_sets
from cmbrl.envs.system import SystemFactory
from cmbrl.errors import UserError
from cmbrl.fitting import FitResult, fit
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.train.policy import Policy
from cmbrl.train.shac import SHAC, SHACConfig

EPISODE_STEPS = 200  # of a recorded episode, at most


@dataclass(frozen=True)
class LoopConfig(SHACConfig):
    """SHAC's settings and those of the loop; ``iterations`` are all updates, of every round and policy together."""

    iterations: int = 6000
    rounds: int = 1  #: of executing, fitting and improving
    transitions: int = 1000  #: real ones of the first round, by random actions; a log that is given counts
    more: int = 1000  #: real ones of each further round, by the policy with its exploration noise
    policies: int = 2  #: begun in each round
    trial: float = 1.0  #: share of its updates that each of them gets, before the best is trained to the end
    draws: int = 256  #: parameter sets from the fit's posterior
    score_episodes: int = 128  #: in the model, by which policies are compared

    @classmethod
    def cheetah(cls) -> Self:
        """SHAC's settings for it; its policies differ less, so that a quarter of one tells which of two goes on."""
        return replace(super().cheetah(), iterations=1875, trial=0.25)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.trial <= 1:
            raise UserError(f"trial = {self.trial:g}: is a share of a policy's updates: above 0, at most 1")

    def shac(self) -> SHACConfig:
        """The settings of one policy in one round."""
        names = [field.name for field in fields(SHACConfig)]
        own = SHACConfig(**{name: getattr(self, name) for name in names})
        return replace(own, iterations=max(1, int(self.iterations / (self.rounds * (1 + self._extra())))))

    def trial_updates(self) -> int:
        """Updates of each policy before one is chosen."""
        return max(1, round(self.trial * self.shac().iterations)) if self.policies > 1 else 0

    def _extra(self) -> float:
        """Work on policies that are not trained to the end, in units of one that is."""
        return self.trial * (self.policies - 1)


class Loop:
    """``model``: the nominal one, whose parameters are fitted; ``system``: makes the real system; ``data``: a log.

    Raises UserError without a system.
    """

    def __init__(
        self,
        mdp: MDP,
        model: ComplementarityModel,
        config: LoopConfig,
        seed: int = 0,
        *,
        system: SystemFactory | None,
        data: Transitions | None = None,
    ) -> None:
        if system is None:
            raise UserError("the loop acts in the real system: leave --offline out, or fit the log and train by shac")
        self.mdp, self.nominal, self.config, self.seed = mdp, model, config, seed
        self.given = data
        # Restarts give the fit episodes to set against each other, and states near the start to learn from.
        self.recording = Recording(replace(mdp, episode_steps=min(mdp.episode_steps, EPISODE_STEPS)), system, seed)
        self.generator = torch.Generator().manual_seed(seed)
        self.round = 0
        self.before: dict[str, torch.Tensor] = {}  # the policy at the end of the last round
        self.tried: list[dict[str, Any]] = []  # score and trainer's state of each policy whose trial is over
        self.settings, self.trial_updates = config.shac(), config.trial_updates()
        self.model: ComplementarityModel | None = None
        self.fitted: FitResult | None = None  # of this process; a resumed run has that of before in its folder
        self.trainer = SHAC(mdp, model, self.settings, seed)  # its policy acts before the first fit; then replaced

    @property
    def policy(self) -> Policy:
        """The one that is being trained."""
        return self.trainer.policy

    def update(self) -> dict[str, float]:
        """One update of one policy; before the first of a round the robot acts and the model is fitted."""
        if self.model is None:  # a round begins
            self._execute()
            self._fit()
            self._begin_policy()
        metrics = self.trainer.update()
        tried = self.trainer.iteration == self.trial_updates and len(self.tried) < self.config.policies
        if tried or self.trainer.iteration == self.settings.iterations:
            metrics["score"] = self._score()
        if tried:
            self._end_trial(metrics["score"])
        if self.trainer.iteration == self.settings.iterations:  # also where a trial is all of it
            self._end_round()
        counted = {"transitions": float(self._transitions()), "round": float(self.round)}
        return metrics | counted

    def _execute(self) -> None:
        """Real transitions: by random actions at first (unless a log was given), then by the policy with noise."""
        wanted = self.config.transitions + self.round * self.config.more - self._transitions()
        self.recording.place()  # as after a restart, so that a resumed run records the same
        for _ in range(wanted):
            shape = (1, self.mdp.actions)
            if self.round == 0:
                action = 2 * torch.rand(shape, generator=self.generator, dtype=torch.float64) - 1
            else:
                noise = self.settings.noise_std(1.0) * torch.randn(shape, generator=self.generator)
                with torch.no_grad():
                    action = self.policy.sample(self.recording.observe().float(), noise).double()
            self.recording.step(action)

    def _transitions(self) -> int:
        return self.recording.transitions + (len(self.given) if self.given is not None else 0)

    def _fit(self) -> None:
        """All parameters, from the nominal ones, on everything seen so far.

        A derivative that is softer than the simulation is for policies; parameters are sought by the simulation's own.
        """
        logs = [log for log in (self.given, self.recording.log() if self.recording.transitions else None) if log]
        sought = self.nominal.with_settings(backward_smoothing=self.nominal.smoothing)
        self.fitted = fit(sought, Transitions.joined(logs), seed=self.seed + self.round, groups="all")
        fitted = self.fitted.uncertain_model(self.config.draws, self.seed)
        self.model = fitted.with_settings(backward_smoothing=self.nominal.backward_smoothing)

    def _begin_policy(self) -> None:
        """A fresh policy in the first round; later that of the last round, with new optimisers and a new critic.

        SHAC draws its parameter sets by its own seed, so that every policy and every round sees others.
        """
        assert self.model is not None
        seed = self.seed + 1000 * len(self.tried) + 100 * self.round
        self.trainer = SHAC(self.mdp, self.model, self.settings, seed)
        if self.before:  # not merely a later round: a finished run that is restored has none
            self.trainer.policy.load_state_dict(self.before)

    def _score(self) -> float:
        """Mean return in the model under its uncertainty."""
        assert self.model is not None
        disturbance = Disturbance(parameters=parameter_sets(self.model, 0.0, seed=self.seed + 1))
        episodes = self.config.score_episodes
        found = evaluate_model(self.policy, self.mdp, self.model, episodes, self.seed + 1, disturbance)
        return float(found.returns.mean())

    def _end_trial(self, score: float) -> None:
        """The next policy's trial, or after the last the best of them goes on where its trial ended."""
        self.tried.append({"score": score, "trainer": copy.deepcopy(self.trainer.state())})
        self._begin_policy()
        if len(self.tried) == self.config.policies:
            self.trainer.restore(max(self.tried, key=lambda one: one["score"])["trainer"])

    def _end_round(self) -> None:
        """The next round begins with acting."""
        self.round += 1
        if self.round < self.config.rounds:
            self.before = {name: value.clone() for name, value in self.policy.state_dict().items()}
            self.model, self.tried = None, []

    def keep(self, folder: Path) -> None:
        """The last fit, in ``folder``/fit as `cmbrl fit` leaves one: to be looked at, compared, trained on."""
        if self.fitted is not None:
            self.fitted.save(folder / "fit")

    def state(self) -> dict[str, Any]:
        """Everything that the next update depends on, but for the log that was given."""
        model = self.model
        return {
            "round": self.round,
            "before": self.before,
            "tried": self.tried,
            "recording": self.recording.state(),
            "generator": self.generator.get_state(),
            "parameters": None if model is None else torch.from_numpy(model.parameters),
            "draws": None if model is None else torch.from_numpy(model.candidates),
            "trainer": self.trainer.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Goes on from what ``state`` returned, bit for bit."""
        self.round, self.before, self.tried = state["round"], state["before"], state["tried"]
        self.recording.restore(state["recording"])
        self.generator.set_state(state["generator"])
        self.model = None
        if state["parameters"] is not None:
            settings = {"parameters": state["parameters"].numpy(), "candidates": state["draws"].numpy()}
            self.model = self.nominal.with_settings(**settings)
            self._begin_policy()  # with the draws that it had
        self.trainer.restore(state["trainer"])
