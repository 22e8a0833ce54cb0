"""Gradients through contact: scenes with known derivatives, and what every estimator costs in bias and variance."""
