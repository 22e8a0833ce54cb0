"""The algorithms by name: where each lies and what it trains on. A new one is one file and one line here.

A trainer is called as ``Trainer(mdp, model, config, seed=...)``. ``model`` is what ``--model`` names: a next-state
model, an ensemble that nothing has been learned from yet ("ensemble"), or the function that makes the task's real
system ("real", :data:`cmbrl.envs.system.SystemFactory`). What an algorithm needs beside that it lists in ``takes`` and
gets by keyword:

- ``system``: the function that makes the task's real system, for one that collects transitions as it goes; None when
  it shall learn from a log alone (``--offline``)
- ``data``: the log of ``--data`` (:class:`cmbrl.Transitions`), or None where none was given
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from inspect import ismethod
from typing import Any

from cmbrl.errors import UserError, did_you_mean

# Kinds of model: a scene's or a fit's; a trained neural one; a neural one that the algorithm trains; the real system.
CONTACT, ENSEMBLE, UNTRAINED, REAL = "contact model", "trained ensemble", "untrained ensemble", "real system"
_ANY = (REAL, CONTACT, ENSEMBLE)


@dataclass(frozen=True)
class Algorithm:
    """``place`` is "module:Trainer:Config"; ``models`` the kinds that it can train on, the usual one first."""

    place: str
    summary: str
    models: tuple[str, ...] = (CONTACT, ENSEMBLE)
    takes: tuple[str, ...] = ()

    def load(self) -> tuple[Any, Any]:
        """The trainer's class and that of its configuration, imported now."""
        module, trainer, config = self.place.split(":")
        found = import_module(module)
        return getattr(found, trainer), getattr(found, config)


ALGORITHMS = {
    "shac": Algorithm("cmbrl.train.shac:SHAC:SHACConfig", "short windows of first-order gradients, valued by a critic"),
    "fopg": Algorithm(
        "cmbrl.train.fopg:FOPG:FOPGConfig",
        "policy gradients of windows or whole episodes: pathwise, score function, AoBG or PIPPS",
    ),
    "loop": Algorithm(
        "cmbrl.train.loop:Loop:LoopConfig",
        "the complementarity-model loop: act, fit, improve by SHAC on draws from the fit, and again",
        (CONTACT,),
        ("system", "data"),
    ),
    "mbpo": Algorithm(
        "cmbrl.train.mbpo:MBPO:MBPOConfig",
        "short rollouts of a neural ensemble, which it fits as it goes, feed a soft actor-critic",
        (UNTRAINED,),
        ("system", "data"),
    ),
    "sac": Algorithm("cmbrl.train.baselines:SAC:SACConfig", "soft actor-critic, model-free", _ANY),
    "ppo": Algorithm("cmbrl.train.baselines:PPO:PPOConfig", "proximal policy optimisation, model-free", _ANY),
    "ars": Algorithm("cmbrl.train.baselines:ARS:ARSConfig", "augmented random search of a linear policy", _ANY),
}


def algorithm(name: str) -> Algorithm:
    """The algorithm called ``name``; raises UserError with the nearest name when there is none."""
    if name not in ALGORITHMS:
        raise UserError(f"unknown algorithm {name!r}: {did_you_mean(name, ALGORITHMS)}")
    return ALGORITHMS[name]


def preset(config: Any, task: str) -> Any:
    """The settings of the dataclass ``config`` for a task: its classmethod of that name, else its defaults."""
    named = getattr(config, task, None)
    return named() if ismethod(named) else config()
