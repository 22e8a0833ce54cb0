"""The contact problem, its smoothing and its solvers."""

from cmbrl.contact.smoothing import Adaptive, Barrier, Exact, Smoothing

__all__ = ["Adaptive", "Barrier", "Exact", "Smoothing"]
