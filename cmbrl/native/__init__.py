"""The compiled core (``_core``); its user-facing doors are :mod:`cmbrl.models.complementarity` and
:mod:`cmbrl.contact.solvers.native`."""

from cmbrl.native._core import Core, solve_problems

__all__ = ["Core", "solve_problems"]
