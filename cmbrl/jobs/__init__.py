"""Many independent computations: each is kept when it is done, on any number of processes or machines."""
