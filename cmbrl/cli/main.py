"""``cmbrl COMMAND``: finds the command, runs it, and prints a user's mistake as one line."""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from importlib import import_module
from importlib.metadata import version
from keyword import iskeyword
from types import ModuleType

from cmbrl.cli.options import EXIT_INTERRUPTED
from cmbrl.cli.parser import Parser
from cmbrl.errors import UserError, did_you_mean
from cmbrl.files import FULL

# name -> summary; the module cmbrl.cli.NAME (cmbrl.cli.NAME_ for a word of Python) has EXAMPLE, add_arguments(parser)
# and run(arguments) -> exit code or None.
COMMANDS = {
    "info": "what a scene models, what it leaves out and why, and which parameters can be fitted",
    "convert": "write a URDF as an MJCF with base, floor and actuators; hold joints of an MJCF",
    "import": "read the log of a robot: CSV, Parquet, npz, HDF5, ROS bags, LeRobot, PACE",
    "record": "record transitions from the real system of a task",
    "fit": "fit the physical parameters of a contact model to a log",
    "residual": "learn what no parameter expresses: a small net in front of a fit",
    "error": "compare models on a log: one step ahead and open loop, by stratum",
    "train": "train a policy on a model, or in the real system",
    "evaluate": "the return of a policy in the real system and in a model",
    "play": "a clip of a policy in the real system and in a model, or an interactive viewer",
    "export": "write a policy as ONNX or TorchScript",
    "excite": "commands whose log tells most about the parameters of a robot",
    "check": "compare a robot's model with MuJoCo, step by step, and test its derivatives and speed",
    "sweep": "run one configuration with many seeds, on this computer, Ray or Dask",
    "bench": "measure models, solvers and gradients next to their competitors",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line and returns the exit code: 0 done, 2 invalid input, 130 interrupted."""
    _open_streams()
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _once()
            code = _dispatch(sys.argv[1:] if argv is None else argv)
            sys.stdout.flush()
            return code
    except UserError as error:
        print(f"cmbrl: {error}", file=sys.stderr)
        return 2
    except MemoryError:
        print("cmbrl: out of memory: ask for less at a time, or use a larger machine", file=sys.stderr)
        return 2
    except KeyboardInterrupt as interruption:
        print("cmbrl: interrupted", *interruption.args, sep=": ", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # The reader has gone (`cmbrl info hopper | head`): keep the interpreter from complaining at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except OSError as error:
        if error.errno in FULL:
            told = f"{error.filename or 'standard output'}: cannot be written ({error.strerror}): free space there"
            # What is still to be printed is given up: the interpreter would complain about it at exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        elif error.filename is not None:  # of a path that the user gave
            told = f"{error.filename}: {error.strerror}; check the path"
        else:
            raise
        print(f"cmbrl: {UserError(told)}", file=sys.stderr)
        return 2


def _open_streams() -> None:
    """Lets standard streams that the caller has closed (`cmbrl info hopper >&-`) lead nowhere.

    Python has none then, and the next file that is opened would take their place.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free, which is this one
    sys.stdout = sys.stdout or os.fdopen(1, "w")
    sys.stderr = sys.stderr or os.fdopen(2, "w")


def _once() -> Callable[..., None]:
    """Shows a warning as one line, without the line of source; the same one once."""
    shown = set()

    def show(message: Warning | str, *_: object, **__: object) -> None:
        if str(message) not in shown:
            shown.add(str(message))
            print(f"cmbrl: warning: {message}", file=sys.stderr)

    return show


def _dispatch(arguments: Sequence[str]) -> int:
    overview = _overview()
    chosen = overview.parse_args(arguments)
    name = chosen.command
    if name is None:
        overview.print_help()
        return 0
    if name not in COMMANDS:
        raise UserError(f"unknown command {name!r}: {did_you_mean(name, COMMANDS)}")
    try:
        os.getcwd()
    except FileNotFoundError:  # torch would end the process
        raise UserError("the folder that you are in has been removed: change to one that is there") from None
    given = parser_of(name).parse(chosen.arguments)
    with _trusting() if getattr(given, "trust_log", False) else nullcontext():
        return _module(name).run(given) or 0


def _trusting() -> AbstractContextManager[None]:
    from cmbrl.data.plausible import trusting  # with numpy: `cmbrl --help` must not wait for it

    return trusting()


def _module(name: str) -> ModuleType:
    return import_module(f"cmbrl.cli.{name}{'_' * iskeyword(name)}")


def parser_of(name: str) -> Parser:
    """The parser of a command. Only that command is imported: `cmbrl info` must not wait for torch."""
    command = _module(name)
    parser = Parser(f"cmbrl {name}", COMMANDS[name], command.EXAMPLE)
    command.add_arguments(parser)
    parser.add_config()
    return parser


def _overview() -> Parser:
    rows = "".join(f"\n  {name:10s}{summary}" for name, summary in COMMANDS.items())
    about = f"Contact models from logged transitions, and policies trained on them.\n\ncommands:{rows}"
    parser = Parser("cmbrl", about, "cmbrl info hopper\ncmbrl fit --help")
    parser.add_argument("--version", action="version", version=f"cmbrl {version('cmbrl')}")
    parser.add_argument("command", nargs="?", metavar="COMMAND", help="one of those above; each has --help")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    return parser
