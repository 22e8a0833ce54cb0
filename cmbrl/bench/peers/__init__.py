"""Other simulators and solvers, one adapter each, for every study that compares with them."""
