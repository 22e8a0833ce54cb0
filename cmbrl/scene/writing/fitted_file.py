"""The MJCF of a scene with fitted values, for MuJoCo and everything else that reads MJCF.

The scene's file is changed by MuJoCo's MjSpec (``fitted_spec``), then read again as a scene: a parameter is held by the
file if all that it moves in the physical vector comes back. So a kind of parameter that nobody has taught the writer is
listed as missing, never lost in silence.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from cmbrl.errors import UserError
from cmbrl.scene.collision.contact_meaning import meaning, slower
from cmbrl.scene.drives import write_drives
from cmbrl.scene.layout import CONTACT_FIELDS
from cmbrl.scene.records import Array
from cmbrl.scene.scene import Scene
from cmbrl.scene.source.robot_source import quiet
from cmbrl.scene.writing.fitted_spec import FittedSpec

_DIGITS = 3e-5  # relative; MuJoCo writes six digits
_SOFTNESS = "softness_scale"  # the group of its parameters
_MOVED = 0.01  # of the change of a number that may be lost
_MOST_NAMED = 40  # in the comment of the file


@dataclass(frozen=True)
class FittedFile:
    """``text`` of the MJCF, and the names of parameters whose fitted values it does not hold."""

    text: str
    missing: tuple[str, ...]


def fitted_file(scene: Scene, theta: Array, outside: Mapping[str, float] | None = None) -> FittedFile:
    """The file of ``scene`` at parameters ``theta`` (np,).

    ``outside``: fitted values of what is no part of a scene (biases, delay, lag), which no MJCF holds. Raises UserError
    if the scene is not from a file, or MuJoCo cannot write or read it.
    """
    theta = np.asarray(theta, dtype=float)
    text, held = written_and_read(scene, theta)
    missing = [*_missing(scene, theta, held), *(name for name, value in (outside or {}).items() if value)]
    values = dict(zip((p.name for p in scene.parameters), theta.tolist(), strict=True)) | dict(outside or {})
    return FittedFile(_with_comment(text, scene, missing, values), tuple(missing))


def written_and_read(scene: Scene, theta: Array) -> tuple[str, Scene]:
    """The text of the file of ``scene`` at parameters ``theta`` (np,), and what it is read as.

    Raises UserError if the scene is not from a file, or MuJoCo cannot write or read it.
    """
    if not scene.path:
        raise UserError(f"{scene.name} was not read from a file: write its XML to one, and read the scene from there")
    if scene.urdf_changes:
        raise UserError(f"{scene.path}: a URDF takes no fitted values: fit the MJCF that `cmbrl convert` makes of it")
    text = _written(scene, theta)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fitted.xml"
        path.write_text(text, encoding="utf-8")
        return text, Scene.from_mjcf(path, scene.ignore, scene.contact_law, scene.reduce, scene.self_contact)


def _written(scene: Scene, theta: Array) -> str:
    with quiet(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # MuJoCo's on the file, which the scene has told
        try:
            spec = mujoco.MjSpec.from_file(scene.path)
            write_drives(spec, scene.drives, scene.path)
            model = spec.compile()
            softness = _softness(scene, theta)
            radii = {
                p.name.partition(".")[2]: float(value)
                for p, value in zip(scene.parameters, theta, strict=True)
                if p.group == "radius"
            }
            FittedSpec(scene, spec, model, scene.physical_vector(theta), softness, radii).write()
            fix_paths(spec)
            spec.compile()
            return str(spec.to_xml())
        except (ValueError, KeyError, mujoco.FatalError) as error:
            raise UserError(f"{scene.path}: MuJoCo cannot write this file with fitted values ({error})") from None


def fix_paths(spec: mujoco.MjSpec) -> None:
    """Makes the paths of meshes, height fields, skins and textures absolute, since the file moves."""
    here = Path(spec.modelfiledir).resolve()
    folders = {"meshes": spec.meshdir, "hfields": spec.meshdir, "skins": spec.meshdir, "textures": spec.texturedir}
    for kind, folder in folders.items():
        for asset in getattr(spec, kind):
            if asset.file:
                asset.file = str(here / folder / asset.file)
            if kind == "textures":
                asset.cubefiles = [str(here / folder / file) if file else "" for file in asset.cubefiles]
    spec.meshdir = spec.texturedir = ""


def _softness(scene: Scene, theta: Array) -> Array:
    """Factors (ncontact,) on the softness of contacts, without what masses do: MuJoCo derives that from them."""
    alone = scene.parameter_vector()
    own = np.array([p.group == _SOFTNESS for p in scene.parameters], dtype=bool)
    alone[own] = theta[own]
    rows = scene.layout.contacts(np.arange(scene.core.ncontact), "rscale")
    return scene.physical_vector(alone)[rows] / scene.core.P[rows]


def _missing(scene: Scene, theta: Array, held: Scene) -> list[str]:
    """Names of the parameters that ``held``, read from the written file, does not have at ``theta``."""
    nominal, softness = scene.parameter_vector(), _softness(scene, theta)
    wanted = _by_meaning(scene, scene.physical_vector(theta), softness)
    lost = np.abs(wanted - _aligned(held, scene))
    digits = _DIGITS * _sizes(scene, wanted)
    names = []
    for k in np.flatnonzero(theta != nominal):
        without = theta.copy()
        without[k] = nominal[k]
        own = _softness(scene, without) if scene.parameters[k].group == _SOFTNESS else softness
        moved = np.abs(wanted - _by_meaning(scene, scene.physical_vector(without), own))
        if not np.all((lost <= _MOVED * moved + digits) | (moved <= digits)):  # NaN: not there
            names.append(scene.parameters[k].name)
    return [*names, *_other_drag(scene, theta, held)]


def _other_drag(scene: Scene, theta: Array, held: Scene) -> list[str]:
    """Fitted parameters of the fluid, by name, if ``held`` has other boxes: MuJoCo's follow the fitted inertia."""
    shapes = ("box_linear", "box_quadratic")
    if all(np.allclose(getattr(held.core, of), getattr(scene.core, of), rtol=_MOVED, atol=0.0) for of in shapes):
        return []
    fitted = theta != scene.parameter_vector()
    return [p.name for p, moved in zip(scene.parameters, fitted, strict=True) if moved and p.group.startswith("fluid_")]


def _by_meaning(scene: Scene, P: Array, softness: Array) -> Array:
    """The physical vector P, its contacts and limits by what they mean; ``softness`` (ncontact,): of ``_softness``."""
    first, core = scene.layout.contact(0), scene.core
    P = P.copy()
    for k, line in enumerate(core.lim_line.tolist()):  # relative to the file's range
        P[scene.layout.dof(line, "wider")] += 0.5 * (core.lim_hi[k] - core.lim_lo[k])
    starts = np.array([scene.layout.dof(line, "stop_time") for line in core.lim_line.tolist()], dtype=np.int64)
    stops = starts[:, None] + np.arange(3)
    P[stops] = _stop_meaning(core.lim_soft, P[stops])
    for k, actuator in enumerate(core.wide_act.tolist()):  # a gear there is relative to the file's
        arms = core.wide_coef[core.wide_ptr[k] : core.wide_ptr[k + 1]]
        P[scene.layout.actuator(actuator, "gear")] *= np.linalg.norm([*core.wide_local[k], *arms])
    for k, line in enumerate(core.link_line.tolist()):
        arms = core.tendon_coef[core.tendon_ptr[line - scene.nv] : core.tendon_ptr[line - scene.nv + 1]]
        for actuator in np.flatnonzero(core.act_line == line):
            P[scene.layout.actuator(int(actuator), "gear")] *= np.linalg.norm(
                [*core.link_force[k], *core.link_torque[k], *arms]
            )
    blocks = P[first:].reshape(-1, len(CONTACT_FIELDS))
    blocks[:, CONTACT_FIELDS.index("radius")] += core.con_radiusB + core.con_margin  # how far apart they touch
    if scene.contact_law == "mujoco":
        blocks = meaning(blocks, softness)
    else:
        blocks = np.delete(blocks, CONTACT_FIELDS.index("rscale"), axis=1)
    return np.concatenate([P[:first], blocks.ravel()])


def _stop_meaning(soft: Array, factors: Array) -> Array:
    """Stiffness, damping and compliance (n, 3) of limits with solref and solimp ``soft`` (n, 7), by their ``factors``.

    These (n, 3) are on time constant, damping ratio and softness.
    """
    blocks = np.zeros((len(soft), len(CONTACT_FIELDS)))
    pairs = zip(soft[:, :2].tolist(), factors[:, :2].tolist(), strict=True)
    blocks[:, 3:5] = np.array([slower(*ref, *own) for ref, own in pairs]).reshape(-1, 2)
    blocks[:, 5:8] = soft[:, 2:5]
    found: Array = meaning(blocks, factors[:, 2])[:, [3, 4, 6]]
    return found


def _aligned(held: Scene, scene: Scene) -> Array:
    """What ``held`` has, in the order of ``scene``; NaN where it has nothing."""
    numbers = len(CONTACT_FIELDS) - 1  # of a contact, by what they mean
    found = np.full(scene.layout.contact(0) + numbers * scene.core.ncontact, np.nan)
    first = scene.layout.contact(0)
    if held.layout.contact(0) != first or held.planar != scene.planar:
        return found
    own = _by_meaning(held, held.core.P, np.ones(held.core.ncontact))
    found[:first] = own[:first]
    rows: dict[str, list[int]] = {}
    for k, name in enumerate(held.contact_names):
        rows.setdefault(name, []).append(k)
    blocks, target = own[first:].reshape(-1, numbers), found[first:].reshape(-1, numbers)
    counts = {name: scene.contact_names.count(name) for name in set(scene.contact_names)}
    seen: dict[str, int] = {}
    for k, name in enumerate(scene.contact_names):
        if len(rows.get(name, ())) == counts[name]:
            target[k] = blocks[rows[name][seen.get(name, 0)]]
            seen[name] = seen.get(name, 0) + 1
    return found


def _sizes(scene: Scene, wanted: Array) -> Array:
    """What rounding errors are relative to: the number, and for centres and inertias the size of the body."""
    layout, sizes = scene.layout, np.abs(wanted)
    for k in range(scene.core.nbody):
        mass = sizes[layout.mass(k)]
        com, inertia = slice(layout.com(k), layout.inertia(k)), slice(layout.inertia(k), layout.mass(k + 1))
        sizes[inertia] = sizes[inertia].max()
        sizes[com] = sizes[com].max() + np.sqrt(sizes[inertia].max() / mass if mass else 0.0)
    return sizes


def _with_comment(text: str, scene: Scene, missing: Sequence[str], values: Mapping[str, float]) -> str:
    lines = [
        f"{Path(scene.path).name} with fitted values, written by cmbrl fit. Paths of meshes are absolute.",
        f"Fitted under the contact law {scene.contact_law}; time step and integrator are the file's, not the fit's.",
    ]
    if missing:
        lines.append("Fitted, but not in this file, because an MJCF has no place for it:")
        lines += [f"  {name} = {values[name]:.6g}" for name in missing[:_MOST_NAMED]]
    if len(missing) > _MOST_NAMED:
        lines.append(f"  and {len(missing) - _MOST_NAMED} more, in fit.json")
    body = "\n".join(lines).replace("--", "- -")
    return f"<!--\n{body}\n-->\n{text}"
