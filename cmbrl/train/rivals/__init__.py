"""Around Stable-Baselines3: what model-free competitors and MBPO share."""
