"""``cmbrl excite``: commands to replay on a robot, whose log tells most about its parameters."""

from __future__ import annotations

import argparse
import io
import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.cli.argument_types import positive, positive_number
from cmbrl.cli.options import add_json, add_scene_options, add_seed, add_threads
from cmbrl.cli.progress import fraction
from cmbrl.errors import UserError
from cmbrl.files import check_writable, write_bytes
from cmbrl.models.source import Source, load_source
from cmbrl.runs import usable_cores
from cmbrl.scene.source.keyframes import keyframe

if TYPE_CHECKING:
    from cmbrl.excitation import Excitation
    from cmbrl.scene import Scene

EXAMPLE = """
cmbrl excite arm.xml --seconds 20 --out commands.csv
cmbrl excite go2_legs.xml --seconds 30 --start home --rate 200 --out commands.npz
cmbrl excite runs/arm --seconds 20 --out second_log.npz    # what a fit leaves open
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="SCENE|TASK|FIT", help="an MJCF or URDF file, a task, or a fit's folder")
    parser.add_argument("--seconds", type=positive_number, required=True, metavar="S", help="length of the log")
    parser.add_argument("--out", required=True, metavar="FILE", help="NAME.csv or NAME.npz to write")
    parser.add_argument("--start", metavar="KEY", help="keyframe of the file to start from (default: its initial pose)")
    parser.add_argument(
        "--rate", type=positive_number, metavar="HZ", help="commands a second (default: the file's step)"
    )
    parser.add_argument(
        "--fastest", type=positive_number, default=2.0, metavar="HZ", help="fastest motion (default 2 a second)"
    )
    parser.add_argument(
        "--margin",
        type=share,
        default=0.1,
        metavar="X",
        help="share of each range left unused at its ends (default 0.1)",
    )
    parser.add_argument("--rounds", type=positive, default=8, metavar="N", help="rounds of the search (default 8)")
    add_scene_options(parser)
    add_threads(parser)
    add_seed(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    out = Path(arguments.out)
    if out.suffix not in (".csv", ".npz"):
        raise UserError(f"{out}: commands are written as CSV or npz; give NAME.csv or NAME.npz")
    check_writable(out)
    source = _source(arguments)
    start = None if arguments.start is None else keyframe(source.scene, arguments.start)

    from cmbrl.excitation import excite

    model = source.model(threads=arguments.threads or usable_cores())
    if source.fitted is not None:
        model = source.fitted
    if arguments.rate:
        model = model.with_settings(substeps=1).for_log(1.0 / arguments.rate)
    with fraction(f"excite {source.scene.name}") as show:
        found = excite(
            model, arguments.seconds, start, arguments.rounds, arguments.fastest, arguments.margin, arguments.seed, show
        )
    write(found, source.scene, out)
    numbers = {"gain": found.gain, "random_gain": found.random_gain, "safe": found.safe, "rows": len(found.time)}
    if arguments.json:
        print(json.dumps({"file": str(out), **numbers, "start": found.motion[0].tolist()}, indent=2))
        return
    print(f"{out}: {len(found.time)} commands, {found.time[1] - found.time[0]:g} s apart, for {source.scene.name}")
    print(f"  expected to tell {found.gain:.1f} nats about the parameters; without a search, {found.random_gain:.1f}")
    if moved := _moved(found, source.scene, source.scene.q0 if start is None else start):
        print(f"  the start lies beyond ranges, so drive the robot there first: {moved}")
    print(f"  {100 * found.safe:.0f} % of the commands drawn were safe: joints in their ranges, nothing touched")


def _moved(found: Excitation, scene: Scene, start: np.ndarray) -> str:
    """The joints that begin elsewhere than in ``start`` (nq,), and where."""
    return ", ".join(
        f"{joint.name} at {found.motion[0, joint.qadr]:.4g}"
        for joint in scene.joints
        if found.motion[0, joint.qadr] != start[joint.qadr]
    )


def _source(arguments: argparse.Namespace) -> Source:
    from cmbrl.models.named import holds_fit, load_complementarity

    if holds_fit(arguments.source):
        fitted = load_complementarity(arguments.source)
        return Source(arguments.source, fitted.scene, fitted=fitted)
    return load_source(arguments.source, arguments.ignore, arguments.contact_law, arguments.self_contact)


def write(found: Excitation, scene: Scene, out: Path) -> None:
    """Writes commands and the predicted motion, completely or not at all."""
    key = "commanded_position" if found.servo else "torque"
    if out.suffix == ".csv":
        header = ",".join(["time", *(f"{name}.{key}" for name in scene.actuator_names)])
        text = io.StringIO()
        np.savetxt(
            text, np.column_stack([found.time, found.commands]), delimiter=",", header=header, comments="", fmt="%.9g"
        )
        write_bytes(out, text.getvalue().encode())
        return
    content = io.BytesIO()
    names = np.array(scene.actuator_names)
    arrays = {"time": found.time, key: found.commands, "actuator_names": names, "predicted_q": found.motion}
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]
    write_bytes(out, content.getvalue())


def share(text: str) -> float:
    """A number from 0 to below 0.5."""
    value = float(text) if text.replace(".", "", 1).isdigit() else -1.0
    if not 0.0 <= value < 0.5:
        raise argparse.ArgumentTypeError(f"{text} is not in [0, 0.5)")
    return value
