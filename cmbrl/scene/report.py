"""The output of ``cmbrl info``: a scene as JSON types and as text."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmbrl.scene.activation import Dynamics
from cmbrl.scene.records import WORLD, LeftOut, Parameter, TieKind
from cmbrl.scene.scene import Scene

_FEW = 3  # names that are listed again
_WIDTH = 98  # of the text
_TIES = ("connect", "weld", "polynomial")
_TYPES = (
    "point against plane",
    "point against shape",
    "segment against segment",
    "rim against plane",
    "corner against box",
    "hull against hull",
)


def to_dict(scene: Scene) -> dict[str, Any]:
    """Sizes, coordinates, contacts, limits, actuators, parameters and left-out elements as JSON types."""
    core, segments = scene.core, np.diff(scene.core.seg_ptr)
    return {
        "name": scene.name,
        "path": scene.path,
        "ignore": list(scene.ignore),
        "algebra": "planar" if scene.planar else "spatial",
        "algebra_why": scene.planar_why,
        "plane_basis": core.plane_basis.tolist() if scene.planar else None,
        "nq": scene.nq,
        "nv": scene.nv,
        "nu": scene.nu,
        "timestep_s": scene.timestep,
        "integrator": scene.integrator,
        "total_mass_kg": scene.total_mass,
        "gravity_m_s2": scene.gravity.tolist(),
        "bodies": list(scene.body_names),
        "joints": list(scene.joint_names),
        "coordinates": [
            {"name": name, "kind": kind}
            for name, kind in zip(scene.coordinate_names, scene.coordinate_kinds, strict=True)
        ],
        "contact_law": scene.contact_law,
        "contacts": [
            {"pair": name, "type": _TYPES[core.con_type[k]], "condim": int(core.con_dim[k])}
            for k, name in enumerate(scene.contact_names)
        ],
        "contacts_merged": scene.merged_points,
        "contacts_dropped": [{"pair": drop.name, "why": drop.why} for drop in scene.dropped_contacts],
        "limits": [
            {"coordinate": name, "low": float(low), "high": float(high)}
            for name, low, high in zip(_limited(scene), core.lim_lo, core.lim_hi, strict=True)
        ],
        "tendons": [
            {"name": name, "coordinates": _path(scene, k), "segments": int(segments[k])}
            for k, name in enumerate(scene.tendon_names)
        ],
        "equalities": [
            {"name": name, "type": _TIES[core.tie_type[k]], "between": _ends(scene, k)}
            for k, name in enumerate(scene.tie_names)
        ],
        "joint_force_ranges": [
            {"coordinate": scene.coordinate_names[dof], "low": float(low), "high": float(high)}
            for dof, (low, high) in zip(core.frc_dof, core.frc_range, strict=True)
        ],
        "gravity_compensation": [
            {"body": name, "share": float(share)}
            for name, share in zip(scene.body_names, core.body_lift, strict=True)
            if share
        ],
        "boxes_in_fluid": core.nbox,
        "actuators": [
            {
                "name": name,
                "coordinate": _driven(scene, k),
                "control": _bounds(core.act_ctrl[k]),
                "force": _bounds(core.act_force[k]),
                "activation": _activation(scene, k),
            }
            for k, name in enumerate(scene.actuator_names)
        ],
        "parameters": [
            {key: getattr(p, key) for key in ("name", "nominal", "low", "high", "transform", "unit", "default")}
            for p in scene.parameters
        ],
        "compiler_warnings": list(scene.compiler_warnings),
        "differences": [{"kind": x.kind, "name": x.name, "why": x.why} for x in scene.differences],
        "left_out": [{"kind": x.kind, "name": x.name, "why": x.why} for x in scene.left_out],
    }


def describe(scene: Scene) -> str:
    """The same as text: one screen for a small robot; long lists are counted by reason."""
    core = scene.core
    gravity = np.array2string(scene.gravity, precision=4, suppress_small=True)
    lines = [
        f"{scene.name}: {scene.path or 'not from a file'}",
        f"  algebra      {'planar' if scene.planar else 'spatial'}: {scene.planar_why}",
        f"  size         nq {scene.nq}, nv {scene.nv}, nu {scene.nu}; "
        f"{core.nbody} moving bodies, {scene.total_mass:.4g} kg",
        f"  file's step  {scene.timestep:g} s, {scene.integrator}; gravity {gravity} m/s^2",
        "  coordinates  "
        + _wrap(f"{n} ({k})" for n, k in zip(scene.coordinate_names, scene.coordinate_kinds, strict=True)),
        f"  limits       {core.nlimit}"
        + _listed(
            f"{name} [{low:.4g}, {high:.4g}]"
            for name, low, high in zip(_limited(scene), core.lim_lo, core.lim_hi, strict=True)
        ),
        *_tendon_and_tie_lines(scene),
        f"  actuators    {scene.nu}" + _listed(_actuator_line(scene, k) for k in range(scene.nu)),
        *_joint_force_lines(scene),
        f"  contacts     {core.ncontact} candidates, law {scene.contact_law}" + _contact_lines(scene),
        f"  parameters   {len(scene.parameters)} that can be fitted; the name is GROUP.OF, e.g. for --set",
        *_parameter_lines(scene.parameters),
        *_on_request(scene.parameters),
    ]
    if scene.differences:
        lines += ["  unlike MuJoCo", *_by_reason(scene.differences)]
    lines.append(f"  left out     {len(scene.left_out) or 'nothing'}")
    lines += _by_reason(scene.left_out)
    lines += [f"  MuJoCo says  {warning}" for warning in scene.compiler_warnings]
    return "\n".join(line for long in lines for line in _folded(long))


def _bounds(pair: np.ndarray) -> list[float] | None:
    """None if unlimited: JSON has no infinity."""
    return pair.tolist() if np.all(np.isfinite(pair)) else None


def _wrap(words: Iterable[str], indent: int = 15) -> str:
    """``words`` with commas, in lines that stand ``indent`` columns from the left."""
    lines, line = [], ""
    for word in words:
        if line and len(line) + len(word) + 3 > _WIDTH - indent:
            lines.append(line)
            line = ""
        line += (", " if line else "") + word
    return (",\n" + " " * indent).join([*lines, line])


def _folded(text: str) -> list[str]:
    """The lines of ``text``, those that are too long broken between words."""
    return [
        part
        for line in text.splitlines()
        for part in textwrap.wrap(
            line, _WIDTH, subsequent_indent=" " * 15, break_long_words=False, break_on_hyphens=False
        )
        or [line]
    ]


def _parameter_lines(parameters: Sequence[Parameter]) -> list[str]:
    """One entry per group and nominal value, with the widest bounds in it; long lists of names are told once."""
    entries: dict[tuple[str, float, str], list[Parameter]] = {}
    groups = list(dict.fromkeys(p.group for p in parameters))
    for p in sorted(parameters, key=lambda p: groups.index(p.group)):
        entries.setdefault((p.group, p.nominal, p.unit), []).append(p)
    rows = [(("GROUP", "nominal", "bounds", "unit"), ["OF"])]
    several = Counter(group for group, _, _ in entries)
    told: dict[tuple[str, ...], str] = {}
    for (group, nominal, unit), members in entries.items():
        bounds = f"[{min(p.low for p in members):.4g}, {max(p.high for p in members):.4g}]"
        of = [p.name.removeprefix(group).removeprefix(".") or "the scene" for p in members]
        here = f"{group} at {nominal:.5g}" if several[group] > 1 else group
        rows.append(((group, f"{nominal:.5g}", bounds, "" if unit == "1" else unit), _shorter(of, here, told)))
    widths = [max(len(cells[column]) for cells, _ in rows) + 2 for column in range(4)]
    heads = ["    " + "".join(f"{c:{width}s}" for c, width in zip(cells, widths, strict=True)) for cells, _ in rows]
    return [head + _wrap(of, len(head)) for head, (_, of) in zip(heads, rows, strict=True)]


def _shorter(names: list[str], here: str, told: dict[tuple[str, ...], str]) -> list[str]:
    """Names of an entry as they are listed: parts of bodies once for all of them, many that were told by where."""
    parts: dict[str, tuple[str, ...]] = {}
    for name in names:
        body, _, part = name.partition(":")
        parts[body] = (*parts.get(body, ()), part)
    alike = next(iter(parts.values()))
    if len(parts) <= _FEW or any(each != alike for each in parts.values()):
        return names
    before = told.setdefault(tuple(parts), here)
    of = list(parts) if before == here else [f"those of {before}"]
    return [*of, f"each :{', :'.join(alike)}"] if any(alike) else of


def _on_request(parameters: Sequence[Parameter]) -> list[str]:
    groups = dict.fromkeys(p.group for p in parameters if not p.default)
    return [f"    a fit moves {_wrap(groups)} only on request: --groups {next(iter(groups))}"] if groups else []


def _listed(words: Iterable[str]) -> str:
    text = _wrap(words)
    return f"\n{' ' * 15}{text}" if text else ""


def _limited(scene: Scene) -> list[str]:
    """What each limit is on: a coordinate, a tendon, or the angle of a ball joint."""
    names = [scene.line_names[line] for line in scene.core.lim_line]
    balls = scene.core.lim_ball
    return [name.removesuffix(".rz") if ball >= 0 else name for name, ball in zip(names, balls, strict=True)]


def _joint_force_lines(scene: Scene) -> list[str]:
    """Sums of actuators that are clamped, and gravity compensation; nothing where there is none."""
    core, lines = scene.core, []
    if core.nforcerange:
        ranges = (
            f"{scene.coordinate_names[dof]} [{low:g}, {high:g}]"
            for dof, (low, high) in zip(core.frc_dof, core.frc_range, strict=True)
        )
        lines.append(f"  joint forces {core.nforcerange} sums of actuators are clamped" + _listed(ranges))
    if core.nbox:
        lines.append(f"  fluid        drags {core.nbox} boxes that have the bodies' inertia")
    if core.nlift:
        shares = (f"{name} {share:.4g}" for name, share in zip(scene.body_names, core.body_lift, strict=True) if share)
        lines.append(f"  gravcomp     {core.nlift} bodies carry a share of their weight" + _listed(shares))
    return lines


def _driven(scene: Scene, k: int) -> str:
    """What an actuator drives: a coordinate, a tendon, a body at a site, or the coordinates of a joint."""
    core = scene.core
    if core.act_line[k] >= 0:
        return scene.line_names[core.act_line[k]]
    wide = core.wide_act.tolist().index(k)
    if core.wide_body[wide] >= 0:
        return f"body {scene.body_names[core.wide_body[wide]]}"
    dofs = core.wide_dof[core.wide_ptr[wide] : core.wide_ptr[wide + 1]]
    return f"{scene.coordinate_names[dofs[0]]} to {scene.coordinate_names[dofs[-1]]}" if len(dofs) else "the world"


def _actuator_line(scene: Scene, k: int) -> str:
    control, force = _bounds(scene.core.act_ctrl[k]), _bounds(scene.core.act_force[k])
    text = scene.actuator_names[k]
    if _driven(scene, k) != text:
        text += f" on {_driven(scene, k)}"
    text += f" ctrl [{control[0]:g}, {control[1]:g}]" if control else ""
    text += f" force [{force[0]:g}, {force[1]:g}]" if force else ""
    state = _activation(scene, k)
    if state is None:
        return text
    time = f" of {state['time_constant']:g} s" if state["dynamics"] != "integrator" else ""
    return f"{text} through a{'n' * (not time)} {state['dynamics']}{time}"


def _activation(scene: Scene, k: int) -> dict[str, Any] | None:
    """The state of an actuator, if it has one."""
    core, number = scene.core, int(scene.core.act_state[k])
    if number < 0:
        return None
    return {
        "dynamics": Dynamics(int(core.state_kind[number])).name.lower(),
        "time_constant": float(core.P[scene.layout.actuator(k, "time")]),
        "limits": _bounds(core.state_range.reshape(-1, 2)[number]),
        "early": bool(core.state_early[number]),
    }


def _path(scene: Scene, tendon: int) -> dict[str, float]:
    """Coefficients of a tendon by coordinate; zeros if it goes through sites."""
    core = scene.core
    entries = range(core.tendon_ptr[tendon], core.tendon_ptr[tendon + 1])
    return {scene.coordinate_names[core.tendon_dof[e]]: float(core.tendon_coef[e]) for e in entries}


def _ends(scene: Scene, tie: int) -> list[str]:
    """What an equality constraint ties: bodies, or coordinates and tendons."""
    core = scene.core
    lines = core.tie_type[tie] == TieKind.POLYNOMIAL
    names, nothing = (scene.line_names, []) if lines else (scene.body_names, ["world"])
    return [end for k in (core.tie_A[tie], core.tie_B[tie]) for end in ([names[k]] if k != WORLD else nothing)]


def _tendon_line(scene: Scene, tendon: int) -> str:
    name, path = scene.tendon_names[tendon], _path(scene, tendon)
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
    if core.ntendon:
        lines.append(f"  tendons      {core.ntendon}" + _listed(_tendon_line(scene, k) for k in range(core.ntendon)))
    if core.ntie:
        ties = (
            f"{name} ({_TIES[core.tie_type[k]]} of {' and '.join(_ends(scene, k))})"
            for k, name in enumerate(scene.tie_names)
        )
        lines.append(f"  equalities   {core.ntie}" + _listed(ties))
    return lines


def _contact_lines(scene: Scene) -> str:
    core = scene.core
    kinds = zip(scene.contact_names, core.con_type, core.con_dim, strict=True)
    counts = Counter((name, _TYPES[kind], int(dim)) for name, kind, dim in kinds)
    lines = [f"{count} x {name}, {kind}, condim {dim}" for (name, kind, dim), count in counts.items()]
    if len(lines) > 40:
        lines = [*lines[:40], f"and {len(lines) - 40} more pairs (--json lists all)"]
    if scene.merged_points:
        lines.append(f"merged: {scene.merged_points} duplicate points")
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
