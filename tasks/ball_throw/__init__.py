"""Ball throws: a disc, the ground and a wall; the real system is pymunk (Chipmunk 2D) with restitution and friction.

Three tasks of one world, each with a goal that only contact leads to: "ball_throw" by a bounce off the ground and one
off the wall, "ball_over" by a bounce over the wall, "ball_slide" with a ball that does not bounce.

The real system is continuous, so the model takes 10 steps of 1 ms: a semi-implicit step is off by g h^2 / 2 in position
and its impacts by g h in speed, for which a fit at h = 10 ms would blame gravity and restitution (3 %; 0.5 % here).
An impact changes the velocity anywhere within a control step, during which the ball moves up to 45 mm: that is why a
transition counts as contact up to a gap of 20 mm.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cmbrl.registry import Task


def _task(name: str, description: str, throw: str, **world: float) -> Task:
    """``throw``: its name in mdp.py; ``world``: what differs from the standard one, see real.py."""

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
        smoothing_kappa=1e-8,
        contact_gap=0.02,
        behaviours=("random",),
        recorder=record,
        mdp=mdp,
        system=system,
    )


TASK = _task("ball_throw", "a disc thrown off the ground and the wall back to a goal, with restitution", "BANK")
OVER = _task("ball_over", "the same disc thrown over the wall by a bounce: small changes decide", "OVER")
SLIDE = _task("ball_slide", "a disc that does not bounce: it slides to a goal before the wall", "SLIDE", elasticity=0.0)
