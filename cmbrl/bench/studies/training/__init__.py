"""What an update of a policy costs, next to MuJoCo simulating as many control steps."""
