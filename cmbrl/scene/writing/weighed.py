"""A scene whose rows are as soft as MuJoCo's compiler makes them at other masses than the file's.

The core takes for MuJoCo's inverse weights what is exact at the file's masses and close to them elsewhere
(``cmbrl.scene.core.inverse_weights``). A file that is written at other masses has the right ones there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cmbrl.scene.records import Array
from cmbrl.scene.scene import Scene
from cmbrl.scene.writing.fitted_file import written_and_read


def weighed_at(scene: Scene, theta: Array) -> Scene:
    """``scene`` with the inverse weights of parameters ``theta`` (np,), which no parameter changes any more.

    Raises UserError if the scene is not from a file, or MuJoCo cannot write or read it.
    """
    own, held = scene.core, written_and_read(scene, theta)[1]
    of_contact = dict(zip(held.contact_names, held.core.con_invweight.tolist(), strict=True))
    of_file = zip(scene.contact_names, own.con_invweight.tolist(), strict=True)
    core = replace(
        own,
        weight_coef=np.zeros_like(own.weight_coef),
        lim_invweight=held.core.lim_invweight,
        line_invweight=held.core.line_invweight,
        con_invweight=np.array([of_contact.get(name, weight) for name, weight in of_file]),
    )
    return replace(scene, core=core)
