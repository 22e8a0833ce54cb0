"""What columns are: quantities of joints and actuators, in units."""
