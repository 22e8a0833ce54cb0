"""The algorithms by name: where each lies and what it trains on. A new one is one file and one line here.

A trainer is called as ``Trainer(mdp, model, config, seed=...)``. ``model`` is what ``--model`` names: a next-state model,
an ensemble that nothing has been learned from yet ("ensemble"), or the function that makes the task's real system
("real", :data:`cmbrl.envs.system.SystemFactory`). What an algorithm needs beside that it lists in ``takes`` and gets by
keyword:

- ``system``: the function that makes the task's real system, for one that collects transitions as it goes; None when
  it shall learn from a log alone (``--offline``)
- ``data``: the log of ``--data`` (:class:`cmbrl.Transitions`), or None where none was given
- ``scene``: the task's :class:`cmbrl.Scene`
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

from cmbrl.errors import UserError, did_you_mean

CONTACT, ENSEMBLE, REAL = (
    "contact",
    "ensemble",
    "real",
)  #: kinds of model: a scene's or a fit's, neural, the real system


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
    "loop": Algorithm(
        "cmbrl.train.loop:Loop:LoopConfig",
        "the complementarity-model loop: act, fit, improve by SHAC on draws from the fit, and again",
        (CONTACT,),
        ("system", "data"),
    ),
}


def algorithm(name: str) -> Algorithm:
    """The algorithm called ``name``; raises UserError with the nearest name when there is none."""
    if name not in ALGORITHMS:
        raise UserError(f"unknown algorithm {name!r}: {did_you_mean(name, ALGORITHMS)}")
    return ALGORITHMS[name]
