"""MJCF text of the bank's worlds: the same description for ours, MuJoCo and, where planar, Chipmunk."""

from __future__ import annotations

from collections.abc import Iterable
from math import cos, sin

from cmbrl.bench.studies.stability.case import G

GROUND = '<geom name="ground" type="plane" size="50 50 1"/>'


def world(
    *bodies: str,
    mu: float = 0.0,
    gravity: Iterable[float] = (0.0, 0.0, -G),
    solref: str = "",
    motors: Iterable[str] = (),
) -> str:
    """An MJCF of these bodies and geoms. mu: friction of every contact (0: frictionless contacts, condim 1);
    solref: MuJoCo's contact reference, default its own; motors: names of joints with a motor of gear 1."""
    contact = f'friction="{mu:.12g} 0 0" condim="3"' if mu > 0 else 'condim="1"'
    reference = f' solref="{solref}"' if solref else ""
    drives = "".join(f'<motor joint="{joint}"/>' for joint in motors)
    return (
        f'<mujoco><option gravity="{" ".join(f"{g:.15g}" for g in gravity)}" cone="elliptic">'
        '<flag autoreset="disable"/></option>'
        f"<default><geom {contact}{reference}/></default>"
        f"<worldbody>{''.join(bodies)}</worldbody>" + (f"<actuator>{drives}</actuator>" if drives else "") + "</mujoco>"
    )


def tilted(angle: float) -> tuple[float, float, float]:
    """Gravity in the frame of an incline of this angle [rad] that falls towards +x."""
    return G * sin(angle), 0.0, -G * cos(angle)


def body(name: str, pos: Iterable[float], joints: str, inside: str) -> str:
    """A body of the world; ``joints``: letters of its freedoms, x z (slides), r (hinge about y), f (free joint)."""
    words = {
        "x": f'<joint name="{name}_x" type="slide" axis="1 0 0"/>',
        "y": f'<joint name="{name}_y" type="slide" axis="0 1 0"/>',
        "z": f'<joint name="{name}_z" type="slide" axis="0 0 1"/>',
        "r": f'<joint name="{name}_r" type="hinge" axis="0 1 0"/>',
        "f": f'<freejoint name="{name}_f"/>',
    }
    place = " ".join(f"{x:.15g}" for x in pos)
    return f'<body name="{name}" pos="{place}">{"".join(words[k] for k in joints)}{inside}</body>'


def sphere(name: str, radius: float, mass: float | None = 1.0, more: str = "") -> str:
    """A solid sphere at the origin of its body; without mass where the body brings its own inertia."""
    return f'<geom name="{name}" type="sphere" size="{radius:.15g}"{_mass(mass)} {more}/>'


def box(name: str, half: Iterable[float], mass: float | None = 1.0, more: str = "") -> str:
    """A solid box; ``more``: further attributes, such as pos or euler."""
    size = " ".join(f"{x:.15g}" for x in half)
    return f'<geom name="{name}" type="box" size="{size}"{_mass(mass)} {more}/>'


def _mass(mass: float | None) -> str:
    return "" if mass is None else f' mass="{mass:.15g}"'
