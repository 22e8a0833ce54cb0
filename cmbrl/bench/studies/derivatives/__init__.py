"""Derivatives of the step against finite differences of the same softened step."""
