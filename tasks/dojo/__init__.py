"""Hopper and half-cheetah as the ABS paper had them: those of the Dojo simulator, rigid contact, one step of 50 ms.

Dojo's own environments are no longer kept up and need Julia; masses, lengths, springs and rewards are theirs, the files
are ours. The springs of the cheetah would be unstable at 50 ms if they were taken explicitly. MuJoCo at 1 ms on the
same file stands for the real system.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cmbrl.registry import Task


def _task(robot: str, description: str) -> Task:
    """``robot``: the name of its file and of its process in mdp.py."""
    name, scene = f"{robot}_dojo", Path(__file__).with_name(f"{robot}.xml")

    def mdp() -> Any:
        from cmbrl.tasks.dojo import mdp as processes

        return getattr(processes, robot)()

    def system() -> Any:
        from cmbrl.tasks.dojo import real

        return real.system(scene)

    def record(**arguments: Any) -> Any:
        from cmbrl.tasks.dojo import real

        return real.record(name, scene, mdp(), **arguments)

    return Task(
        name=name,
        description=description,
        scene=scene,
        control_dt=0.05,
        substeps=1,
        time_step=0.05,
        contact_law="rigid",
        implicit_springs=True,
        contact_gap=5e-3,
        recorder=record,
        mdp=mdp,
        system=system,
    )


HOPPER = _task("hopper", "Dojo's hopper: one leg, planar, 3 motors, rigid contact at 50 ms; the real system is MuJoCo")
CHEETAH = _task("cheetah", "Dojo's half-cheetah: planar, 6 motors, rigid contact at 50 ms; the real system is MuJoCo")
