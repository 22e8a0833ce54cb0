"""The compiled core (``_core``); its user-facing doors are :mod:`cmbrl.models.complementarity` and
:mod:`cmbrl.contact.solvers.native`."""

from cmbrl.native._core import Core, Problems

__all__ = ["Core", "Problems"]
