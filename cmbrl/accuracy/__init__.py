"""Errors of models on a log (`cmbrl error`)."""
