"""Speed of the step and its derivatives against MuJoCo's, in one run on the same visited states."""
