"""The compiled core. Use it through :mod:`cmbrl.models.complementarity` and :mod:`cmbrl.contact.solvers.native`."""

from __future__ import annotations

from enum import IntEnum

from cmbrl.native._core import Core, NetWeights, Problems, Tape, kept_buffers

__all__ = ["Core", "NetWeights", "Problems", "SolverStatus", "Tape", "kept_buffers"]


class SolverStatus(IntEnum):
    """How a contact solve of the core ended."""

    CONVERGED = 0
    FALLBACK = 1  # converged with added compliance
    FAILED = 2
