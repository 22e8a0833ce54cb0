"""What columns tell the controls of actuators in transitions: controls, or targets and torques by the file's laws."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cmbrl.data.drive import law_of
from cmbrl.data.importing.bodies import joints_of
from cmbrl.data.importing.grid import Key
from cmbrl.scene import Scene


def undriven(keys: set[Key], scene: Scene) -> str | None:
    """What to do about the first actuator whose control ``keys`` do not tell; None if they tell all."""
    for a, name in enumerate(scene.actuator_names):
        sources = [key for key, _ in _sources(scene, a)]
        if not any(key in keys for key in sources):
            own = f", or its control by COLUMN={name}.control" if len(sources) > 1 else ""
            joint, quantity = sources[-1]
            if quantity == "command" and (joint, "torque") in keys:  # mapped as the command, it would be a target
                return (
                    f"no column for actuator {name!r}, a servo of the file, and torques of {joint!r}: give --as "
                    f"positions, which drives it by these torques, or map its target by --map COLUMN={joint}.command"
                    f"{own}"
                )
            return f"no column for actuator {name!r}: map one by --map COLUMN={'.'.join(sources[-1])}{own}"
    return None


def controls(episode: Mapping[Key, np.ndarray], scene: Scene) -> np.ndarray:
    """Controls (T, nu): logged as such, or from position targets or torques by gear and gain of the file."""
    u = np.zeros((len(next(iter(episode.values()))), scene.nu))
    for a in range(scene.nu):
        key, factor = next(source for source in _sources(scene, a) if source[0] in episode)
        u[:, a] = episode[key][:, 0] * factor
    return u


def taken(keys: set[Key], scene: Scene) -> set[Key]:
    """Those of ``keys`` that tell the controls."""
    told = ([key for key, _ in _sources(scene, a) if key in keys] for a in range(scene.nu))
    return {found[0] for found in told if found}


def _sources(scene: Scene, a: int) -> list[tuple[Key, float]]:
    """Columns that tell the control of actuator ``a``, each with the factor to it; those that come first count."""
    gear, gain, bias = (float(scene.core.P[scene.layout.actuator(a, field)]) for field in ("gear", "gain", "bias1"))
    sources = [((scene.actuator_names[a], "control"), 1.0)]
    line = int(scene.core.act_line[a])
    for owner in (joint.name for joint in joints_of(scene)[0] if joint.vadr == line):
        kind, scale = law_of(scene, a)
        if kind != "torque":
            sources.append(((owner, "command"), scale))
        elif bias == 0 and gear * gain != 0:
            sources.append(((owner, "torque"), 1 / (gear * gain)))
    return sources
