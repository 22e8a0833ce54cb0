"""Hostile MJCF: wrong attributes, elements that copy themselves, files without an end, damaged text."""

from __future__ import annotations

import os
import random
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

import numpy as np

from . import judge

BALL = """<mujoco model="ball"><option timestep="0.005"/><worldbody>
<geom name="floor" type="plane" size="1 1 1"/><body name="ball" pos="0 0 1"><freejoint name="root"/>
<geom name="ball" size="0.1" mass="1"/></body></worldbody></mujoco>"""
ARM = """<mujoco model="arm"><compiler angle="radian"/><default><joint damping="0.1"/></default><worldbody>
<geom name="floor" type="plane" size="1 1 1"/><body name="arm" pos="0 0 1">
<joint name="shoulder" axis="0 1 0" range="-1 1" limited="true"/>
<geom name="link" type="capsule" fromto="0 0 0 0.5 0 0" size="0.05"/><body name="hand" pos="0.5 0 0">
<joint name="wrist" axis="0 1 0"/><geom name="box" type="box" size="0.1 0.1 0.1"/></body></body></worldbody>
<actuator><motor joint="shoulder" gear="10" ctrlrange="-1 1"/></actuator>
<custom><numeric name="rounding:box" data="0.01"/></custom></mujoco>"""
VALUES = ("", " ", "-1", "0", "1", "1e300", "-1e300", "1e400", "1e-320", "nan", "inf", "-inf", "2000000000",
    "99999999999", "9" * 5000, "text",
          "0 0", "0 0 0", "1 2 3 4 5 6 7 8", "nan nan nan", "1e200 1 1", "true", "auto", "é", "a" * 5000, "%s%n",
          "../..", "&#1;", "&lt;")  # fmt: skip
ATTRIBUTES = (
    ("size", "nuser_body"), ("size", "nuser_geom"), ("size", "nuserdata"), ("size", "nkey"), ("size", "memory"),
    ("size", "njmax"), ("size", "nconmax"),
    ("size", "nstack"), ("option", "timestep"), ("option", "gravity"), ("option", "integrator"), ("option", "impratio"),
    ("option", "density"),
    ("option", "cone"), ("compiler", "boundmass"), ("compiler", "settotalmass"), ("compiler", "meshdir"), ("compiler",
    "angle"), ("compiler", "eulerseq"),
    ("compiler", "balanceinertia"), ("geom", "solref"), ("geom", "solimp"), ("geom", "friction"), ("geom", "condim"),
    ("geom", "margin"), ("geom", "gap"),
    ("geom", "type"), ("geom", "quat"), ("geom", "density"), ("geom", "mass"), ("geom", "contype"), ("geom",
    "priority"), ("geom", "mesh"),
    ("geom", "fromto"), ("joint", "type"), ("joint", "armature"), ("joint", "stiffness"), ("joint", "damping"),
    ("joint", "frictionloss"),
    ("joint", "axis"), ("joint", "range"), ("joint", "ref"), ("joint", "solreflimit"), ("body", "mocap"), ("body",
    "gravcomp"), ("body", "pos"),
    ("body", "quat"), ("body", "euler"), ("body", "childclass"), ("body", "user"), ("motor", "gear"), ("motor",
    "ctrlrange"), ("motor", "joint"),
    ("motor", "forcerange"), ("motor", "dyntype"), ("motor", "nsample"), ("numeric", "data"), ("numeric", "size"),
    ("numeric", "name"), ("freejoint", "align"),
)  # fmt: skip
INSERTED = (
    '<replicate count="{n}" offset="0.3 0 0"><body><freejoint/><geom size="0.1"/></body></replicate>',
    '<replicate count="{n}"><geom size="0.1"/></replicate>',
    '<replicate count="{n}"><replicate count="{n}"><replicate count="{n}"><site/></replicate></replicate></replicate>',
    '<include file="{file}"/>',
    '<composite type="cable" count="{n} 1 1"><geom size="0.1"/></composite>',
    '<flexcomp name="f" type="grid" count="{n} {n} 2" spacing=".1 .1 .1"/>',
    '<asset><hfield name="h" nrow="{n}" ncol="{n}" size="1 1 1 1"/></asset>',
    '<asset><texture type="2d" builtin="flat" width="{n}" height="{n}"/></asset>',
    '<asset><texture type="skybox" fileright="{file}"/></asset>', '<asset><mesh name="m" file="{file}"/></asset>',
    '<asset><hfield name="h" file="{file}" size="1 1 1 1"/></asset>',
    '<asset><model name="m" file="{file}"/></asset>', '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0"/></asset>',
    '<worldbody><attach model="m" prefix="p"/></worldbody>',
    '<asset><mesh name="m" builtin="sphere" params="{n}"/></asset>', '<custom><numeric name="x" size="{n}"/></custom>',
    '<keyframe><key qpos="1"/></keyframe>', '<frame><frame/></frame>',
    '<extension><plugin plugin="mujoco.elasticity.cable"/></extension>', '<equality><weld body1="ball"/></equality>',
    '<worldbody><body><freejoint/></body></worldbody>',
    '<sensor><user dim="{n}"/></sensor>', '<tendon><fixed><joint joint="wrist" coef="1"/></fixed></tendon>',
    '<contact><exclude body1="ball" body2="world"/></contact>',
    '<custom><text name="t" data="x"/><tuple name="u"><element objtype="body" objname="u"/></tuple></custom>',
    '<visual><global offwidth="{n}"/></visual>', '<unknown/>', '<!-- -->', '<?php ?>',
)  # fmt: skip
FILES = (
    "pipe.xml",
    "folder",
    "missing.xml",
    "scene.xml",
    "text.xml",
    "/dev/zero",
    "/proc/self/mem",
    "x" * 5000,
    "",
    "../scene.xml",
    "ball.xml",
    "loop.xml",
    "/dev/stdin",
)
NUMBERS = ("-1", "0", "3", "200", "5000", "100000000", "2147483647", "99999999999999", "1e9", "nan", "")


def draw(rng: random.Random, folder: Path) -> judge.Case:
    """A scene with one or two things wrong."""
    root, told = ElementTree.fromstring(rng.choice((BALL, ARM))), []
    for _ in range(rng.choice((1, 1, 2))):
        told.append(rng.choice((attribute, attribute, attribute, added, insert, insert, move, nest))(root, rng))
    text = ElementTree.tostring(root, encoding="unicode").replace("INSERTED", "").replace("&amp;#", "&#")
    data = text.encode()
    if rng.random() < 0.25:
        change: Callable[[bytes, random.Random], tuple[str, bytes]] = rng.choice((encoding, broken, cut, entities))
        more, data = change(data, rng)
        told.append(more)
    law = rng.choice(("mujoco", "rigid", "spring-damper"))
    return f"{law}: {'; '.join(told)}\n{data[:1500]!r}", lambda: _use(data, folder, law)


def _use(data: bytes, folder: Path, law: str) -> str:
    """Reads the scene, and steps it from where it starts."""
    from cmbrl import ComplementarityModel, Scene
    from cmbrl.native import SolverStatus

    if not (folder / "pipe.xml").exists():
        os.mkfifo(folder / "pipe.xml")
        (folder / "folder").mkdir()
        (folder / "text.xml").write_text("dear diary", encoding="utf-8")
        (folder / "ball.xml").write_text(BALL, encoding="utf-8")
        (folder / "loop.xml").write_text('<mujoco><include file="loop.xml"/></mujoco>', encoding="utf-8")
    (folder / "scene.xml").write_bytes(data)
    scene = Scene.from_mjcf(folder / "scene.xml", contact_law=law)
    judge.require(bool(np.isfinite(scene.core.P).all()), "a physical constant is not finite")
    model = ComplementarityModel(scene)
    found = model.predict(scene.q0[None], np.zeros((1, scene.nv)), np.zeros((1, scene.nu)))
    fine = np.isfinite(found.q_next).all() and np.isfinite(found.v_next).all()
    judge.require(bool(fine) or found.status[0] == SolverStatus.FAILED, "a step is not finite, and says nothing")
    return judge.RIGHT


def attribute(root: ElementTree.Element, rng: random.Random) -> str:
    element = rng.choice([one for one in root.iter() if one.attrib])
    key = rng.choice(list(element.attrib))
    element.attrib[key] = rng.choice(VALUES)
    return f"{element.tag} {key}={element.attrib[key][:40]!r}"


def added(root: ElementTree.Element, rng: random.Random) -> str:
    tag, key = rng.choice(ATTRIBUTES)
    place = rng.choice([one for one in root.iter(tag)] or [root])
    if place is root:
        place = ElementTree.SubElement(root, tag)
    place.attrib[key] = rng.choice(VALUES)
    return f"{tag} {key}={place.attrib[key][:40]!r}"


def insert(root: ElementTree.Element, rng: random.Random) -> str:
    text = rng.choice(INSERTED).format(n=rng.choice(NUMBERS), file=rng.choice(FILES))
    places = [root, *root.iter("worldbody"), *root.iter("worldbody"), *root.iter("body")]
    rng.choice(places).append(ElementTree.fromstring(f"<INSERTED>{text}</INSERTED>"))
    for parent in root.iter():
        for k, child in enumerate(list(parent)):
            if child.tag == "INSERTED":
                parent[k : k + 1] = list(child)
    return text[:90]


def move(root: ElementTree.Element, rng: random.Random) -> str:
    parent = rng.choice([one for one in root.iter() if len(one)])
    child = rng.choice(list(parent))
    if rng.random() < 0.5:
        parent.remove(child)
        return f"no {child.tag}"
    parent.append(child)
    return f"{child.tag} twice"


def nest(root: ElementTree.Element, rng: random.Random) -> str:
    depth, place = rng.choice((10, 400, 900)), next(root.iter("worldbody"))
    for _ in range(depth):
        place = ElementTree.SubElement(place, rng.choice(("body", "frame")))
    return f"nested {depth} deep"


def encoding(data: bytes, rng: random.Random) -> tuple[str, bytes]:
    name = rng.choice(
        ("utf-16", "latin-1", "cp1252", "utf-7", "nonsense", "utf-32", "shift_jis", "ascii", "hex", "punycode", "")
    )
    head = f'<?xml version="1.0" encoding="{name}"?>'
    text = data.decode().replace('name="floor"', 'name="böden"')
    try:
        return f"encoding {name}", (head + text).encode(rng.choice((name, "latin-1")) or "utf-8", errors="replace")
    except (LookupError, UnicodeError):
        return f"encoding {name}", head.encode() + text.encode("latin-1", errors="replace")


def broken(data: bytes, rng: random.Random) -> tuple[str, bytes]:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 3, 10))):
        changed[rng.randrange(len(changed))] = rng.randrange(256)
    return "bytes replaced", bytes(changed)


def cut(data: bytes, rng: random.Random) -> tuple[str, bytes]:
    place = rng.randrange(len(data))
    return f"cut to {place} bytes", data[:place]


def entities(data: bytes, rng: random.Random) -> tuple[str, bytes]:
    inside = "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefghi", "bcdefghij", strict=True))
    kind = rng.choice(
        (
            f'<!ENTITY a "aaaaaaaaaa">{inside}',
            '<!ENTITY j SYSTEM "pipe.xml">',
            '<!ENTITY j SYSTEM "/etc/hostname">',
            '<!ENTITY j "1">',
        )
    )
    head = f"<!DOCTYPE mujoco [{kind}]>".encode()
    return "entities", head + data.replace(b"<worldbody>", b"<worldbody>&j;", 1)
