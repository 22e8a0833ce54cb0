"""``cmbrl convert``: a URDF as an MJCF, with what a URDF does not say; or an MJCF with joints held, or with play."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from cmbrl.cli.argument_types import assignment, number
from cmbrl.errors import UserError
from cmbrl.files import check_writable, write_text

if TYPE_CHECKING:
    from cmbrl.scene import Scene

EXAMPLE = """
cmbrl convert arm.urdf arm.xml --actuators motor
cmbrl convert go2.urdf go2.xml --floating --floor --actuators position --kp 25 --kd 0.5
cmbrl convert robot.urdf robot.xml --packages ~/ros/src   # where package:// is looked for
cmbrl convert arm.xml held.xml --hold left --hold right=0.02   # without these joints
cmbrl convert arm.xml played.xml --play elbow --play 'wrist_*=0.02'   # play at joints
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help="the URDF, xacro expanded; or, with --hold or --play, the MJCF")
    parser.add_argument("out", metavar="OUT", help="the MJCF to write: NAME.xml; meshes of a URDF go into NAME_meshes")
    parser.add_argument("--floating", action="store_true", help="the root link is free; it starts on z = 0")
    parser.add_argument("--floor", action="store_true", help="add a plane at z = 0")
    parser.add_argument(
        "--actuators",
        choices=("none", "motor", "position"),
        default="none",
        help="of every joint: torques within its effort, or position targets within its range (default none)",
    )
    parser.add_argument("--kp", type=number, metavar="GAIN", help="stiffness of the servos [Nm/rad, N/m]")
    parser.add_argument("--kd", type=number, default=0.0, metavar="GAIN", help="their damping (default 0)")
    parser.add_argument(
        "--packages", action="append", default=[], metavar="FOLDER", help="holds ROS packages (repeatable)"
    )
    parser.add_argument(
        "--ignore",
        action="append",
        default=[],
        choices=("missing_mesh",),
        help="leave out collision meshes of a URDF that are not there",
    )
    parser.add_argument(
        "--hold",
        action="append",
        default=[],
        type=_valued,
        metavar="JOINT[=VALUE]",
        help="take this joint, or those of a pattern, out of an MJCF: held at VALUE [rad, m] or where the file has it",
    )
    parser.add_argument(
        "--play",
        action="append",
        default=[],
        type=_valued,
        metavar="JOINT[=GAP]",
        help="give this joint of an MJCF, or those of a pattern, play between motor and link: a joint JOINT_play of "
        "its own, with this gap from end to end to begin with (default 0.01 rad, 0.001 m); a fit finds the gap",
    )


def run(arguments: argparse.Namespace) -> None:
    check_writable(arguments.out)
    if not arguments.out.endswith(".xml"):
        raise UserError(f"{arguments.out}: an MJCF ends in .xml")
    if arguments.kp is not None and arguments.actuators != "position":
        raise UserError("--kp is of position servos: add --actuators position")
    for option in ("hold", "play"):
        if getattr(arguments, option) and (arguments.floating or arguments.floor or arguments.actuators != "none"):
            raise UserError(f"--{option} is of an MJCF, the other options of a URDF: convert the URDF first")
    if arguments.hold and arguments.play:
        raise UserError("--hold and --play: one after the other, each with its own file")

    change = _held if arguments.hold else _played if arguments.play else _converted
    scene, notes = change(arguments)
    for note in notes:
        print(f"  {note}")
    print(f"{arguments.out}: {scene.nv} degrees of freedom, {scene.nu} actuators, {scene.total_mass:.4g} kg")


def _held(arguments: argparse.Namespace) -> tuple[Scene, list[str]]:
    from cmbrl.scene.writing.held import held_file

    held = held_file(arguments.file, dict(arguments.hold))
    scene = _read(held.text, f"{arguments.file} with these joints held")
    write_text(arguments.out, held.text)
    lifted = [f"lifted by {way:.3g} m, out of reach of the ground: {name}" for name, way in held.lifted.items()]
    return scene, [f"held: {', '.join(name for name, _ in arguments.hold)}", *lifted]


def _played(arguments: argparse.Namespace) -> tuple[Scene, list[str]]:
    from cmbrl.scene.fittable.play import plays
    from cmbrl.scene.writing.played import played_file

    text = played_file(arguments.file, dict(arguments.play))
    scene = _read(text, f"{arguments.file} with this play")
    write_text(arguments.out, text)
    return scene, [f"play: {', '.join(joint.name for joint in plays(scene.joints))}; logs need no columns of it"]


def _read(text: str, what: str) -> Scene:
    from cmbrl.scene import Scene

    try:
        return Scene.from_mjcf(text)
    except UserError as error:
        raise UserError(str(error).replace("XML text", what, 1)) from None


def _converted(arguments: argparse.Namespace) -> tuple[Scene, Sequence[str]]:
    from cmbrl.scene import Scene
    from cmbrl.scene.urdf import convert
    from cmbrl.scene.urdf.actuators import Servo

    found = convert(
        arguments.file,
        arguments.out,
        floating=arguments.floating,
        floor=arguments.floor,
        actuators=arguments.actuators,
        servo=None if arguments.kp is None else Servo(arguments.kp, arguments.kd),
        packages=arguments.packages,
        ignore=arguments.ignore,
    )
    try:
        scene = Scene.from_mjcf(found.model)
    except UserError as error:  # it knows no file
        raise UserError(str(error).replace("MjModel", arguments.file, 1)) from None
    found.write(arguments.out)
    return scene, found.notes


def _valued(text: str) -> tuple[str, float | None]:
    """A joint, with or without a value."""
    if "=" not in text:
        return text, None
    name, value = assignment(text)
    return name, number(value)
