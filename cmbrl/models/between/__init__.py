"""What lies between a log and the state of a model: encoders, servos, delays and lags."""
