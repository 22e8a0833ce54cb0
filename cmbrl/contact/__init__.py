"""The contact problem: how softly complementarity is solved."""

from cmbrl.contact.smoothing import Adaptive, Barrier, Exact, Smoothing

__all__ = ["Adaptive", "Barrier", "Exact", "Smoothing"]
