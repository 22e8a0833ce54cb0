"""Measurements of models, solvers, gradients and policies next to their competitors."""
