"""Files of a scene: with fitted values, with joints held, with play behind joints."""
