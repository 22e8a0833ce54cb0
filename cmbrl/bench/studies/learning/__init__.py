"""Learned models: held-out error against transitions, fit time and prediction time (`cmbrl bench learning`)."""
