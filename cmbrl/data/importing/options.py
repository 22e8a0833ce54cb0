"""How logs are to be understood, where their own columns and numbers do not tell."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from cmbrl.data.importing.base import capture as base
from cmbrl.data.importing.build import Frames
from cmbrl.data.importing.commands.gains import Gains
from cmbrl.errors import UserError
from cmbrl.numbers import one_of, real, whole
from cmbrl.scene.info.columns import counted

KINDS = ("transitions", "positions")
_CLOCKS = 1e12  # s: more than any two are apart


@dataclass(frozen=True)
class Options:
    """How logs are understood.

    Attributes:
        columns: column -> ``JOINT.QUANTITY:UNIT``, for columns whose names do not tell.
        joints: names of the columns of arrays that have none.
        angles: unit of hinges where neither ``columns`` nor the name of a column tells it.
        rate: [Hz] of the grid, and of files without times; None: as the samples are.
        gap: longest stretch of lost samples that is filled in.
        frames: of the velocities of a floating base.
        kp, kd: gains of the position servos, where the log has none; or by joint, where those that are not named have
            the one under "", else the file's.
        compensated: torques lack what holds the weight of the links, which is added by the file.
        kind: "transitions" or "positions"; None: positions where only these are known, and the robot does not float.
        window: samples from which a velocity is estimated; odd.
        command_offset: [s] by which the clock of commands is later; one number, or one for each log. Empty: none.
        base: files with the pose of the floating base, one for each log, with a clock of their own.
        base_offset: [s] by which that clock is later; None: found in the motion.
        quaternion: "wxyz" or "xyzw", the order in arrays of quaternions.
        markers: (6,) place [m] and rotation vector [degrees] in the base of what the poses are of; None: found by what
            stands on the floor, where poses are of a capture.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    joints: tuple[str, ...] = ()
    angles: str = "rad"
    rate: float | None = None
    gap: int = 10
    frames: Frames = field(default_factory=Frames)
    kp: Gains = None
    kd: Gains = None
    compensated: bool = False
    kind: str | None = None
    window: int = 5
    command_offset: tuple[float, ...] = ()
    base: tuple[str | os.PathLike[str], ...] = ()
    base_offset: float | None = None
    quaternion: str | None = None
    markers: tuple[float, ...] | None = None

    def check(self) -> None:
        """Raises UserError for a value that means nothing."""
        whole(self.gap, "gap")
        if whole(self.window, "velocity window", least=3) % 2 == 0:
            raise UserError(f"velocity window = {self.window}: give an odd number, so that it has a middle")
        if self.rate is not None:
            real(self.rate, "rate", above=0)
        one_of(self.angles, ("rad", "deg", "rev", "mrad"), "unit of angles")
        if self.kind is not None:
            one_of(self.kind, KINDS, "kind of log")
        if self.quaternion is not None:
            one_of(self.quaternion, base.ORDERS, "order of quaternions")
        if self.markers is not None:
            _check_markers(self.markers)
        if self.base_offset is not None:
            real(self.base_offset, "base offset", least=-_CLOCKS, most=_CLOCKS)
        for offset in self.command_offset:
            real(offset, "command offset", least=-_CLOCKS, most=_CLOCKS)

    def command_offsets(self, logs: int) -> tuple[float, ...]:
        """One for each of ``logs``; raises UserError where their number is another one."""
        given = self.command_offset or (0.0,)
        if len(given) not in (1, logs):
            raise UserError(
                f"{len(given)} command offsets for {counted(logs, 'log')}: give one for each log, or one for all"
            )
        return given if len(given) == logs else given * logs


def _check_markers(given: Sequence[float]) -> None:
    if len(given) != 6:
        raise UserError(f"markers = {given}: give X Y Z in m and RX RY RZ in degrees")
    for value in given:
        real(value, "markers", least=-360, most=360)
