"""Controllers for recording: random actions, PD control with noise, or a policy."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.errors import UserError
from cmbrl.numbers import real_array

LAST_ACTIONS = "last_actions"  #: in a TorchScript file: how many of its actions a policy observes
PolicyFunction = Callable[[np.ndarray], Any]
"""Maps the real system's observation (n_obs,) to the control (nu,)."""

Controller = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Maps observation, q (nq,) and v (nv,) to the control (nu,), within its range."""


def controller(behaviour: str | PolicyFunction, model: Any, rng: np.random.Generator) -> Controller:
    """The controller of a ``mujoco.MjModel``: "random", "pd", or a policy that observes none of its last actions."""
    if last_actions_of(behaviour):
        raise UserError("the policy observes its last actions, and this recorder tells none: use --set last_actions=0")
    low, high = _control_range(model)
    if callable(behaviour):
        return lambda observation, q, v: np.clip(_as_control(behaviour(observation), model.nu), low, high)
    if behaviour == "random":
        return lambda observation, q, v: rng.uniform(low, high)
    if behaviour == "pd":
        return PdNoise(model, rng)
    raise UserError(f"unknown behaviour {behaviour!r}; give random, pd or a policy")


class PdNoise:
    """PD control towards joint targets that change from time to time, plus white noise. The constants are our choice.

    Motion is smoother than under uniform actions and stays near the initial posture: Hopper-v5 stands about twice as
    long. It assumes torque motors on hinges; control is torque / gear, so the gains suit motors of any strength.
    """

    stiffness = 1.0  #: full control at 1 rad from the target [1/rad]
    damping = 0.05  #: twice as much chatters on the half-cheetah's light limbs at 50 ms [s/rad]
    noise = 0.1  #: standard deviation of the noise, as a share of full control
    reach = 0.2  #: largest distance of targets from the initial posture [rad]
    hold = 10  #: control steps per target

    def __init__(self, model: Any, rng: np.random.Generator) -> None:
        joint = model.actuator_trnid[:, 0]
        self._q_address, self._v_address = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        limited = model.jnt_limited[joint].astype(bool)
        joint_low, joint_high = np.where(limited[:, None], model.jnt_range[joint], [-np.inf, np.inf]).T
        start = np.clip(model.qpos0[self._q_address], joint_low, joint_high)  # a file may start beyond its own limits
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


@dataclass(frozen=True)
class ScriptedPolicy:
    """A TorchScript policy of the file ``path``, run without gradients.

    ``last_actions``: with how many of its last actions observations have to end, the newest first.
    """

    path: str
    module: Any
    last_actions: int = 0

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """The control (nu,) at an observation (n_obs,). Raises UserError if the policy fails on it."""
        import torch

        try:
            with torch.no_grad():
                found: np.ndarray = self.module(torch.as_tensor(observation, dtype=torch.float32)[None])[0].numpy()
                return found
        except RuntimeError as error:
            last = str(error).strip().splitlines()[-1]
            raise UserError(
                f"{self.path}: the policy fails on {len(observation)} observations ({last}); is it of another robot?"
            ) from None


def load_policy(path: str | Path) -> ScriptedPolicy:
    """A TorchScript policy: float32 observations (1, n_obs) to controls (1, nu).

    TorchScript is a restricted language, so unlike a pickle it can be loaded safely. Raises UserError if the file is
    missing or not TorchScript.
    """
    import torch

    if not Path(path).is_file():
        raise UserError(f"{path}: no such policy file; save one with torch.jit.script(policy).save(FILE)")
    told = {LAST_ACTIONS: b""}  # a file by others says nothing
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # torch deprecates TorchScript
            module = torch.jit.load(str(path), map_location="cpu", _extra_files=told).eval()
        count = int(told[LAST_ACTIONS] or b"0")
    except (RuntimeError, ValueError) as error:
        first = str(error).strip().splitlines()[0] if str(error).strip() else "unknown reason"
        raise UserError(f"{path}: not a TorchScript policy ({first}); save it with torch.jit.script") from None
    return ScriptedPolicy(str(path), module, count)


def last_actions_of(behaviour: object) -> int:
    """With how many of its last actions a behaviour's observations have to end."""
    return behaviour.last_actions if isinstance(behaviour, ScriptedPolicy) else 0


def _control_range(model: Any) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (nu,), (nu,) of the control; [-1, 1] for unlimited actuators."""
    limited = model.actuator_ctrllimited.astype(bool)[:, None]
    low, high = np.where(limited, model.actuator_ctrlrange, [-1.0, 1.0]).T
    return low, high


def _as_control(value: Any, nu: int) -> np.ndarray:
    control = real_array(value, "the policy's control")
    if control.shape != (nu,) or not np.isfinite(control).all():
        raise UserError(f"the policy returned shape {control.shape} or NaN; it must return {nu} finite numbers")
    return control
