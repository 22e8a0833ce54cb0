"""``cmbrl COMMAND``: finds the command, runs it, turns a user's mistake into one line."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version

from cmbrl.cli.configuration import add_config, expand
from cmbrl.cli.options import Parser
from cmbrl.errors import UserError, did_you_mean

# name -> one line for `cmbrl --help`; the module of that name has EXAMPLE, add_arguments(parser), run(arguments).
COMMANDS = {
    "info": "what a scene models, what it leaves out and why, and which parameters can be fitted",
    "record": "log transitions from the real system of a task",
    "fit": "fit the physical parameters of a contact model to a log",
    "error": "compare models on a log: one step and open loop, by stratum",
    "train": "train a policy on a model, or in the real system",
    "evaluate": "what a policy earns in the real system and in a model",
    "play": "a clip of a policy in the real system and in a model, or an interactive viewer",
    "export": "write a policy as ONNX or TorchScript",
    "sweep": "run one configuration under many seeds, on this machine, Ray or Dask",
    "bench": "measure models, solvers and gradients beside their rivals",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line and returns the exit code: 0 done, 2 a mistake in the input, 130 interrupted."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            return _dispatch(arguments)
    except UserError as error:
        print(f"cmbrl: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("cmbrl: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # The reader has gone (`cmbrl info hopper | head`); keep the interpreter from complaining about it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    """A warning as one line, without the source line that only a developer can use."""
    print(f"cmbrl: warning: {message}", file=sys.stderr)


def _dispatch(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_overview())
        return 0
    if arguments[0] == "--version":
        print(f"cmbrl {version('cmbrl')}")
        return 0
    name, rest = arguments[0], arguments[1:]
    if name not in COMMANDS:
        raise UserError(f"unknown command {name!r}: {did_you_mean(name, COMMANDS)}")
    # Only the module of the command that runs is imported: `cmbrl info` does not wait for torch.
    command = import_module(f"cmbrl.cli.{name}")
    parser = Parser(prog=f"cmbrl {name}", description=COMMANDS[name], epilog=command.EXAMPLE)
    command.add_arguments(parser)
    add_config(parser)
    return command.run(parser.parse_args(expand(parser, rest))) or 0


def _overview() -> str:
    what = "Contact models from logged transitions, and policies trained on them."
    lines = ["usage: cmbrl COMMAND ...", "", what, "", "commands:"]
    lines += [f"  {name:10s}{text}" for name, text in COMMANDS.items()]
    lines += ["", "example:", "  cmbrl info hopper", ""]
    lines += ["'cmbrl COMMAND --help' has a command's options and examples."]
    return "\n".join(lines)
