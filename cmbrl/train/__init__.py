"""Policies: one readable file an algorithm."""
