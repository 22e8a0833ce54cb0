"""Policies: their nets and their files."""
