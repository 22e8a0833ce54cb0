"""The compiled core (``_core``); :mod:`cmbrl.models.complementarity` is its only user-facing door."""

from cmbrl.native._core import Core

__all__ = ["Core"]
