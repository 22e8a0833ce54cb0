"""Contact laws by name: ``mujoco``, ``rigid``, ``spring-damper``, ``logistic`` or ``logistic:stiffness=50``."""

from __future__ import annotations

from dataclasses import dataclass

from cmbrl.errors import UserError
from cmbrl.numbers import one_of
from cmbrl.text import parse_kind, parse_number

CONTACT_LAWS = {"rigid": 0, "mujoco": 1, "spring-damper": 2, "logistic": 3}  # the core's number of each law
STIFFNESS = 300.0  # 1/m, the one at which Bundled Contact Gradients were published
SOFTEST, STIFFEST = 1.0, 1e5  # 1/m


@dataclass(frozen=True)
class LawChoice:
    """One law for all contacts of a scene; ``stiffness`` [1/m] is the logistic law's."""

    name: str
    stiffness: float = STIFFNESS

    @classmethod
    def parse(cls, text: str) -> LawChoice:
        """Raises UserError for an unknown law or option, or a stiffness out of bounds."""
        if not isinstance(text, str):
            raise UserError(f"contact law is a {type(text).__name__}; give one of {', '.join(CONTACT_LAWS)}")
        kind, options = parse_kind(text)
        name = one_of(kind, CONTACT_LAWS, "contact law")
        value = options.pop("stiffness", None) if name == "logistic" else None
        if options:
            raise UserError(f"contact law {text!r}: {name} has no option {next(iter(options))!r}")
        if value is None:
            return cls(name)
        try:
            stiffness = float(parse_number(value))
        except ValueError as error:
            raise UserError(f"contact law {text!r}: stiffness {error}") from None
        if not SOFTEST <= stiffness <= STIFFEST:
            raise UserError(f"contact law {text!r}: give a stiffness from {SOFTEST:g} to {STIFFEST:g} per metre")
        return cls(name, stiffness)

    def __str__(self) -> str:
        return f"{self.name}:stiffness={self.stiffness:g}" if self.name == "logistic" else self.name
