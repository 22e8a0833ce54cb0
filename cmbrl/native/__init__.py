"""The compiled core. Use it through :mod:`cmbrl.models.complementarity` and :mod:`cmbrl.contact.solvers.native`."""

from __future__ import annotations

from enum import IntEnum
from pathlib import Path

from cmbrl.errors import UserError

try:
    from cmbrl.native._core import Core, NetWeights, Problems, Tape, followed, kept_buffers
except ModuleNotFoundError as error:  # Python has found the sources first, as it does in their folder
    if error.name != "cmbrl.native._core":
        raise
    here = Path(__file__).parents[2]
    raise UserError(
        f"the core of cmbrl is not built in {here}: after `pip install .`, run Python in another folder; to work in "
        "this one, run scripts/setup.sh and then `source .venv/bin/activate`"
    ) from None

__all__ = ["Core", "NetWeights", "Problems", "SolverStatus", "Tape", "followed", "kept_buffers"]


class SolverStatus(IntEnum):
    """How a contact solve of the core ended."""

    CONVERGED = 0
    FALLBACK = 1  # converged with added compliance
    FAILED = 2
