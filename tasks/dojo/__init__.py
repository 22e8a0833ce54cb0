"""The hopper and half-cheetah of the ABS paper: robots of the Dojo simulator, rigid contact, one step of 50 ms.

Dojo's own environments are no longer maintained and need Julia. Masses, lengths, springs and rewards are theirs, the
files are ours. The half-cheetah's springs are treated implicitly, because explicit ones are unstable at 50 ms. The real
system is MuJoCo at 1 ms on the same file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cmbrl.registry import Task
from cmbrl.tasks.zoo import ARS_HOPPER, PPO_HOPPER

# Not tuned for these robots.
TRAINING: dict[str, dict[str, Any]] = {
    "shac": {"environments": 64, "window": 1.6, "discount": 0.995, "noise_linear": 0.03, "noise_angular": 0.1},
    "fopg": {"window": 1.6, "discount": 0.99},
    "mbpo": {"length_end": 15, "target_entropy": -1.0},
    "ppo": PPO_HOPPER,
    "ars": ARS_HOPPER,
}


def _task(robot: str, description: str) -> Task:
    """``robot``: the name of its file, and of its decision process in mdp.py."""
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
        training=TRAINING,
    )


HOPPER = _task("hopper", "Dojo's hopper: one leg, planar, 3 motors, rigid contact at 50 ms; the real system is MuJoCo")
CHEETAH = _task("cheetah", "Dojo's half-cheetah: planar, 6 motors, rigid contact at 50 ms; the real system is MuJoCo")
