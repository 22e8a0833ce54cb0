"""Whether there is something to learn by gradients: derivatives of observations and rewards, and actions that matter.

A reward without a slope has no fault that shows: a training runs to its end, and its policy has learned nothing.
"""

from __future__ import annotations

import warnings

import torch
from torch import Tensor

from cmbrl.envs.checked import called, some, started
from cmbrl.envs.checked_rows import moved
from cmbrl.mdp import MDP
from cmbrl.models.between.robots import Robots
from cmbrl.models.native_step.result import SolverWarning
from cmbrl.models.protocol import Model

STARTS, WHILE = 32, 2.5  # episodes by random actions, and for how long [s]: within the memory of a policy's discount
TINY = 1e-6  # of the mean reward: what soft contacts do from afar is less


@torch.enable_grad()
def check_derivative(mdp: MDP, label: str) -> bool:
    """Warns where observations, or the reward of a step, have no derivative in the state that they are taken of.

    Returns whether the reward has one. Raises UserError for functions that cannot be called with states that are
    differentiated.
    """
    q, v = (x.requires_grad_() for x in some(mdp, label))
    if not called(mdp.observe, "observe", label, q, v).requires_grad:
        _warn(
            f"{label}: MDP.observe has no derivative in q, v, which gradients of policies need: write it in torch "
            "without detach, item or comparisons"
        )
    after, before = reward_slopes(mdp, label)
    if after:
        return True
    if before:
        _warn(
            f"{label}: MDP.reward is of the state before the step, which no longer depends on the action: take q', v', "
            "its last two arguments"
        )
    else:
        _warn(
            f"{label}: MDP.reward has no derivative in q', v', which gradients of policies need: write it in torch "
            "without detach, item, comparisons, signs or rounding, as a distance or a speed"
        )
    return False


@torch.enable_grad()
def reward_slopes(mdp: MDP, label: str) -> tuple[bool, bool]:
    """Whether the reward of a step has a derivative that is not 0 in q', v' after it, and in q, v before it.

    It is looked for around starts, too: clamped or rounded it is 0.
    """
    generator = torch.Generator().manual_seed(0)
    before, after = ([x.requires_grad_() for x in moved(mdp, *some(mdp, label), generator)] for _ in range(2))
    reward = called(mdp.reward, "reward", label, *before, before[0].new_zeros(len(before[0]), mdp.actions), *after)
    return _slopes(reward, after), _slopes(reward, before)


def _slopes(reward: Tensor, states: list[Tensor]) -> bool:
    """Whether ``reward`` (B,) has a derivative in ``states`` that is not 0 everywhere."""
    if not reward.requires_grad:
        return False
    found = torch.autograd.grad(reward.sum(), states, retain_graph=True, allow_unused=True)
    return any(bool((g != 0).any()) for g in found if g is not None)


@torch.no_grad()
def check_effect(mdp: MDP, model: Model, label: str) -> None:
    """Warns where random actions change nothing of what steps in ``model`` earn, but for the cost of the actions."""
    q, v = started(mdp, STARTS, label)
    generator = torch.Generator().manual_seed(0)
    still = q.new_zeros(STARTS, mdp.actions)
    random, idle = ((q, v, Robots(model, STARTS)) for _ in range(2))
    steps = max(1, min(mdp.episode_steps, round(WHILE / mdp.dt)))
    for _ in range(steps):
        action = 2 * torch.rand(still.shape, generator=generator, dtype=still.dtype) - 1
        random, gained = _step(mdp, *random, action)
        idle, usual = _step(mdp, *idle, still)
        if ((gained - usual).abs() > TINY * usual.abs().mean()).any():
            return
    _warn(
        f"{label}: no action changes what MDP.reward gives in the first {steps} steps, but for the cost of the action "
        "itself: a policy learns from a reward that grows from the start on with what motors move, as distance shrinks"
    )


def _step(
    mdp: MDP, q: Tensor, v: Tensor, robots: Robots, action: Tensor
) -> tuple[tuple[Tensor, Tensor, Robots], Tensor]:
    """What follows, and the reward (B,) as of no action."""
    q_next, v_next, u = mdp.act(q, v, action)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SolverWarning)  # that of a training tells the same
        for _ in range(mdp.repeat):
            q_next, v_next = mdp.move(robots.step, q_next, v_next, u)
    reward = mdp.reward(q, v, torch.zeros_like(action), q_next, v_next)
    return (q_next, v_next, robots), reward.nan_to_num()


def _warn(text: str) -> None:
    warnings.warn(text, stacklevel=3)
