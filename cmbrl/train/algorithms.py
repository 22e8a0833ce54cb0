"""The algorithms by name: where each is defined and what it trains on. A new one is one file and one line here.

A trainer is called as ``Trainer(mdp, model, config, seed=...)`` and is a :class:`cmbrl.train.trainer.Trainer`.
``model`` is what ``--model`` names: a next-state model, an untrained ensemble ("ensemble"), or the function that makes
the task's real system ("real", :data:`cmbrl.system.SystemFactory`). ``config`` comes from
:func:`cmbrl.train.recipe.configure`. An algorithm that needs more lists it in ``takes`` and gets it by keyword:

- ``system``: the function that makes the task's real system, for an algorithm that collects transitions while it
  trains; None if it should learn from a log alone (``--offline``)
- ``data``: the log given by ``--data`` (:class:`cmbrl.Transitions`), or None
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

from cmbrl.errors import UserError, did_you_mean

# Kinds of model: a scene's or a fit's; a fit with a residual; a trained neural one; a neural one that the algorithm
# trains; the real system.
CONTACT, RESIDUAL, ENSEMBLE = "contact model", "contact model with residual", "trained ensemble"
UNTRAINED, REAL = "untrained ensemble", "real system"
_ANY = (REAL, CONTACT, RESIDUAL, ENSEMBLE)


@dataclass(frozen=True)
class Algorithm:
    """``place`` is "module:Trainer:Config"; ``models`` the kinds that it can train on, the default first.

    ``base``: the algorithm that it trains policies by; what a task sets for that one holds here too. ``measures``:
    its windows are shortened where the task's derivatives grow (`cmbrl.train.windows.growth`). ``goes_on``: it can
    begin with another run's policy. ``differentiates``: it follows derivatives of the task's reward.
    """

    place: str
    summary: str
    models: tuple[str, ...] = (CONTACT, RESIDUAL, ENSEMBLE)
    takes: tuple[str, ...] = ()
    base: str | None = None
    measures: bool = False
    goes_on: bool = False
    differentiates: bool = False

    def load(self) -> tuple[Any, Any]:
        """The trainer's class and that of its configuration, imported now."""
        module, trainer, config = self.place.split(":")
        found = import_module(module)
        return getattr(found, trainer), getattr(found, config)


ALGORITHMS = {
    "shac": Algorithm(
        "cmbrl.train.shac:SHAC:SHACConfig",
        "first-order gradients over short windows, whose ends a critic values",
        measures=True,
        goes_on=True,
        differentiates=True,
    ),
    "fopg": Algorithm(
        "cmbrl.train.fopg:FOPG:FOPGConfig",
        "policy gradients of windows or whole episodes: pathwise, score function, AoBG or PIPPS",
        goes_on=True,
        differentiates=True,
    ),
    "loop": Algorithm(
        "cmbrl.train.loop:Loop:LoopConfig",
        "the complementarity-model loop: act, fit, improve by SHAC on draws from the fit, repeat",
        (CONTACT,),
        ("system", "data"),
        base="shac",
        measures=True,
        differentiates=True,
    ),
    "mbpo": Algorithm(
        "cmbrl.train.mbpo:MBPO:MBPOConfig",
        "soft actor-critic on short rollouts of a neural ensemble, which is fitted during training",
        (UNTRAINED,),
        ("system", "data"),
    ),
    "sac": Algorithm("cmbrl.train.sac:SAC:SACConfig", "soft actor-critic, model-free", _ANY),
    "ppo": Algorithm("cmbrl.train.ppo:PPO:PPOConfig", "proximal policy optimisation, model-free", _ANY),
    "ars": Algorithm("cmbrl.train.ars:ARS:ARSConfig", "augmented random search of a linear policy", _ANY),
}


def algorithm(name: str, where: str = "") -> Algorithm:
    """The algorithm called ``name``; raises UserError with the nearest name, led by ``where``, if there is none."""
    if name not in ALGORITHMS:
        raise UserError(f"{where}{': ' if where else ''}unknown algorithm {name!r}: {did_you_mean(name, ALGORITHMS)}")
    return ALGORITHMS[name]
