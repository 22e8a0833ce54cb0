"""Settings of model-free algorithms that were tuned for Gymnasium's robots.

RL Baselines3 Zoo (github.com/DLR-RM/rl-baselines3-zoo, hyperparams/*.yml): PPO for the v4 robots, and ARS for the v3
robots, whose settings are closest to the ARS paper's.
"""

from __future__ import annotations

PPO_HOPPER = {
    "iterations": 1954, "horizon": 512, "epochs": 5, "batch": 32, "rate": 9.80828e-05, "discount": 0.999, "trace": 0.99,
    "clip": 0.2, "entropy": 0.00229519, "value": 0.835671, "gradient": 0.7, "log_std": -2.0, "hidden": (256, 256),
}  # fmt: skip
PPO_CHEETAH = {
    **PPO_HOPPER, "epochs": 20, "batch": 64, "rate": 2.0633e-05, "discount": 0.98, "trace": 0.92, "clip": 0.1,
    "entropy": 0.000401762, "value": 0.58096, "gradient": 0.8,
}  # fmt: skip
ARS_HOPPER = {"rate": 0.01, "deviation": 0.025, "directions": 8, "best": 4, "alive": -1.0}
ARS_CHEETAH = {**ARS_HOPPER, "rate": 0.02, "deviation": 0.03, "directions": 32, "alive": 0.0}
