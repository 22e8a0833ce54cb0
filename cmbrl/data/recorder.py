"""Records raw states and controls from a Gymnasium MuJoCo environment."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from cmbrl.data.behaviour import PolicyFunction, controller
from cmbrl.data.transitions import Transitions
from cmbrl.errors import UserError
from cmbrl.scene.source.mjcf import control_names

Progress = Callable[[int], object]
"""Called with the number of transitions recorded since the last call (``tqdm.update`` fits)."""


def gymnasium_asset(name: str) -> Path:
    """Path of an MJCF that Gymnasium ships, found without importing it. Raises UserError if it is missing."""
    spec = find_spec("gymnasium")
    if spec is None or not spec.submodule_search_locations:
        raise UserError(f"gymnasium, which ships {name}, is not installed: pip install 'cmbrl[tasks]'")
    path = Path(spec.submodule_search_locations[0]) / "envs" / "mujoco" / "assets" / name
    if not path.is_file():
        raise UserError(f"{path}: not in this version of gymnasium: pip install 'gymnasium[mujoco]>=1.0'")
    return path


def record_gymnasium(
    environment: str,
    n_steps: int,
    seed: int = 0,
    behaviour: str | PolicyFunction = "random",
    progress: Progress | None = None,
    episode_steps: int = 1000,
    options: Mapping[str, Any] | None = None,
) -> Transitions:
    """Records ``n_steps`` transitions of a Gymnasium MuJoCo environment; every reset starts a new episode.

    States are MuJoCo's ``qpos`` and ``qvel`` (observations omit x and clip velocities). ``u`` is the ``ctrl`` that
    acted during the whole control step. Quaternions have unit length, which Gymnasium's resets leave to MuJoCo's first
    step. The same seed gives the same log; a shorter log is the start of a longer one.

    Args:
        environment: Gymnasium id, such as "Hopper-v5".
        n_steps: transitions over all episodes; the last episode is cut.
        seed: of resets and behaviour.
        behaviour: "random" (uniform over the control range), "pd", or a policy.
        progress: called with 1 after each transition.
        episode_steps: longest episode, in control steps.
        options: of the environment, which decide what a policy observes.
    """
    if find_spec("gymnasium") is None:
        raise UserError(f"gymnasium, which simulates {environment}, is not installed: pip install 'cmbrl[tasks]'")
    import gymnasium

    try:
        with without_mujoco_warnings():
            limits: dict[str, Any] = {"disable_env_checker": True, "max_episode_steps": episode_steps}
            env = gymnasium.make(environment, **limits, **(options or {}))
    except gymnasium.error.DependencyNotInstalled as error:
        raise UserError(f"{environment} cannot start ({error}): pip install 'cmbrl[tasks]'") from None
    try:
        return _roll(env, environment, n_steps, seed, behaviour, progress)
    finally:
        env.close()


def _roll(
    env: Any, name: str, n_steps: int, seed: int, behaviour: str | PolicyFunction, progress: Progress | None
) -> Transitions:
    import mujoco

    model, data = env.unwrapped.model, env.unwrapped.data
    # Resets draw from the environment's generator (seeded once below) and behaviours from this one, so that the starts
    # of episodes do not depend on the behaviour.
    control = controller(behaviour, model, np.random.default_rng([seed, 1]))
    q, q_next = np.empty((2, n_steps, model.nq))
    v, v_next = np.empty((2, n_steps, model.nv))
    u = np.empty((n_steps, model.nu))
    episode = np.empty(n_steps, dtype=np.int64)
    observation, _ = env.reset(seed=seed)
    current = 0
    for row in range(n_steps):
        q[row], v[row], episode[row] = data.qpos, data.qvel, current
        mujoco.mj_normalizeQuat(model, q[row])
        observation, _, terminated, truncated, _ = env.step(control(observation, q[row], v[row]))
        q_next[row], v_next[row], u[row] = data.qpos, data.qvel, data.ctrl
        if terminated or truncated:
            observation, _ = env.reset()
            current += 1
        if progress is not None:
            progress(1)
    return Transitions(
        q=q, v=v, u=u, q_next=q_next, v_next=v_next, dt=env.unwrapped.dt, episode=episode,
        joint_names=tuple(model.joint(i).name for i in range(model.njnt)),
        actuator_names=tuple(control_names(model)),
        source={
            "system": name,
            "behaviour": behaviour if isinstance(behaviour, str) else "policy",
            "seed": seed,
            "gymnasium": version("gymnasium"),
            "mujoco": _mujoco_version(),
        },
    )  # fmt: skip


@contextmanager
def without_mujoco_warnings() -> Iterator[None]:
    """Silences MuJoCo's warnings about scenes by others; it would print them and write MUJOCO_LOG.TXT."""
    import mujoco

    handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(handler)


def _mujoco_version() -> str:
    import mujoco

    return mujoco.__version__
