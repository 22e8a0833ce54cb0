"""Ball throws: a disc, the ground and a wall; the real system is pymunk (Chipmunk 2D) with restitution and friction.

Three tasks in one world, each with a goal that can only be reached through contact: "ball_throw" by a bounce off the
ground and one off the wall, "ball_over" by a bounce over the wall, "ball_slide" with a ball that does not bounce.

The real system is continuous in time, so the model takes 10 steps of 1 ms. A semi-implicit step is off by g h^2 / 2 in
position, and its impacts by g h in speed; at h = 10 ms a fit would compensate by wrong gravity and restitution (3 %;
0.5 % at 1 ms). An impact happens anywhere within a control step, during which the ball moves up to 45 mm. Therefore a
transition counts as contact up to a gap of 20 mm.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cmbrl.registry import Task
from cmbrl.tasks.zoo import ARS_HOPPER, PPO_HOPPER


def _training(duration: float) -> dict[str, dict[str, Any]]:
    """Windows of 32 throws, each of ``duration`` [s] and a whole episode; not tuned for throws."""
    return {
        "shac": {"environments": 64, "window": 32 * duration, "discount": 0.995, "noise_linear": 0.03,
                 "noise_angular": 0.1},
        "fopg": {"window": 32 * duration, "discount": 0.99},
        "mbpo": {"length_end": 15, "target_entropy": -1.0},
        "ppo": PPO_HOPPER,
        "ars": ARS_HOPPER,
    }  # fmt: skip


def _task(name: str, description: str, throw: str, duration: float, **world: float) -> Task:
    """``throw``: its name in mdp.py, of ``duration`` [s]; ``world``: changes to real.py's standard."""

    def record(**arguments: Any) -> Any:
        from cmbrl.tasks.ball_throw.real import record

        return record(**arguments, **world, name=name)

    def mdp() -> Any:
        from cmbrl.tasks.ball_throw import mdp

        return mdp.mdp(getattr(mdp, throw))

    def system() -> Any:
        from cmbrl.tasks.ball_throw.real import BallSystem

        return BallSystem(**world)

    return Task(
        name=name,
        description=description,
        scene=Path(__file__).with_name("scene.xml"),
        control_dt=0.01,
        substeps=10,
        time_step=0.001,
        contact_law="rigid",
        smoothing_speed=1e-7,
        contact_gap=0.02,
        behaviours=("random",),
        recorder=record,
        mdp=mdp,
        system=system,
        training=_training(duration),
    )


TASK = _task("ball_throw", "a disc thrown off the ground and the wall back to a goal, with restitution", "BANK", 0.8)
OVER = _task("ball_over", "the same disc thrown over the wall by a bounce: small changes decide", "OVER", 0.8)
SLIDE = _task(
    "ball_slide", "a disc that does not bounce: it slides to a goal before the wall", "SLIDE", 1.0, elasticity=0.0
)
