"""A ball thrown at a goal that only contact leads to: which estimator finds the launch velocity."""
