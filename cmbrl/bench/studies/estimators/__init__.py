"""Which estimator of the policy gradient learns on a scene that is known."""
