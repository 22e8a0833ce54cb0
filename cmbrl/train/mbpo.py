"""MBPO: short rollouts of a neural ensemble, branched off real states, feed a soft actor-critic.

Janner, Fu, Zhang, Levine, "When to Trust Your Model: Model-Based Policy Optimization" (NeurIPS 2019, arXiv 1906.08253);
the settings are those of the authors' TensorFlow code; ``EnsembleConfig.original()`` gives their ensemble. The soft
actor-critic is Stable-Baselines3's. Two differences favour MBPO here: reward and termination of imagined steps are
computed from the predicted states by the task's own functions (the original learns the reward), and the hopper's
termination tests both bounds (the original tests only the upper one).
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor

from cmbrl.data.transitions import Transitions
from cmbrl.envs.recording import Recording, outcome
from cmbrl.errors import UserError
from cmbrl.mdp import MDP
from cmbrl.models.neural.ensemble import NeuralEnsemble
from cmbrl.system import SystemFactory
from cmbrl.train.mbpo_config import MBPOConfig
from cmbrl.train.policies.policy import Architecture, Policy
from cmbrl.train.randomness import GlobalRandomness
from cmbrl.train.rivals import stable_baselines as sb3
from cmbrl.train.rivals.branching import branch
from cmbrl.train.rivals.pool import Mixture, Pool
from cmbrl.train.trainer import Diverged, Trainer, episode_metrics

NO_ACTIONS = "the log's controls are not this task's actions: it teaches the ensemble, and no batch has rows of it"


class MBPO(Trainer):
    """``update`` is one block: refit, branch, then real steps with updates of the policy after each.

    Args:
        mdp: the task.
        model: an ensemble, which is fitted here from scratch as its ``config`` says.
        config: see there.
        seed: of everything random.
        system: makes the real system; without it no real step is taken and ``data`` is all there is.
        data: the log to start from. If its controls are not the task's actions, as where they also depend on the frame
            of a motion, it teaches the ensemble alone: rollouts branch off the task's own starts until there are real
            steps, and no batch has rows of the log.

    Raises UserError if there is neither system nor data.
    """

    def __init__(
        self,
        mdp: MDP,
        model: NeuralEnsemble,
        config: MBPOConfig,
        seed: int = 0,
        system: SystemFactory | None = None,
        data: Transitions | None = None,
    ) -> None:
        if system is None and data is None:
            raise UserError("MBPO has neither a real system nor a log to learn from: give a log (--data LOG)")
        self.mdp, self.model, self.config, self.seed, self.data = mdp, model, config, seed, data
        self.generator = torch.Generator().manual_seed(seed)
        self.randomness = GlobalRandomness(seed)
        self.recording = Recording(mdp, system, seed) if system is not None else None
        rewards = {"observation": mdp.observations, "action": mdp.actions, "reward": 1}
        widths = {**rewards, "next_observation": mdp.observations, "terminated": 1}
        q, v = mdp.reset(1, torch.Generator().manual_seed(seed))
        known = len(data) if data is not None else config.warmup
        everything = known + config.iterations * config.block
        self.real = Pool({"q": q.shape[1], "v": v.shape[1], **widths}, everything, torch.float64)
        self.imagined = Pool(widths, 1)
        with self.randomness:
            self.sac = sb3.soft_actor_critic(
                mdp, learning_rate=config.rate, batch_size=config.batch, tau=config.target_share,
                gamma=config.discount, target_entropy=config.target_entropy,
                policy_kwargs={"net_arch": list(config.hidden)},
            )  # fmt: skip
        self.sac.replay_buffer = Mixture(self.real, self.imagined, config.real_share, self.generator)
        self.policy = Policy(Architecture.of(mdp, config.hidden, "relu", False, "tanh", False))
        self._take_policy()
        self.iteration, self.steps, self.model_error = 0, 0, float("nan")
        self.seconds = dict.fromkeys(("fit", "branch", "robot", "policy"), 0.0)

    @property
    def over(self) -> bool:
        """Whether ``max_seconds`` have been used up."""
        return self._left() <= 0

    @property
    def transitions(self) -> int:
        """Real transitions known so far."""
        logged = len(self.data) if self.data is not None else 0
        return logged + (self.recording.transitions if self.recording is not None else 0)

    def update(self) -> dict[str, float]:
        """One block; returns its metrics. Raises Diverged once the policy is not finite."""
        with self.randomness, torch.no_grad():
            if not self.over:
                if self.iteration == 0:
                    self._begin()
                if self.iteration == 0 or self.recording is not None:
                    self._refit()
                self._branch()
                self._improve()
        self.iteration += 1
        self._take_policy()
        return self._metrics()

    def _begin(self) -> None:
        """The first real rows: the log, or random actions."""
        if self.data is not None:
            if self._has_actions(self.data):
                states = (self.data.q, self.data.v, self.data.u, self.data.q_next, self.data.v_next)
                self.real.add(outcome(self.mdp, *map(torch.from_numpy, states)))
            else:
                warnings.warn(NO_ACTIONS, stacklevel=2)
        elif self.recording is not None:
            with self._clock("robot"):
                for _ in range(self.config.warmup):
                    action = 2 * torch.rand(1, self.mdp.actions, generator=self.generator, dtype=torch.float64) - 1
                    self.real.add(self.recording.step(action))

    def _has_actions(self, data: Transitions) -> bool:
        q, v, u = (torch.from_numpy(a) for a in (data.q, data.v, data.u))
        if self.mdp.repeat != 1 or u.shape[1] != self.mdp.actions:
            return False
        acted = self.mdp.act(q, v, u) if not self.mdp.memory else ()
        return bool(acted) and all(torch.equal(a, b) for a, b in zip(acted, (q, v, u), strict=True))

    def _refit(self) -> None:
        """Fits the ensemble to all real transitions, after the first time from its present weights."""
        again = self.iteration > 0
        updates = self.config.refit_updates if again else self.config.fit_updates
        limit = self._left() if self.config.max_seconds is not None else None
        with self._clock("fit"), torch.enable_grad():
            log, seed = self._log(), self.seed + self.iteration
            report = self.model.fit(log, seed, max_seconds=limit, warm_start=again, updates=updates)
        self.model_error = report.holdout_error

    def _log(self) -> Transitions:
        own = self.recording.log() if self.recording is not None and self.recording.transitions else None
        return Transitions.joined([log for log in (self.data, own) if log is not None])

    def _branch(self) -> None:
        """Fills the pool of imagined steps."""
        c = self.config
        length = c.rollout_length(self.iteration)
        self.imagined.resize(c.rollouts * length * c.keep_blocks)
        with self._clock("branch"):
            for rows in branch(self.mdp, self.model, self._act, *self._starts(), length, self.generator):
                self.imagined.add(rows)
                self.steps += len(rows["reward"]) * self.mdp.repeat

    def _starts(self) -> tuple[Tensor, Tensor]:
        if not len(self.real):
            return self.mdp.reset(self.config.rollouts, self.generator)
        rows = self.real.sample(self.config.rollouts, self.generator)
        return rows["q"], rows["v"]

    def _improve(self) -> None:
        """Real steps if there is a robot, each followed by updates of the policy, as far as time allows."""
        if self.recording is not None:
            self.recording.place()
        for _ in range(self.config.block):
            if self.over:
                break
            if self.recording is not None:
                with self._clock("robot"):
                    self.real.add(self.recording.step(self._act(self.recording.observe())))
            with self._clock("policy"), torch.enable_grad():
                self.sac.train(self.config.updates_per_step, self.config.batch)

    def _act(self, observation: Tensor) -> Tensor:
        """Random actions (B, n_a) of the present policy, float64."""
        return self.sac.actor(observation.float(), deterministic=False).double()

    def _take_policy(self) -> None:
        actor = self.sac.actor
        sb3.copy_layers([*actor.latent_pi, actor.mu], self.policy)
        if not all(torch.isfinite(p).all() for p in self.policy.parameters()):
            newest = self.real.columns(self.real.newest(1000))
            raise Diverged("MBPO: the policy is not finite: lower its rate", {k: newest[k].numpy() for k in ("q", "v")})

    def _metrics(self) -> dict[str, float]:
        found = {
            "steps": float(self.steps),
            "transitions": float(self.transitions),
            "rollout_length": float(self.config.rollout_length(self.iteration - 1)),
            "model_error": self.model_error,
            **{f"seconds_{part}": seconds for part, seconds in self.seconds.items()},
        }
        logged = self.sac.logger.name_to_value
        found |= {k: float(logged[f"train/{k}"]) for k in ("critic_loss", "actor_loss", "ent_coef") if logged}
        if logged:
            found["gradient_norm"] = sb3.gradient_norm(self.sac.actor)
        return found | episode_metrics(self.recording.finished[-5:] if self.recording is not None else [])

    @contextmanager
    def _clock(self, part: str) -> Iterator[None]:
        started = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[part] += time.perf_counter() - started

    def _left(self) -> float:
        limit = self.config.max_seconds
        return float("inf") if limit is None else limit - sum(self.seconds.values())

    def state(self) -> dict[str, Any]:
        """Everything that the next update depends on; hundreds of MB with the original's rollouts."""
        return {
            "seed": self.seed,
            "iteration": self.iteration,
            "steps": self.steps,
            "model_error": self.model_error,
            "seconds": dict(self.seconds),
            "sac": sb3.parameters(self.sac),
            "network": self.model.network.state_dict(),
            "elites": self.model.elites,
            "real": self.real.state(),
            "imagined": self.imagined.state(),
            "recording": self.recording.state() if self.recording is not None else None,
            "generator": self.generator.get_state(),
            "randomness": self.randomness.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continues from what ``state`` returned, bit for bit."""
        self.seed, self.iteration, self.steps = (state[k] for k in ("seed", "iteration", "steps"))
        self.model_error = state["model_error"]
        self.seconds = dict(state["seconds"])
        sb3.set_parameters(self.sac, state["sac"])
        self.model.network.load_state_dict(state["network"])
        self.model.elites = state["elites"]
        self.real.restore(state["real"])
        self.imagined.restore(state["imagined"])
        if self.recording is not None:
            self.recording.restore(state["recording"])
        self.generator.set_state(state["generator"])
        self.randomness.restore(state["randomness"])
        self._take_policy()
