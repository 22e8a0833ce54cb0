"""``cmbrl convert``: a URDF as an MJCF, with the base, floor and actuators that a URDF does not say."""

from __future__ import annotations

import argparse

from cmbrl.cli.options import number
from cmbrl.errors import UserError
from cmbrl.files import check_writable

EXAMPLE = """
cmbrl convert arm.urdf arm.xml --actuators motor
cmbrl convert go2.urdf go2.xml --floating --floor --actuators position --kp 25 --kd 0.5
cmbrl convert robot.urdf robot.xml --packages ~/ros/src   # where package:// is looked for
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("urdf", metavar="URDF", help="the file; expand xacro first")
    parser.add_argument("out", metavar="FILE", help="the MJCF to write: NAME.xml; meshes go into NAME_meshes beside it")
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


def run(arguments: argparse.Namespace) -> None:
    check_writable(arguments.out)
    if not arguments.out.endswith(".xml"):
        raise UserError(f"{arguments.out}: an MJCF ends in .xml")
    if arguments.kp is not None and arguments.actuators != "position":
        raise UserError("--kp is of position servos: add --actuators position")

    from cmbrl.scene import Scene
    from cmbrl.urdf import convert
    from cmbrl.urdf.actuators import Servo

    found = convert(
        arguments.urdf,
        arguments.out,
        floating=arguments.floating,
        floor=arguments.floor,
        actuators=arguments.actuators,
        servo=None if arguments.kp is None else Servo(arguments.kp, arguments.kd),
        packages=arguments.packages,
    )
    try:
        scene = Scene.from_mjcf(found.model)
    except UserError as error:  # it knows no file
        raise UserError(str(error).replace("MjModel", arguments.urdf, 1)) from None
    found.write(arguments.out)
    for note in found.notes:
        print(f"  {note}")
    print(f"{arguments.out}: {scene.nv} degrees of freedom, {scene.nu} actuators, {scene.total_mass:.4g} kg")
