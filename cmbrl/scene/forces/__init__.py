"""What acts besides contact: actuators, springs, tendons, ties between joints and bodies, and fluids."""
