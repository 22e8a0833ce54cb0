"""What drives a robot while it is recorded: random actions, PD control with noise, or a policy."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.errors import UserError

PolicyFunction = Callable[[np.ndarray], Any]
"""A policy takes the real system's own observation (n_obs,) and returns the control (nu,)."""

Controller = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""A controller takes observation, q (nq,) and v (nv,) and returns the control (nu,) within its range."""


def controller(behaviour: str | PolicyFunction, model: Any, rng: np.random.Generator) -> Controller:
    """The controller that ``behaviour`` names ("random", "pd") or that wraps a policy, for a ``mujoco.MjModel``."""
    low, high = _control_range(model)
    if callable(behaviour):
        return lambda observation, q, v: np.clip(_as_control(behaviour(observation), model.nu), low, high)
    if behaviour == "random":
        return lambda observation, q, v: rng.uniform(low, high)
    if behaviour == "pd":
        return PdNoise(model, rng)
    raise UserError(f"behaviour {behaviour!r} is not known: choose random or pd, or give a policy")


class PdNoise:
    """PD control towards joint targets that jump now and then, plus white noise (our choice of constants).

    Smooth motion near the initial posture, where uniform actions jerk: Hopper-v5 stands about twice as long. Torque
    motors on hinges are assumed: control is torque / gear, so that gains in its unit fit motors of any strength.
    """

    stiffness = 1.0  #: full control at 1 rad from the target [1/rad]
    damping = 0.05  #: twice as much chatters when held over 50 ms on the half-cheetah's light limbs [s/rad]
    noise = 0.1  #: standard deviation of the noise, as a share of full control
    reach = 0.2  #: targets lie this far [rad] around the initial posture, at most
    hold = 10  #: a target is held for so many control steps

    def __init__(self, model: Any, rng: np.random.Generator) -> None:
        joint = model.actuator_trnid[:, 0]
        self._q_address, self._v_address = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        limited = model.jnt_limited[joint].astype(bool)
        joint_low, joint_high = np.where(limited[:, None], model.jnt_range[joint], [-np.inf, np.inf]).T
        start = model.qpos0[self._q_address]
        self._target_low = np.maximum(joint_low, start - self.reach)
        self._target_high = np.minimum(joint_high, start + self.reach)
        self._sign = np.sign(model.actuator_gear[:, 0])
        self._low, self._high = _control_range(model)
        self._rng = rng
        self._steps = 0
        self._target = start

    def __call__(self, observation: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        if self._steps % self.hold == 0:
            self._target = self._rng.uniform(self._target_low, self._target_high)
        self._steps += 1
        pull = self.stiffness * (self._target - q[self._q_address]) - self.damping * v[self._v_address]
        share = self._sign * pull + self.noise * self._rng.standard_normal(len(pull))
        return np.clip(share * np.maximum(np.abs(self._low), np.abs(self._high)), self._low, self._high)


def load_policy(path: str | Path) -> PolicyFunction:
    """A policy saved with TorchScript: float32 observations (1, n_obs) to controls (1, nu), run without gradients.

    TorchScript is loaded because it is a program of its own restricted language, not a Python pickle.
    Raises UserError when the file is missing or is not TorchScript, and when it fails on an observation.
    """
    import torch

    if not Path(path).is_file():
        raise UserError(f"{path}: no such policy file: save one with torch.jit.script(policy).save(FILE)")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # torch's: what follows TorchScript is no program file
            module = torch.jit.load(str(path), map_location="cpu").eval()
    except (RuntimeError, ValueError) as error:
        first = str(error).strip().splitlines()[0] if str(error).strip() else "unknown reason"
        raise UserError(f"{path}: not a TorchScript policy ({first}): save it with torch.jit.script") from None

    def policy(observation: np.ndarray) -> np.ndarray:
        try:
            with torch.no_grad():
                return module(torch.as_tensor(observation, dtype=torch.float32)[None])[0].numpy()
        except RuntimeError as error:
            last = str(error).strip().splitlines()[-1]
            raise UserError(f"{path}: fails on the {len(observation)} observations of this robot ({last})") from None

    return policy


def _control_range(model: Any) -> tuple[np.ndarray, np.ndarray]:
    """Control range (nu,), (nu,); an unlimited actuator is driven within [-1, 1]."""
    limited = model.actuator_ctrllimited.astype(bool)[:, None]
    low, high = np.where(limited, model.actuator_ctrlrange, [-1.0, 1.0]).T
    return low, high


def _as_control(value: Any, nu: int) -> np.ndarray:
    control = np.asarray(value, dtype=np.float64)
    if control.shape != (nu,) or not np.isfinite(control).all():
        raise UserError(f"the policy returned shape {control.shape}, or NaN: {nu} finite numbers are needed")
    return control
