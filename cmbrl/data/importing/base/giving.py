"""How far the feet of a robot that stands give in, by the softness of the contacts in its file.

Matter that stands is taken to be at the floor's height. Under a file with rubber feet it is below: those of robots in
MuJoCo Menagerie give in by a centimetre or more. A contact of depth r bears, with MuJoCo's impedance d(r), stiffness K
and inverse weight w,

    f w (1 - d) / d = K d r,

which rises with r. What offsets of poses might be by that is no sign of markers that sit elsewhere.
"""

from __future__ import annotations

import numpy as np

from cmbrl.scene import Scene
from cmbrl.scene.layout import CONTACT_FIELDS

_LEAST = 1e-4  # impedances are clipped to this and 1 minus this, as in MuJoCo
_DEEPEST, _HALVINGS = 0.1, 40  # [m]
_BEARING = 0.5  # of the feet, in a gait: the others are in the air


def giving(scene: Scene, contacts: np.ndarray) -> float:
    """The depth [m] to which the weight of ``scene`` presses the softest of its ``contacts`` (k,) of feet, nominally.

    Half of the bodies that have some bear the weight. 0 without any, or without gravity.
    """
    if not len(contacts):
        return 0.0
    core, layout = scene.core, scene.layout
    bodies = len(np.unique(core.con_bodyA[contacts]))
    weight = scene.total_mass * float(np.linalg.norm(scene.gravity))
    force = weight / max(1.0, _BEARING * bodies)
    places = [layout.contact(int(k)) for k in contacts]
    fields = dict(zip(CONTACT_FIELDS, np.array([core.P[p : p + len(CONTACT_FIELDS)] for p in places]).T, strict=True))
    ends = [np.clip(fields[name], _LEAST, 1.0 - _LEAST) for name in ("d0", "dmax")]
    time, ratio = fields["solref0"], fields["solref1"]
    soft = 1.0 / np.where(time > 0.0, (ends[1] * time * ratio) ** 2, -(ends[1] ** 2) / np.where(time > 0.0, 1.0, time))
    low, high = np.zeros(len(contacts)), np.full(len(contacts), _DEEPEST)
    for _ in range(_HALVINGS):
        depth = 0.5 * (low + high)
        share = np.clip(depth / np.maximum(fields["width"], _LEAST**2), 0.0, 1.0)
        d = ends[0] + (ends[1] - ends[0]) * np.where(share < 0.5, 2.0 * share**2, 1.0 - 2.0 * (1.0 - share) ** 2)
        bears = soft * d * depth >= force * core.con_invweight[contacts] * fields["rscale"] * (1.0 - d) / d
        low, high = np.where(bears, low, depth), np.where(bears, depth, high)
    return float(high.max())
