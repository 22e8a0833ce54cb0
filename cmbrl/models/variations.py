"""The same scene stepped otherwise: at a log's rate, by another integrator, at another step, under another law."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from copy import copy
from pathlib import Path
from typing import Any, Self

import numpy as np

from cmbrl.contact.smoothing import Exact, Smoothing
from cmbrl.data.checks import TIME_STEP_TOLERANCE
from cmbrl.errors import UserError
from cmbrl.models.native_step.stepper import SplitStepper, Stepper
from cmbrl.models.protocol import OtherLaw
from cmbrl.models.step_choices import usual_integrator
from cmbrl.models.step_settings import INTEGRATORS, RK4, StepSettings
from cmbrl.scene import Scene


class Variations(ABC):
    """What a model makes of itself by changing its settings."""

    scene: Scene
    parameters: np.ndarray
    stepper: Stepper
    failures: int
    _settings: StepSettings

    @abstractmethod
    def with_settings(self, **settings: Any) -> Self:
        """The same model with some arguments of the constructor replaced."""

    @abstractmethod
    def to_config(self) -> dict[str, Any]:
        """Its settings and parameters as JSON types."""

    def __repr__(self) -> str:
        own = self._settings
        laws = f"{own.integrator}, {own.sliding}, {own.smoothing}"
        return f"{type(self).__name__}({self.scene!r}, {own.substeps} x {own.time_step:g} s, {laws})"

    def for_log(self, dt: float) -> Self:
        """This model with one control step per transition of ``dt`` [s] of a log.

        A model of one substep (the default) gets as many as ``dt`` takes; the file's time step is shortened where a
        whole number of it does not make ``dt``. Raises UserError if that happens with another time step. A model with
        other substeps is returned as it is.
        """
        own = self._settings
        if own.substeps != 1 or abs(own.time_step - dt) <= TIME_STEP_TOLERANCE * dt:
            return self
        made = self.at(dt)
        if own.time_step not in (self.scene.timestep, made._settings.time_step):
            raise UserError(
                f"the log's dt {dt:g} s is not a whole number of time steps of {own.time_step:g} s "
                f"({self.scene.name}): set another time step (--time-step)"
            )
        return made

    def at(self, dt: float) -> Self:
        """This model with a control step of ``dt`` [s]: in steps of its own, or shorter ones where these do not fit."""
        own = self._settings.time_step
        count = math.ceil(dt / own * (1 - TIME_STEP_TOLERANCE))
        whole = abs(count * own - dt) <= TIME_STEP_TOLERANCE * dt
        return self.with_settings(substeps=count, time_step=own if whole else dt / count)

    @property
    def joins_rows(self) -> bool:
        """Whether it has the file's time step, and no substeps of its own, so that ``for_log`` may choose them."""
        return self._settings.substeps == 1 and self._settings.time_step == self.scene.timestep

    def in_usual_steps(self) -> bool:
        """Whether its time step is the file's, or as much shorter as its control step needs."""
        own = self._settings
        dt = own.substeps * own.time_step
        return own.substeps == math.ceil(dt / self.scene.timestep * (1 - TIME_STEP_TOLERANCE))

    def in_finer_steps(self, share: int) -> Self:
        """The same model with its time step divided by ``share``."""
        own = self._settings
        return self.with_settings(time_step=own.time_step / share, substeps=share * own.substeps)

    def other_steppings(self) -> list[Self]:
        """The same model with each other integrator, and with half the time step."""
        own = self._settings
        others = [self.with_settings(integrator=name) for name in INTEGRATORS if name != own.integrator]
        return [*others, self.in_finer_steps(2)]

    def alternatives(self) -> dict[str, Self]:
        """The same model with other integrators and half or a quarter of the time step, by a name of the change.

        Also with the other contact law, if the scene is read from a file and no parameter has left its nominal value.
        """
        own, found = self._settings, {}
        for integrator in INTEGRATORS:
            for share in (1, 2, 4):
                if (integrator, share) != (own.integrator, 1):
                    step = own.time_step / share
                    name = f"integrator {integrator}, time step {step:.4g} s"
                    substeps = share * own.substeps
                    found[name] = self.with_settings(integrator=integrator, time_step=step, substeps=substeps)
        scene = self.scene
        if Path(scene.path).is_file() and np.array_equal(self.parameters, scene.parameter_vector()):
            law = "rigid" if scene.contact_law == "mujoco" else "mujoco"
            other = Scene.from_mjcf(scene.path, scene.ignore, law, self_contact=scene.self_contact, drives=scene.drives)
            stepped = own.integrator if own.integrator in INTEGRATORS else None  # rk4 is of MuJoCo's law alone
            found[f"contact law {law}"] = self.with_settings(
                scene=other, parameters=None, candidates=None, sliding=None, look_ahead=None, damping=None,
                integrator=stepped,
            )  # fmt: skip
        return found

    def rivals(self) -> dict[str, Self]:
        """The same model under other laws of contact, as far as they are open, by name.

        "mujoco": MuJoCo's own step of the file, with the convex law, rows that act once they are closed, RK4 if the
        file asks for it, and no smoothing. "convex" or "coulomb": the other law of sliding.
        """
        own = self._settings
        found = {}
        if (theirs := self._mujocos_step()) is not None:
            found["mujoco"] = theirs
        if own.given["sliding"] is None and (other := self.under_other_law()) is not None:
            found[other._settings.sliding] = other
        return found

    def _mujocos_step(self) -> Self | None:
        """None where a setting was named that is not MuJoCo's, steps are too long for it, or it is this one.

        An integrator that was named for steps shorter than the file's does not count: those are a task's, for training.
        """
        integrator = RK4 if self.scene.integrator == RK4 else "semi-implicit"
        theirs = {"sliding": "convex", "look_ahead": False, "damping": "split", "integrator": integrator}
        own = self._settings
        named = [name for name, value in theirs.items() if own.given[name] not in (None, value)]
        if named == ["integrator"] and own.time_step < self.scene.timestep * (1.0 - TIME_STEP_TOLERANCE):
            return self.in_steps_of_file()
        if self.scene.contact_law != "mujoco" or own.implicit_springs or named:
            return None
        made = self.with_settings(sliding="convex", integrator=integrator, smoothing=Exact(), backward_smoothing=None)
        return None if made._settings.look_ahead or made.to_config() == self.to_config() else made

    def softens_contacts(self) -> bool:
        """Whether its steps are so long that contacts are softer in them than in the file's.

        MuJoCo keeps their time constants (``solref``) above two steps, and so does a model of its law.
        """
        core, layout = self.scene.core, self.scene.layout
        if self.scene.contact_law != "mujoco" or not core.refsafe:
            return False
        times = core.P[layout.contacts(np.arange(core.ncontact), "solref0")]
        least = 2.0 * max(self._settings.time_step, self.scene.timestep) * (1.0 - TIME_STEP_TOLERANCE)
        return bool(np.any((times > 0) & (np.maximum(times, 2.0 * self.scene.timestep) < least)))

    def in_steps_of_file(self) -> Self | None:
        """This model as MuJoCo would step its file; None if it does, or no whole number of steps makes its own."""
        own, scene = self._settings, self.scene
        dt = own.substeps * own.time_step
        substeps = round(dt / scene.timestep)
        if scene.contact_law != "mujoco" or not scene.core.ncontact or abs(substeps * scene.timestep - dt) > 1e-9:
            return None
        integrator = RK4 if scene.integrator == RK4 else "semi-implicit"
        theirs = self.with_settings(
            sliding="convex", look_ahead=None, damping=None, integrator=integrator, time_step=scene.timestep,
            substeps=substeps, smoothing=Exact(), backward_smoothing=None, implicit_springs=False,
        )  # fmt: skip
        return None if theirs._settings.look_ahead or theirs.to_config() == self.to_config() else theirs

    def for_training(self, smoothing: Smoothing, task: Self) -> Self:
        """This model's laws with ``smoothing``, one contact solve a step, and rows that look ahead where they can.

        A policy needs fast steps, and gradients before something touches; a fit needs the step that the log has. Where
        the steps of the ``task``'s model are shorter, it takes those, and their integrator.
        """
        own, its = self._settings, task._settings
        if own.time_step > its.time_step * (1.0 + TIME_STEP_TOLERANCE):
            steps = {"time_step": its.time_step, "substeps": its.substeps, "integrator": its.integrator}
            return self.with_settings(**steps).for_training(smoothing, task)
        integrator = usual_integrator(self.scene) if own.integrator == RK4 else own.integrator
        usual = self.with_settings(
            integrator=integrator, smoothing=smoothing, backward_smoothing=None,
            sliding="coulomb", look_ahead=None, damping=None,
        )  # fmt: skip
        return usual if own.sliding == "coulomb" else usual.under_other_law() or usual

    def under_other_law(self, law: OtherLaw = "sliding") -> Self | None:
        """The same model under another law, also where its own was named; None if nothing slides.

        "sliding": the other law of sliding. "mujoco": MuJoCo's, with rows that act once they are closed; for a model
        whose rows act so already, as "sliding". "file": MuJoCo's own step of the file, with this model's derivative;
        for a model that takes that step already, or cannot, as "mujoco". "auto": "file" where the model's steps soften
        the file's contacts, else "sliding".
        """
        own = self._settings
        if law == "auto":
            law = "file" if self.softens_contacts() else "sliding"
        if self.scene.contact_law != "mujoco" or not np.any(self.scene.core.con_dim > 1):
            return None
        if law == "file" and (theirs := self.in_steps_of_file()) is not None:
            return theirs.with_settings(backward_smoothing=own.backward_smoothing)
        if law != "sliding" and own.look_ahead:
            return self.with_settings(sliding="convex", look_ahead=False)
        other = "convex" if own.sliding == "coulomb" else "coulomb"
        return self.with_settings(sliding=other, look_ahead=own.look_ahead)

    def under_both_laws(self, share: float, law: OtherLaw = "sliding") -> Self | None:
        """This model with the last ``share`` of the rows of every batch under the other ``law``; None without one.

        It counts its own ``failures``.
        """
        other = self.under_other_law(law)
        if other is None:
            return None
        both = copy(self)
        both.stepper, both.failures = SplitStepper(self.stepper, other.stepper, share), 0
        return both
