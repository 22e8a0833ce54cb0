"""Unsupported elements of a file: each is refused by name, or left out and reported when its kind is ignored."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np

from cmbrl.errors import UserError, did_you_mean
from cmbrl.numbers import names
from cmbrl.scene.records import LeftOut
from cmbrl.scene.source.mjcf import iterations, name_of

KINDS = {  # those below "supported" are modelled, and left out only if they are ignored
    "tendon": "polynomials of tendons, armature of those through sites, force ranges of several actuators together, "
    "constraints on sums with one joint twice",
    "equality": "equality constraints of deformable bodies",
    "flex": "deformable bodies",
    "plugin": "engine plugins other than sensors",
    "actuator_dynamics": "muscles, delays and other states of actuators (integrators and filters are supported)",
    "actuator_transmission": "actuators on three axes at once (so3)",
    "actuator_bias": "forces of actuators other than MuJoCo's affine ones, pid and dcmotor without a state",
    "geom_type": "contact with SDFs, planes and height fields that move",
    "geom_pair": "contact of two bodies by shapes that need several points or a stand-in (supported unless ignored)",
    "adhesion": "contact adhesion",
    "integrator": "MuJoCo's discrete integrator",
    "sleep": "bodies that start asleep",
    "missing_mesh": "collision meshes of a URDF that are not there",
    # supported
    "surface_velocity": "surfaces of geoms that move (if ignored, they stand)",
    "friction_anisotropic": "pairs with two different sliding or rolling frictions (if ignored, the first applies)",
    "condim": "torsional and rolling friction (if ignored, condim 4 and 6 are 3)",
    "joint_limit_ball": "limits on ball joints",
    "fluid": "fluid forces: density, viscosity, wind",
    "joint_spring_ball": "springs on ball and free joints",
    "joint_polynomial": "nonlinear springs and dampers (springs of ball and free joints are not supported)",
    "gravcomp": "gravity compensation",
    "joint_force_range": "limits on the total actuator force at a joint",
}


class Gate:
    """Collects the unsupported elements of one file; ``close`` raises unless all of them are ignored."""

    def __init__(self, ignore: str | Iterable[str], file: str = "") -> None:
        words = names(ignore.split(",") if isinstance(ignore, str) else ignore, "ignore")
        self.ignore = tuple(dict.fromkeys(name.strip().replace("-", "_") for name in words if name.strip()))
        for name in self.ignore:
            if name not in KINDS:
                raise UserError(f"--ignore {name}: unknown kind; {did_you_mean(name, KINDS)}")
        self.file = file
        self.left_out: list[LeftOut] = []
        self._refused: dict[str, list[tuple[str, str]]] = {}

    @property
    def reports(self) -> int:
        """How many elements were reported so far."""
        return len(self.left_out) + sum(len(found) for found in self._refused.values())

    def refuse(self, kind: str, name: str, why: str, instead: str = "left out") -> None:
        """Reports an unsupported element. It is left out if ``kind`` is ignored; ``instead`` says what happens then."""
        if kind in self.ignore:
            self.left_out.append(LeftOut(kind, name, f"{why}; {instead} (--ignore {kind})"))
        else:
            self._refused.setdefault(kind, []).append((name, why))

    def drops(self, kind: str, name: str, why: str, instead: str = "left out") -> bool:
        """Whether an element that is supported is to be left out, because its kind is ignored; it is reported then."""
        if kind in self.ignore:
            self.refuse(kind, name, why, instead)
        return kind in self.ignore

    def note(self, kind: str, name: str, why: str) -> None:
        """Reports an element that is left out without changing the motion."""
        self.left_out.append(LeftOut(kind, name, why))

    def close(self) -> None:
        """Raises UserError that names the first refused element, counts the others, and says how to leave them out."""
        if not self._refused:
            return
        kind, elements = next(iter(self._refused.items()))
        name, why = elements[0]
        # One element may be refused for several kinds, such as the dynamics and the bias of an actuator.
        refused = {(each.partition("_")[0], of) for each, found in self._refused.items() for of, _ in found}
        count, remedy = len(refused) - 1, " ".join(f"--ignore {each}" for each in self._refused)
        kinds = list(self._refused)
        more = f" (nor is its {' nor its '.join(kinds[1:])})" if kinds[1:] else ""
        if count:
            more = f" (and {count} more element{'s' if count > 1 else ''} of kind {', '.join(kinds)})"
        raise UserError(
            f"{self.file}: {kind} {name!r} is not supported: {why}{more}; remove it from the file or pass {remedy}"
        )


def check_model(model: mujoco.MjModel, gate: Gate) -> None:
    """Reports every unsupported element to the gate, apart from tendons, ties, actuators and contacts."""
    option = model.opt
    for k in range(model.nflex):
        gate.refuse("flex", name_of(model, "flex", k), "a deformable body")
    if acting := model.nplugin - len(_that_sense(model)):
        gate.refuse("plugin", "extension", f"{acting} plugin instance{'s' * (acting > 1)}")
    if "DISCRETE" in mujoco.mjtIntegrator(option.integrator).name:
        gate.refuse("integrator", "option", "integrator discrete", "replaced by semi-implicit Euler")
    if (exact := getattr(mujoco.mjtEnableBit, "mjENBL_DIAGEXACT", None)) and option.enableflags & exact:
        gate.note("diagexact", "option", "softness uses the inverse weights at qpos0")
    if option.noslip_iterations:
        gate.note("noslip", "option", f"MuJoCo's noslip pass, {iterations(option.noslip_iterations)}, is not made")
    for body in np.flatnonzero(model.body_mocapid >= 0):
        gate.note("mocap", name_of(model, "body", int(body)), "it stays where the file places it")
    _check_sleep(model, gate)


def _check_sleep(model: mujoco.MjModel, gate: Gate) -> None:
    """Of recent MuJoCo versions, where the file's flag allows it."""
    flag = getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", None)
    if flag is None or not model.opt.enableflags & flag:
        return
    gate.note("sleep", "option", "nothing falls asleep: what MuJoCo then holds still moves on slowly")
    for tree in np.flatnonzero(model.tree_sleep_policy == mujoco.mjtSleepPolicy.mjSLEEP_INIT):
        gate.refuse("sleep", name_of(model, "body", int(model.tree_bodyadr[tree])), 'sleep="init"', "it starts awake")


def _that_sense(model: mujoco.MjModel) -> set[int]:
    """Plugin instances that nothing but sensors have: they change no motion."""
    others = [model.body_plugin, model.geom_plugin, model.actuator_plugin]
    return {int(k) for k in model.sensor_plugin if k >= 0} - {int(k) for of in others for k in of}
