"""Planar walker and cheetah of the DeepMind Control Suite, running; the real systems are MuJoCo on the suite's files.

Nothing of their training is set here: they show what the derived recipe does with robots it was not made for.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from cmbrl.errors import MissingPackage
from cmbrl.registry import Task


def _asset(name: str) -> Path:
    from importlib.util import find_spec

    spec = find_spec("dm_control")  # finds the folder without importing the package, which looks for a display
    if spec is None or spec.origin is None:
        raise MissingPackage("the tasks of the DeepMind Control Suite need its files: pip install 'cmbrl[dm]'")
    return Path(spec.origin).parent / "suite" / name


def _suite_task(name: str, asset: str, frame_skip: int, **settings: Any) -> Task:
    """The task of the file ``asset``, held ``frame_skip`` steps a control; its process is ``NAME()`` of `.mdp`."""

    def scene() -> Path:
        return _asset(asset)

    def mdp() -> Any:
        return getattr(import_module("cmbrl.tasks.dm_suite.mdp"), name.removeprefix("dm_"))(scene())

    def system() -> Any:
        from cmbrl.system import MujocoSystem

        return MujocoSystem(scene(), frame_skip=frame_skip)

    return Task(
        name=name, scene=scene, mdp=mdp, system=system, substeps=frame_skip, sliding="convex",
        contact_gap=1e-3, **settings,
    )  # fmt: skip


WALKER_RUN = _suite_task(
    "dm_walker_run",
    "walker.xml",
    10,
    description="DeepMind Control Suite's walker: two legs, planar, 6 motors; stands up and runs at 8 m/s",
    control_dt=0.025,
    time_step=0.0025,
)
CHEETAH_RUN = _suite_task(
    "dm_cheetah_run",
    "cheetah.xml",
    1,
    description="DeepMind Control Suite's half-cheetah: planar, 6 motors; runs at 10 m/s",
    control_dt=0.01,
    time_step=0.01,
)
