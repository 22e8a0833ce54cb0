"""How a scene is stepped: the settings of a complementarity model, checked, with defaults for those left open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cmbrl.contact import smoothing as smoothing_policies
from cmbrl.contact.smoothing import Exact, Smoothing
from cmbrl.errors import UserError
from cmbrl.models.step_choices import choose_step, usual_integrator
from cmbrl.numbers import one_of, real, switch, whole
from cmbrl.scene import Scene

INTEGRATORS = ("semi-implicit", "leapfrog", "midpoint")  # of one solve a step
RK4 = "rk4"
SLIDING = ("coulomb", "convex")
MANY = 256  # candidates; the core lets rows of more than these in by their names
_OLD = {"damping": "coupled", "sliding": "coulomb", "look_ahead": True}  # of models saved before there was a choice
_POLICIES = ("smoothing", "backward_smoothing")


@dataclass(frozen=True)
class StepSettings:
    """Settings of one step; :class:`cmbrl.ComplementarityModel` tells what each of them means.

    ``given``: ``integrator``, ``damping``, ``sliding``, ``look_ahead`` and ``prune`` as they were asked for, None where
    the choice was left open, so that a model with another setting chooses again.
    """

    substeps: int
    time_step: float
    smoothing: Smoothing
    integrator: str
    backward_smoothing: Smoothing
    implicit_springs: bool
    damping: str
    sliding: str
    look_ahead: bool
    prune: float
    path_tolerance: float
    given: Mapping[str, Any]

    @classmethod
    def of(
        cls,
        scene: Scene,
        *,
        substeps: int,
        time_step: float | None,
        smoothing: Smoothing | None,
        integrator: str | None,
        backward_smoothing: Smoothing | None,
        implicit_springs: bool,
        damping: str | None,
        sliding: str | None,
        look_ahead: bool | None,
        prune: float | None,
        path_tolerance: float,
    ) -> StepSettings:
        """Raises UserError for a setting out of range, and for one that does not go with another or with the scene."""
        given = {
            "integrator": integrator, "damping": damping, "sliding": sliding, "look_ahead": look_ahead, "prune": prune,
        }  # fmt: skip
        substeps = whole(substeps, "substeps")
        time_step = real(scene.timestep if time_step is None else time_step, "time_step", above=0.0, most=1e3)
        asked = usual_integrator(scene) if integrator is None else integrator
        integrator = one_of(asked, (*INTEGRATORS, RK4), "integrator")
        smoothing = _policy(smoothing, Exact())
        backward_smoothing = _policy(backward_smoothing, smoothing)
        implicit_springs = switch(implicit_springs, "implicit_springs")
        sliding = one_of("coulomb" if sliding is None else sliding, SLIDING, "sliding")
        if sliding == "convex" and scene.contact_law != "mujoco":
            raise UserError(f"sliding 'convex' does not go with the contact law {scene.contact_law}: choose 'coulomb'")
        damping, look_ahead = choose_step(scene, damping, look_ahead, sliding, time_step, integrator, implicit_springs)
        many = scene.core.ncontact > MANY
        prune = real((0.3 if many else 3.0) if prune is None else prune, "prune", least=0.0)
        path_tolerance = real(path_tolerance, "path_tolerance", above=0.0, most=1.0)
        return cls(
            substeps, time_step, smoothing, integrator, backward_smoothing, implicit_springs,
            damping, sliding, look_ahead, prune, path_tolerance, given,
        )  # fmt: skip

    def options(self, scene: Scene) -> dict[str, Any]:
        """The core's settings by name; raises UserError for a smoothing out of range."""
        return {
            "h": self.time_step,
            "substeps": self.substeps,
            "leapfrog": int(self.integrator in ("leapfrog", "midpoint")),
            "rk4": int(self.integrator == RK4),
            "midpoint": int(self.integrator == "midpoint"),
            "implicit_springs": int(self.implicit_springs),
            "split": int(self.damping == "split" and self.integrator != RK4),
            "convex": int(self.sliding == "convex"),
            "look_ahead": int(self.look_ahead),
            "forward": self.smoothing.resolve(scene, self.time_step),
            "backward": self.backward_smoothing.resolve(scene, self.time_step),
            "prune": self.prune,
            "tolerance": 1e-9,
            "theta": self.path_tolerance,
            "max_iterations": 40,
            "rest_speed": 3 * 9.81 * self.time_step,
        }

    def arguments(self) -> dict[str, Any]:
        """The arguments of :meth:`of` that give these settings again."""
        return {
            "substeps": self.substeps,
            "time_step": self.time_step,
            "smoothing": self.smoothing,
            "backward_smoothing": self.backward_smoothing,
            "implicit_springs": self.implicit_springs,
            **self.given,
            "path_tolerance": self.path_tolerance,
        }

    def to_config(self) -> dict[str, Any]:
        """The same as JSON types; integrator, law and when rows act as chosen, even where they were left open."""
        chosen = {name: getattr(self, name) for name in ("integrator", "damping", "sliding", "look_ahead")}
        policies = {key: smoothing_policies.to_config(getattr(self, key)) for key in _POLICIES}
        return self.arguments() | chosen | policies


def read_config(config: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a model from those in its ``config``, whose smoothing is JSON; an old one has fewer choices.

    Raises UserError for a smoothing that does not exist.
    """
    read = {key: smoothing_policies.from_config(config[key]) for key in _POLICIES if key in config}
    return {**_OLD, **config, **read}


def _policy(given: Smoothing | None, default: Smoothing) -> Smoothing:
    if given is None:
        return default
    if not isinstance(given, Smoothing):
        raise UserError(f"smoothing is a {type(given).__name__}; give a policy such as Exact() or Barrier(...)")
    return given
