"""One draw of a family of the study on a robot: its file-like truth, and the robots that move."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import count

import mujoco

from cmbrl.bench.studies.hidden.families import changed, generator
from cmbrl.bench.studies.hidden.plan import OUTSIDE
from cmbrl.hidden.flaws import Flaws, flawed
from cmbrl.hidden.system import HiddenSystem
from cmbrl.registry import Task, load_task


@dataclass(frozen=True)
class Hidden:
    """One draw of a family on a robot. Robots of it share one compiled model."""

    scene: str
    family: str
    draw: int

    @cached_property
    def task(self) -> Task:
        """Whose file the model starts from."""
        return load_task(self.scene)

    @cached_property
    def file_like(self) -> mujoco.MjModel:
        """The truth as far as a file can say it: the oracle's model."""
        return changed(self.scene, self.task.scene_path, self.family, self.draw)

    @cached_property
    def real(self) -> tuple[mujoco.MjModel, Flaws]:
        """What moves, and its flaws."""
        if self.family != OUTSIDE:
            return self.file_like, Flaws()
        rng = generator(self.scene, OUTSIDE, self.draw, part=1)
        return flawed(self.task.scene_path, self.file_like, self.task.control_dt, rng)

    def systems(self) -> Callable[[], HiddenSystem]:
        """Makes robots, each with noise of its own; every such maker begins with the same one."""
        model, flaws = self.real
        names = [self.file_like.joint(k).name for k in range(self.file_like.njnt)]
        parts = count(2)  # of the draw's random numbers

        def make() -> HiddenSystem:
            rng = generator(self.scene, self.family, self.draw, next(parts))
            return HiddenSystem(model, self.task.control_dt, names, flaws, rng)

        return make
