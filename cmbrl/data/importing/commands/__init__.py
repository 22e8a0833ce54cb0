"""What columns command, and the gains of the servos that follow."""
