"""The complementarity-model loop: act in the real system, fit the model, improve the policy in it, repeat.

Zhang, Jin & Wang, "Adaptive Barrier Smoothing for First-Order Policy Gradient with Contact Dynamics" (ICML 2023),
algorithm 2. Three things are our own. Policies improve on draws from the fit's posterior, under velocity noise. Several
are trained from different seeds, to the end or for a trial, and the best in the model is kept (``contest``). All but
the first begin on the file, since some fits are hard to learn on from scratch. While the best fails its trials
(``cmbrl.envs.trials``), further ones are trained.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from cmbrl.data.transitions import Transitions
from cmbrl.envs.history import with_last_actions
from cmbrl.envs.recording import Recording
from cmbrl.errors import UserError
from cmbrl.fitting import FitResult, fit
from cmbrl.fitting.outcome.first_line import first_line
from cmbrl.fitting.played import fit_or_played, keep
from cmbrl.mdp import MDP
from cmbrl.models.carried import without_play
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.system import SystemFactory
from cmbrl.train.contest import Contest, judged
from cmbrl.train.loop_config import LoopConfig
from cmbrl.train.shac import SHAC
from cmbrl.train.trainer import Trainer

EPISODE_STEPS = 200  # of a recorded episode, at most
_LAWS = ("integrator", "damping", "sliding", "look_ahead")  # of the fit, as policies are trained on it


class Loop(Trainer):
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
            raise UserError("loop acts in the real system: drop --offline, or `cmbrl fit` the log and train by shac")
        self.task, self.nominal, self.config, self.seed = mdp, model, config, seed
        self.mdp = mdp  #: with the last actions that policies observe, once a model is fitted
        self.given = data
        # Short episodes: the fit can hold some out, and sees many states near the start.
        self.recording = Recording(replace(mdp, episode_steps=min(mdp.episode_steps, EPISODE_STEPS)), system, seed)
        self.generator = torch.Generator().manual_seed(seed)
        self.round = 0
        self.before: dict[str, torch.Tensor] = {}  # the policy at the end of the last round
        self.contest = Contest(config.policies, config.further)
        self.settings, self.trial_updates = config.shac(), config.trial_updates()
        self.file_updates = round(config.on_file * (self.trial_updates or self.settings.iterations))
        self.model: ComplementarityModel | None = None
        self.fitted: FitResult | None = None  # by this process; an earlier one is in the run folder
        self.verdict = ""  # of the last fit, by whichever process
        self._begin(model, seed)  # its policy acts before the first fit

    def update(self) -> dict[str, float]:
        """One update of one policy; at the start of a round, the robot acts and the model is fitted before it."""
        if self.model is None:  # a round begins
            self._execute()
            self._fit()
            assert self.model is not None
            self._choose_observations(self.model)
            self._begin_policy()
        metrics = self.trainer.update()
        if self._begins_on_file() and self.trainer.iteration == self.file_updates:
            self._carry_over()
        tried = self.trainer.iteration == self.trial_updates and self.contest.open
        if tried or self.trainer.iteration == self.settings.iterations:
            metrics |= self._judge()
        if tried:
            self._end_trial(metrics)
        if self.trainer.iteration == self.settings.iterations:  # also where a trial is the whole training
            self._end_round()
        counted = {"transitions": float(self._transitions()), "round": float(self.round)}
        return metrics | counted

    def _execute(self) -> None:
        """Real transitions: by random actions in the first round (unless a log was given), then by the noisy policy."""
        wanted = self.config.transitions + self.round * self.config.more
        self.recording.place()  # as after a restart, so that a resumed run records the same
        shape = (1, self.mdp.actions)
        while self._transitions() < wanted:
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
        """Fits all parameters, from the nominal ones, to everything seen so far.

        A derivative softer than the simulation is for policies; parameters are fitted with the simulation's own.
        """
        logs = [log for log in (self.given, self.recording.log() if self.recording.transitions else None) if log]
        start = self.nominal.with_settings(backward_smoothing=self.nominal.smoothing)
        fitting = fit_or_played if self.config.play else fit
        self.fitted = fitting(start, Transitions.joined(logs), seed=self.seed + self.round, groups="all")
        self.verdict = first_line(self.fitted.report)
        fitted = self.fitted.uncertain_model(self.config.draws, self.seed)
        if fitted.scene.nq > self.nominal.scene.nq:  # of the file with play
            fitted = without_play(fitted, self.nominal.scene)
        fitted = fitted.for_training(self.nominal.smoothing, self.nominal)
        self.model = fitted.with_settings(backward_smoothing=self.nominal.backward_smoothing)

    def _choose_observations(self, model: ComplementarityModel) -> None:
        """How many last actions policies observe: the first model that they meet decides for all rounds."""
        if self.round == 0:
            self._observe_actions(self.settings.process(self.task, model).last_actions)

    def _observe_actions(self, count: int) -> None:
        self.settings = replace(self.settings, last_actions=count)
        self.mdp = with_last_actions(self.task, count)
        self.recording.observe_actions(count)

    def _begins_on_file(self) -> bool:
        """Whether this policy does: all but the first of the first round."""
        return self.round == 0 and bool(self.contest.tried)

    def _begin_policy(self, done: int = 0) -> None:
        """A fresh policy in the first round; later the last round's, with new optimisers and a new critic.

        SHAC draws its parameter sets by its own seed, so that every policy and every round sees different ones.
        ``done``: its updates so far, which tell whether it is still on the file.
        """
        assert self.model is not None
        on_file = self._begins_on_file() and done < self.file_updates
        self._begin(
            self.nominal if on_file else self.model, self.seed + 1000 * len(self.contest.tried) + 100 * self.round
        )
        if self.before:  # a restored run of one round has none
            self.trainer.policy.load_state_dict(self.before)

    def _carry_over(self) -> None:
        """From the file to the fit: the policy goes on, and its schedules, with a new optimiser and a new critic."""
        done, weights = self.trainer.iteration, self.policy.state_dict()
        self._begin_policy(done)
        self.policy.load_state_dict(weights)
        self.trainer.iteration = done

    def _begin(self, model: ComplementarityModel, seed: int) -> None:
        self.trainer = SHAC(self.mdp, model, self.settings, seed)
        self.policy = self.trainer.policy

    def _judge(self) -> dict[str, float]:
        """What the policy in training is worth in the model (see ``judged``)."""
        assert self.model is not None
        return judged(self.policy, self.mdp, self.model, self.config.score_episodes, self.seed + 1)

    def _end_trial(self, found: dict[str, float]) -> None:
        """Starts the next policy's trial; after the last one, the best continues where its trial ended."""
        self.contest.enter(found, self.trainer.state())
        if self.contest.open:
            self._begin_policy()
        else:
            best = self.contest.best["trainer"]
            self._begin_policy(best["iteration"])
            self.trainer.restore(best)

    def _end_round(self) -> None:
        """Prepares the next round, which begins with acting."""
        self.round += 1
        if self.round < self.config.rounds:
            self.before = {name: value.clone() for name, value in self.policy.state_dict().items()}
            self.model = None
            self.contest.begin()

    @property
    def further(self) -> int:
        """Updates of policies that were not planned."""
        return self.contest.added * self.trial_updates

    def conditions(self) -> dict[str, Any]:
        """Those of the policy in training."""
        return self.trainer.conditions()

    @property
    def ahead(self) -> str:
        """Acting and fitting at the start of a round, and the trials by which policies are compared."""
        if self.model is None:
            return "real transitions, and a fit of the model to them"
        done = self.trainer.iteration + 1
        tried = done == self.trial_updates and self.contest.open
        return "trials of the policy in the model" if tried or done == self.settings.iterations else ""

    @property
    def gradients(self) -> str:
        """Of the policy in training."""
        return self.trainer.gradients

    @property
    def remarks(self) -> dict[str, str]:  # type: ignore[override]
        """What the fit is worth, and what the policies earned of which one was kept."""
        told = {"fit": self.verdict} if self.verdict else {}
        if len(self.contest.tried) < 2 or self.round < self.config.rounds:
            return told
        ends = self.trial_updates == self.settings.iterations
        return {**told, "": self.contest.told("at their ends" if ends else f"by update {self.trial_updates}")}

    def failed_trials(self) -> dict[str, float]:
        """Those of the policy in training."""
        found = self.trainer.failed_trials()
        self.earned, self.advice = self.trainer.earned, self.trainer.advice
        return found

    def keep(self, folder: Path) -> None:
        """Writes the last fit to ``folder``/fit, as `cmbrl fit` does, to be inspected, compared and trained on."""
        if self.fitted is None:
            return
        keep(self.fitted, self.nominal.scene, folder / "fit")

    def state(self) -> dict[str, Any]:
        """Everything that the next update depends on, except the given log."""
        model = self.model
        return {
            "round": self.round,
            "before": self.before,
            **self.contest.state(),
            "verdict": self.verdict,
            "recording": self.recording.state(),
            "generator": self.generator.get_state(),
            "parameters": None if model is None else torch.from_numpy(model.parameters),
            "draws": None if model is None or model.candidates is None else torch.from_numpy(model.candidates),
            "observation": {} if model is None else model.observation,
            "laws": {} if model is None else {name: getattr(model, name) for name in _LAWS},
            "last_actions": self.settings.last_actions,
            "trainer": self.trainer.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continues from what ``state`` returned, bit for bit."""
        self.round, self.before, self.verdict = state["round"], state["before"], state["verdict"]
        self.contest.restore(state)
        if state["last_actions"] is not None:
            self._observe_actions(state["last_actions"])
        self.recording.restore(state["recording"])
        self.generator.set_state(state["generator"])
        self.model = None
        if state["parameters"] is not None:
            draws = state["draws"]
            settings = {"parameters": state["parameters"].numpy(), "observation": state["observation"], **state["laws"]}
            settings |= {} if draws is None else {"candidates": draws.numpy()}
            self.model = self.nominal.with_settings(**settings)
            self._begin_policy(state["trainer"]["iteration"])  # with the draws that it had
        self.trainer.restore(state["trainer"])
