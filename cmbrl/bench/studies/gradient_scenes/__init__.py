"""Derivatives through contact against closed forms and finite differences, scene by scene."""
