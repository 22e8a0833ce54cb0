"""How policies are learned: by which estimator, from how many samples, in how many seconds."""
