"""``cmbrl import``: a log of others as one of ours, checked for faults that its numbers show."""

from __future__ import annotations

import argparse
import json
import textwrap
from pathlib import Path

from cmbrl.cli.argument_types import assignment, number, positive, positive_number
from cmbrl.cli.configuration import read_configuration
from cmbrl.cli.options import add_json, add_scene_options, add_trust
from cmbrl.errors import UserError
from cmbrl.models.source import load_source
from cmbrl.table import WIDTH

EXAMPLE = """
cmbrl import run1.csv run2.csv --scene robot.xml --angles deg --out log.npz
cmbrl import bag --scene robot.xml --map joint_states.position.j1=hip.position --out log.npz
cmbrl import joints.csv --base capture.csv --scene go2.xml --kp 20 --kd 1 --out log.npz
cmbrl import arm.csv --scene arm.xml --kp 60 --kp wrist=20 --kd 3 --out log.npz
cmbrl import chirp.pt --scene leg.xml --joints hip thigh calf --kp 20 --kd 1.5 --out log.npz
"""

TRUSTED = (
    "--trust-log is not kept in the file: give it to fit, error and others, too, or they refuse what was warned of here"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "files",
        metavar="FILE",
        nargs="+",
        help="CSV, Parquet, npz, HDF5, .pt of PACE, .mcap, .db3 or .bag, or the folder of a rosbag2, LeRobot or Minari "
        "log; several become one log with an episode each",
    )
    parser.add_argument("--scene", required=True, metavar="SCENE|TASK", help="an MJCF or URDF file, or a task")
    parser.add_argument("--out", required=True, metavar="FILE", help="the log to write: NAME.npz")
    parser.add_argument(
        "--map",
        action="append",
        default=[],
        metavar="COLUMN=TARGET|FILE",
        help="what a column is, as hip.position:deg, hip.velocity:rpm, hip.command, hip.torque, motor.control, "
        "base.qw, base.wx, time:ms, episode, or - for nothing; of an array, the quantity alone: qpos=position:deg, or "
        "obs=-; or a YAML file of such pairs (repeatable). A unit may have a factor before it: hip.position:0.17578deg "
        "of counts. Columns with the names of joints are found without it",
    )
    parser.add_argument(
        "--joints",
        nargs="+",
        default=[],
        metavar="NAME",
        help="joints of array columns without names, and of numbered ones (q_0, q_1, ...)",
    )
    parser.add_argument(
        "--angles",
        choices=("rad", "deg", "rev", "mrad"),
        default="rad",
        help="unit of hinges where neither --map nor a column's name tells it (default rad)",
    )
    parser.add_argument(
        "--rate", type=positive_number, metavar="HZ", help="samples per second of the log, and of files without times"
    )
    parser.add_argument(
        "--gap", type=positive, default=10, metavar="N", help="more lost samples than this end an episode (default 10)"
    )
    for name in ("kp", "kd"):
        parser.add_argument(
            f"--{name}",
            action="append",
            default=[],
            metavar="X|JOINT=X",
            help=f"{name} of the position servos, where the log has none: of all joints, or by joint (repeatable; "
            "others keep the file's)",
        )
    parser.add_argument(
        "--gravity-compensated",
        action="store_true",
        help="the driver holds the links by torques that the log does not tell: add what they weigh by the file",
    )
    parser.add_argument(
        "--as",
        dest="kind",
        choices=("transitions", "positions"),
        help="with velocities, or positions and commands alone (default: as the log has them)",
    )
    _add_base(parser)
    parser.add_argument(
        "--velocity-window", type=positive, default=5, metavar="K", help="samples of an estimated velocity (default 5)"
    )
    parser.add_argument(
        "--command-offset",
        nargs="+",
        type=number,
        default=[],
        metavar="S",
        help="seconds by which the clock of commands is later than that of positions: one for all logs, or one each",
    )
    add_trust(parser)
    add_scene_options(parser)
    add_json(parser)


def _add_base(parser: argparse.ArgumentParser) -> None:
    """Where a floating base was, and in which axes."""
    for what, told in (("angular", "asked for where it was logged"), ("linear", "default world")):
        parser.add_argument(
            f"--{what}-velocity",
            choices=("body", "world"),
            default=None if what == "angular" else "world",
            help=f"axes of the {what} velocity of a floating base ({told})",
        )
    parser.add_argument(
        "--base",
        nargs="+",
        default=[],
        metavar="FILE",
        help="poses of the floating base (x y z qw qx qy qz), a file for each log, of another rate and clock",
    )
    parser.add_argument(
        "--base-offset",
        type=number,
        metavar="S",
        help="seconds by which the clock of --base is later (default: found in how joints and base move together)",
    )
    parser.add_argument(
        "--quaternion", choices=("wxyz", "xyzw"), help="order of quaternions in arrays (asked for where not named)"
    )
    parser.add_argument(
        "--markers",
        type=number,
        nargs=6,
        metavar=("X", "Y", "Z", "RX", "RY", "RZ"),
        help="where in the base what the poses are of sits [m] and how it is turned [degrees, a rotation vector] "
        "(default: found by the feet that stand, where a motion capture tells the poses)",
    )


def run(arguments: argparse.Namespace) -> None:
    from cmbrl.data.importing import Frames, Options, import_logs
    from cmbrl.data.position_file import check_target

    check_target(arguments.out)  # now rather than after minutes of reading
    options = Options(
        columns=mapping(arguments.map),
        joints=tuple(arguments.joints),
        angles=arguments.angles,
        rate=arguments.rate,
        gap=arguments.gap,
        frames=Frames(arguments.angular_velocity, arguments.linear_velocity),
        kp=gains("kp", arguments.kp),
        kd=gains("kd", arguments.kd),
        compensated=arguments.gravity_compensated,
        kind=arguments.kind,
        window=arguments.velocity_window,
        command_offset=tuple(arguments.command_offset),
        base=tuple(arguments.base),
        base_offset=arguments.base_offset,
        quaternion=arguments.quaternion,
        markers=None if arguments.markers is None else tuple(arguments.markers),
    )
    source = load_source(arguments.scene, arguments.ignore, arguments.contact_law, arguments.self_contact)
    found = import_logs(arguments.files, source.scene, options)
    found.log.save(arguments.out)
    notes = [*found.notes, *([TRUSTED] if arguments.trust_log else [])]
    kind = "transitions" if hasattr(found.log, "q") else "positions"
    if arguments.json:
        summary = {"file": arguments.out, "kind": kind, "rows": len(found.log), "episodes": found.log.n_episodes}
        print(json.dumps({**summary, "dt": found.log.dt, "notes": notes}, indent=2))
    else:
        lines = [line for note in notes for line in textwrap.wrap(note, WIDTH, subsequent_indent="  ")]
        print("\n".join([*lines, f"{arguments.out}: {len(found.log)} {kind} of {source.scene.name}"]))


def mapping(words: list[str]) -> dict[str, str]:
    """Targets of columns, from words COLUMN=TARGET and files of them; the last word on a column counts."""
    found: dict[str, str] = {}
    for word in words:
        if "=" in word and not Path(word).is_file():
            try:
                column, target = assignment(word)
            except argparse.ArgumentTypeError as error:
                raise UserError(f"--map: {error}") from None
            found[column] = target
            continue
        for column, target in read_configuration(Path(word)).items():
            if not isinstance(target, str):
                raise UserError(f"{word}: {column}: give a target as text, such as hip.position:deg")
            found[column] = target
    return found


def gains(name: str, words: list[str]) -> float | dict[str, float] | None:
    """The gain of all joints, or gains by joint ("": of those that are not named), from words X and JOINT=X."""
    found: dict[str, float] = {}
    for word in words:
        try:
            joint, value = assignment(word) if "=" in word else ("", word)
            found[joint] = number(value)
        except argparse.ArgumentTypeError as error:
            raise UserError(f"--{name}: {error}") from None
    return found[""] if list(found) == [""] else found or None
