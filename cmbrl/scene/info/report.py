"""What a scene has, as text: the output of ``cmbrl info``; ``inventory.py`` has it as JSON types."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cmbrl.scene.info import inventory
from cmbrl.scene.info.columns import counted, folded, listed, on_request, parameter_lines, wrapped
from cmbrl.scene.records import LeftOut
from cmbrl.scene.scene import Scene


def describe(scene: Scene) -> str:
    """Text of ``scene``: one screen for a small robot; long lists are counted by reason."""
    core = scene.core
    gravity = np.array2string(scene.gravity, precision=4, suppress_small=True)
    lines = [
        f"{scene.name}: {scene.path or 'not from a file'}",
        f"  algebra      {'planar' if scene.planar else 'spatial'}: {scene.planar_why}",
        f"  size         nq {scene.nq}, nv {scene.nv}, nu {scene.nu}; "
        f"{counted(core.nbody, 'moving body', 'moving bodies')}, {scene.total_mass:.4g} kg",
        f"  file's step  {scene.timestep:g} s, {scene.integrator}; gravity {gravity} m/s^2",
        "  coordinates  "
        + wrapped(f"{n} ({k})" for n, k in zip(scene.coordinate_names, scene.coordinate_kinds, strict=True)),
        f"  limits       {core.nlimit}"
        + listed(
            f"{name} [{low:.4g}, {high:.4g}]"
            for name, low, high in zip(inventory.limited(scene), core.lim_lo, core.lim_hi, strict=True)
        ),
        *_tendon_and_tie_lines(scene),
        f"  actuators    {scene.nu}" + listed(_actuator_line(scene, k) for k in range(scene.nu)),
        *_joint_force_lines(scene),
        f"  contacts     {counted(core.ncontact, 'candidate')}, law {scene.contact_law}" + _contact_lines(scene),
        f"  parameters   {len(scene.parameters)} that can be fitted; the name is GROUP.OF, e.g. for --set",
        *parameter_lines(scene.parameters),
        *on_request(scene.parameters),
    ]
    if scene.differences:
        lines += ["  unlike MuJoCo", *_by_reason(scene.differences)]
    lines.append(f"  left out     {len(scene.left_out) or 'nothing'}")
    lines += _by_reason(scene.left_out)
    lines += [f"  MuJoCo says  {warning}" for warning in scene.compiler_warnings]
    lines += [f"  of the URDF  {change}" for change in scene.urdf_changes]
    lines += [f"  doubtful     {doubt}" for doubt in inventory.doubts(scene)]
    return "\n".join(line for long in lines for line in folded(long))


def _joint_force_lines(scene: Scene) -> list[str]:
    """Sums of actuators that are clamped, and gravity compensation; nothing where there is none."""
    core, lines = scene.core, []
    if core.nforcerange:
        ranges = (
            f"{scene.coordinate_names[dof]} [{low:g}, {high:g}]"
            for dof, (low, high) in zip(core.frc_dof, core.frc_range, strict=True)
        )
        lines.append(
            f"  joint forces {counted(core.nforcerange, 'sum of actuators is', 'sums of actuators are')} clamped"
            + listed(ranges)
        )
    if core.nellipsoid:
        lines.append(f"  fluid        drags and lifts {counted(core.nellipsoid, 'ellipsoid')}")
    if core.nbox:
        lines.append(f"  fluid        drags {counted(core.nbox, 'box', 'boxes')} with the inertia of a body")
    if core.nlift:
        shares = (f"{name} {share:.4g}" for name, share in zip(scene.body_names, core.body_lift, strict=True) if share)
        lines.append(
            f"  gravcomp     {counted(core.nlift, 'body carries', 'bodies carry')} a share of the weight"
            + listed(shares)
        )
    return lines


def _actuator_line(scene: Scene, k: int) -> str:
    control, force = inventory.bounds(scene.core.act_ctrl[k]), inventory.bounds(scene.core.act_force[k])
    text = scene.actuator_names[k]
    if inventory.driven(scene, k) != text:
        text += f" on {inventory.driven(scene, k)}"
    text += f" ctrl [{control[0]:g}, {control[1]:g}]" if control else ""
    text += f" force [{force[0]:g}, {force[1]:g}]" if force else ""
    state = inventory.activation(scene, k)
    if state is None:
        return text
    time = f" of {state['time_constant']:g} s" if state["dynamics"] != "integrator" else ""
    return f"{text} through a{'n' * (not time)} {state['dynamics']}{time}"


def _tendon_line(scene: Scene, tendon: int) -> str:
    name, path = scene.tendon_names[tendon], inventory.path(scene, tendon)
    if count := int(np.diff(scene.core.seg_ptr)[tendon]):
        around = int(np.count_nonzero(_of_tendon(scene, tendon) >= 0))
        pieces = (
            f"{'' if around else 'straight '}segment{'s' * (count > 1)}{f', {around} around a geom' * bool(around)}"
        )
        return f"{name} = {count} {pieces}, moved by {' '.join(path)}"
    return f"{name} = {' '.join(f'{coef:+.4g} {of}' for of, coef in path.items())}"


def _of_tendon(scene: Scene, tendon: int) -> NDArray[np.int32]:
    """What each segment of a tendon goes around; -1: it is straight."""
    return scene.core.seg_wrap[scene.core.seg_ptr[tendon] : scene.core.seg_ptr[tendon + 1]]


def _tendon_and_tie_lines(scene: Scene) -> list[str]:
    core, lines = scene.core, []
    if count := len(scene.tendon_names):
        lines.append(f"  tendons      {count}" + listed(_tendon_line(scene, k) for k in range(count)))
    if core.ntie:
        ties = (
            f"{name} ({inventory.TIES[core.tie_type[k]]} of {' and '.join(inventory.ends(scene, k))})"
            for k, name in enumerate(scene.tie_names)
        )
        lines.append(f"  equalities   {core.ntie}" + listed(ties))
    return lines


def _contact_lines(scene: Scene) -> str:
    core = scene.core
    kinds = zip(scene.contact_names, core.con_type, core.con_dim, strict=True)
    counts = Counter((name, inventory.TYPES[kind], int(dim)) for name, kind, dim in kinds)
    lines = [f"{count} x {name}, {kind}, condim {dim}" for (name, kind, dim), count in counts.items()]
    if len(lines) > 40:
        lines = [*lines[:40], f"and {len(lines) - 40} more pairs (--json lists all)"]
    if scene.merged_points:
        lines.append(f"merged: {counted(scene.merged_points, 'duplicate point')}")
    dropped = [replace(drop, kind="dropped:") for drop in scene.dropped_contacts]
    return "".join(f"\n    {line}" for line in lines) + "".join(f"\n{line}" for line in _by_reason(dropped))


def _by_reason(elements: Sequence[LeftOut]) -> list[str]:
    """One entry per kind and reason, naming at most three elements."""
    groups: dict[tuple[str, str], list[str]] = {}
    for element in elements:
        groups.setdefault((element.kind, element.why), []).append(element.name)
    return [
        f"    {kind} {', '.join(names[:3])}{f' and {len(names) - 3} more' if len(names) > 3 else ''}: {why}"
        for (kind, why), names in groups.items()
    ]
