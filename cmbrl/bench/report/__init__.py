"""Runs studies so that a killed run goes on and a failing study stops no other; makes one page of them all."""
