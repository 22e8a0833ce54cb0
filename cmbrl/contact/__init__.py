"""The contact problem, its smoothing and its solvers."""

from cmbrl.contact.smoothing import ABS, Barrier, Exact, Gaussian, Relaxed, Smoothing

__all__ = ["ABS", "Barrier", "Exact", "Gaussian", "Relaxed", "Smoothing"]
