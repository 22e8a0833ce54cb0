"""Trials of a policy in its model alone, before the robot: draws of the fit, late commands, pushes, other laws.

A model without draws is a file, which is never quite the robot: there numbers that are off by 20 % are a trial, too.

A policy that mostly fails under the draws is said to fail in the robot too; ``cmbrl bench hidden`` judges such words.

No robot slides quite by a law, so a policy should stand both laws of sliding. The other law also stands for another
simulator: on a fitted hopper a policy that fell in 94 % of its episodes under the convex law fell in all of those in
MuJoCo with the fitted values, while it fell in none under the law that it was trained on. Training takes longer steps
than the file, and rows that act before they close: the last trial takes MuJoCo's own step of the file. A Talos with
stiff soles that walked under both laws of sliding fell there in all episodes, and in MuJoCo.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from cmbrl.envs.disturbance import Disturbance, parameter_sets
from cmbrl.envs.evaluation import Actor, Evaluation, evaluate_model
from cmbrl.mdp import MDP
from cmbrl.models.between.robots import Wraps
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.protocol import HasLawOfSliding, Model
from cmbrl.scene import Scene
from cmbrl.scene.records import JointKind

LATE = 1  #: control steps
SPREAD = 0.2  #: by up to which share a file's numbers may be off
PUSH, EVERY = 0.3, 1.0  #: m/s of the base, in any horizontal direction that it has; s between pushes
THRESHOLD = 0.5  #: share of episodes that fail under the draws from which a policy is said to fail
LAWS = ("draws", "law", "mujoco")  #: trials of the robot as it may be; the others make it harder
LEANS = 0.3  #: under the draws or the other law: of 42 policies of hidden hoppers below it none fell, of 14 above it 6
HARDLY = 0.02  #: share of what no action earns by which a policy earns hardly more
SMOOTHER = "let it grow with what the task wants, as a speed, or as a distance shrinks"  #: a reward without derivative
_WORDS = {
    "late": "commands a step late",
    "parameters": f"parameters off by up to {100 * SPREAD:.0f} %",
    "pushed": "pushes",
    "law": "the other law of sliding",
    "mujoco": "MuJoCo's step of the file",
}
_MORE = "from another --seed, or with a second round that acts by the policy (--set rounds=2)"  # of a loop
EPISODES = 64  #: of each trial
_SLOW = 4  # times fewer episodes in the file's short steps


def trials(
    policy: Actor, mdp: MDP, model: Model, episodes: int = EPISODES, seed: int = 0, tell: bool = False
) -> dict[str, Evaluation]:
    """Episodes in the model by trial, all under the model's draws.

    They are "draws", "late", "parameters" if the model has no draws, "pushed" if it has a base, "law", under the other
    law of sliding, if it has one, and "mujoco", a quarter as many, in MuJoCo's own step of the file, where that is
    another. ``tell``: with the process's ``info``, which may take as long as the steps.
    """
    harder: dict[str, Model] = {"draws": model, "late": Disturbed(model, late=LATE, seed=seed)}
    inner = model.model if isinstance(model, Wraps) else model
    if isinstance(inner, ComplementarityModel) and (base := _loose(inner.scene)):
        every = max(1, round(EVERY * mdp.repeat / mdp.dt))
        harder["pushed"] = Disturbed(model, push=PUSH, every=every, base=base, seed=seed)
    sliding = model if isinstance(model, HasLawOfSliding) else inner
    if isinstance(sliding, HasLawOfSliding) and (other := sliding.under_other_law()) is not None:
        harder["law"] = other
    if isinstance(inner, ComplementarityModel) and (theirs := inner.in_steps_of_file()) is not None:
        harder["mujoco"] = theirs
    tables = dict.fromkeys(harder, Disturbance(parameters=parameter_sets(model, 0.0, seed=seed)))
    if isinstance(inner, ComplementarityModel) and inner.candidates is None:
        harder["parameters"] = model
        tables["parameters"] = Disturbance(parameters=parameter_sets(model, SPREAD, seed=seed))
    count = {name: -(-episodes // _SLOW) if name == "mujoco" else episodes for name in harder}
    return {
        name: evaluate_model(policy, mdp, one, count[name], seed, tables[name], tell) for name, one in harder.items()
    }


def of_draws(
    policy: Actor,
    mdp: MDP,
    model: Model,
    episodes: int = EPISODES,
    seed: int = 0,
    parameters: np.ndarray | None = None,
) -> Evaluation:
    """The first of the trials alone; ``parameters``: sets in place of the model's draws."""
    drawn = parameter_sets(model, 0.0, seed=seed) if parameters is None else parameters
    return evaluate_model(policy, mdp, model, episodes, seed, Disturbance(parameters=drawn), tell=False)


def without_action(mdp: MDP, model: Model, episodes: int = EPISODES, seed: int = 0) -> Evaluation:
    """The same for actions of 0: what a policy has to beat that learned something."""
    return of_draws(lambda o: o.new_zeros(len(o), mdp.actions), mdp, model, episodes, seed)


def failed(found: Mapping[str, Evaluation], idle: Evaluation | None = None) -> dict[str, float]:
    """Share of failed episodes by trial.

    An episode fails that the task ends, or that earns less than half of what is usual under the draws alone; of rewards
    that are costs, less than half of what is usual beyond what no action earns (``idle``): a goal that is twice as far
    costs twice as much on the way. But none fails for a poor start: one that earns half of what is usual beyond no
    action from the same start. ``idle`` tells that where it has as many episodes.
    """
    draws = found["draws"].returns
    usual = float(np.median(draws))
    gained = 0.0 if idle is None else usual - float(idle.returns.mean())
    least = usual - 0.5 * max(abs(usual), gained)

    def fails(e: Evaluation) -> np.ndarray:
        short: np.ndarray = e.returns < least
        if idle is not None and len(idle.returns) == len(draws) == len(e.returns):
            half = 0.5 * float(np.median(draws - idle.returns))
            short = short & ((half <= 0.0) | (e.returns - idle.returns < half))
        return e.terminated | short

    return {name: float(fails(e).mean()) for name, e in found.items()}


def will_fail(shares: Mapping[str, float]) -> bool:
    """Whether shares of failed trials say that a policy fails in the robot: by the draws alone.

    Other trials tell how much it stands; that it falls there does not mean that it falls in the robot.
    """
    return shares["draws"] >= THRESHOLD


def stands(shares: Mapping[str, float]) -> bool:
    """Whether a policy passes under the draws, and under other laws if the model has any: of sliding, and MuJoCo's."""
    return max(shares.get(name, 0.0) for name in LAWS) < LEANS


def foretold(shares: Mapping[str, float], fitted: bool = True, loop: bool = False) -> str:
    """What shares of failed trials say of a policy that was trained on a fit, or else on the file itself.

    ``loop``: it made that fit itself, from a log of its own, and takes no policy to begin with.

    >>> foretold({"draws": 0.0, "late": 0.25, "pushed": 0.125})
    'in the model alone 0 % of episodes fail; 25 % with commands a step later than in the fit, 12 % with pushes'
    """
    words = _WORDS | ({"late": "commands a step later than in the fit"} if fitted else {})
    harder = [f"{100 * shares[name]:.0f} % with {words[name]}" for name in words if name in shares]
    told = f"in the model alone {100 * shares['draws']:.0f} % of episodes fail; {', '.join(harder)}"
    if will_fail(shares):
        remedy = "train longer (--iterations) or from another --seed"
        if loop:
            remedy = f"train longer (--iterations), {_MORE}"
        elif fitted:
            remedy += ", begin with a policy of the file (--start), or fit another log (cmbrl excite)"
        return f"{told}: it will probably fail in the robot, {remedy}"
    if shares["draws"] >= LEANS:
        start = ", or from a policy of the file (--start)" if fitted else ""
        remedy = f"train longer, {_MORE}" if loop else f"train longer, from another --seed{start}"
        return f"{told}: it may fail in the robot, {remedy}"
    if shares.get("law", 0.0) >= LEANS:
        remedy = "train longer, from another --seed, or with --set other_law=0.5 if its share was less"
        return f"{told}: it leans on the model's law of sliding and may fail in the robot, {remedy}"
    if shares.get("mujoco", 0.0) >= LEANS:
        remedy = "train with --set other=file, from another --seed, or on a task of more substeps"
        return f"{told}: it leans on how the model steps through contacts and may fail in the robot, {remedy}"
    if not fitted and max(shares.get("late", 0.0), shares.get("parameters", 0.0)) >= LEANS:
        remedy = "fit a log of the robot (cmbrl record, cmbrl fit) and train on that (--model FIT)"
        return f"{told}: it may fail in a robot that is not quite its file, {remedy}"
    if fitted and shares.get("late", 0.0) >= LEANS:
        return f"{told} (the late ones are no forecast: the fit's draws have all lateness that its log leaves open)"
    return told


def unlearned(earned: Mapping[str, float], slopes: bool = True) -> str:
    """What mean returns in the model of the "policy", and of "no action", say; empty where the policy earns far more.

    A machine that hangs or stands where it began earns a little more or less than no action. ``slopes``: whether the
    reward has a derivative, without which no length of training helps.

    >>> unlearned({"policy": -53.1, "no action": -41.0})[:79]
    'it earns -53.1 in the model, and no action at all -41: it has learned nothing, '
    >>> unlearned({"policy": -598.0, "no action": -600.5})[:95]
    'it earns -598 in the model, and no action at all -600.5: unless to rest is the task, it has lea'
    """
    if not earned or earned["policy"] - earned["no action"] > HARDLY * abs(earned["no action"]):
        return ""
    both = f"it earns {earned['policy']:.4g} in the model, and no action at all {earned['no action']:.4g}"
    if not slopes:
        return f"{both}: it has learned nothing, since the reward has no derivative: {SMOOTHER}"
    nothing = "it has learned nothing, train longer (--iterations)"
    if earned["no action"] - earned["policy"] <= HARDLY * abs(earned["no action"]):
        return (
            f"{both}: unless to rest is the task, {nothing}; a machine that stays at its start needs a reward that "
            "grows all the way from there, by more than its actions cost"
        )
    return f"{both}: {nothing} or with gentler actions (MDP.act)"


def quits(draws: Evaluation, mdp: MDP) -> str:
    """What it says of a task that most episodes of its policy end early and cost something; empty where they do not.

    >>> ended = Evaluation(np.array([-40.0, -60.0]), np.array([50, 50]), np.array([True, True]))
    >>> quits(ended, MDP(**dict.fromkeys(MDP.__annotations__)))[:72]
    'steps earn -1 in the mean, so that an episode costs less the sooner it e'
    """
    cost = float(draws.returns.sum() / draws.lengths.sum())
    if mdp.shaping is not None or cost >= 0 or draws.terminated.mean() < THRESHOLD:
        return ""
    return (
        f"steps earn {cost:.3g} in the mean, so that an episode costs less the sooner it ends: give every step a "
        "constant in training (MDP.shaping)"
    )


class Disturbed:
    """``model`` whose control arrives ``late`` steps late, and whose ``base`` is pushed every so many steps.

    Until a control arrives the first one acts, as a servo holds its first target. ``base``: places in v that a push of
    ``push`` [m/s] in a random direction changes. For episodes that all begin with the first step; not for training.
    """

    def __init__(
        self,
        model: Model,
        late: int = 0,
        push: float = 0.0,
        every: int = 1,
        base: tuple[int, ...] = (),
        seed: int = 0,
    ) -> None:
        self.model, self.name, self.push, self.every, self.base = model, model.name, push, every, list(base)
        self._late, self._steps, self._held = late, 0, deque[Tensor]()
        self._generator = torch.Generator().manual_seed(seed)

    @property
    def dt(self) -> float:
        """Control step [s]."""
        return self.model.dt

    def step(self, q: Tensor, v: Tensor, u: Tensor, *theta: Tensor) -> tuple[Tensor, Tensor]:
        """(q', v') under an earlier control."""
        if not self._steps:
            self._held.extend([u] * self._late)
        self._held.append(u)
        q_next, v_next = self.model.step(q, v, self._held.popleft(), *theta)
        self._steps += 1
        if self.base and self._steps % self.every == 0:
            aim = torch.randn(len(v), len(self.base), generator=self._generator, dtype=v.dtype)
            v_next = v_next.index_add(1, torch.tensor(self.base), self.push * aim / aim.norm(dim=1, keepdim=True))
        return q_next, v_next


def _loose(scene: Scene) -> tuple[int, ...]:
    """Places in v of the horizontal directions in which a root moves without a motor."""
    core = scene.core
    down = scene.gravity @ core.plane_basis if scene.planar else scene.gravity
    driven = _driven(scene)
    return tuple(
        joint.vadr
        for joint in scene.joints
        if joint.kind == JointKind.SLIDE
        and core.body_parent[joint.body] < 0
        and joint.vadr not in driven
        and abs(float(joint.axis @ down)) <= 1e-6 * float(np.linalg.norm(down))
    )


def _driven(scene: Scene) -> set[int]:
    """Places in v that an actuator moves, by its joint or by its tendon."""
    core, found = scene.core, set[int]()
    for line in core.act_line.tolist():
        if line >= scene.nv:
            start, end = core.tendon_ptr[line - scene.nv : line - scene.nv + 2]
            found |= set(core.tendon_dof[start:end].tolist())
        elif line >= 0:
            found.add(line)
    return found
