"""Hostile configurations: damaged text, wrong values and keys, and what YAML can do that options never need."""

from __future__ import annotations

import random
from pathlib import Path

from . import judge

FIT = """source: hopper
data: nowhere.npz
out: run
seed: 1
horizon: 2
method: random
groups: [mass, friction]
set: {mass.torso: 3.6}
"""
TRAIN = """task: hopper
out: file/run
seed: 1
algorithm: shac
model: nominal
iterations: 5
set: {window: 0.2, actor_hidden: [32, 32]}
"""
RECORD = "task: hopper\nsteps: 3\nout: file/log.npz\nbehaviour: random\nseed: 0\n"
VALUES = (
    "", "~", "true", "-1", "0", "1.5", ".nan", ".inf", "1e300", "1e400", "9" * 5000, "0x" + "f" * 5000,
    "0b" + "1" * 20000,
    "2020-01-01", "2020-01-01 10:00:00", "1:30", "'text'", "''", "[]", "{}", "[[]]", "[1, [2]]", "{a: {b: {c: 1}}}",
    "[" * 300 + "]" * 300, "{a: " * 300 + "}" * 300, "[" * 50_000, "!!binary aGVsbG8=", "!!set {a, b}", "!!omap [a: 1]",
    "!!python/object/apply:os.getcwd []", "!!int text", "!!float text", "!!timestamp text", "!!bool text", "!!null x",
    "!!binary é", "!!pairs [a]", "!!map x", "!!seq {}", "!!str [a]", "&a 1", "*a", "&a [*a]", '"\\ud800"', '"\\0"',
    '"\\x1b[2J"',
    "'a\n\n\nb'", "|\n  lines\n  of\n  text", "<<: {seed: 3}", "? [a, b]\n: c", "=", "2147483648", "99999999999", "１",
    "1_000",
    "x" * 5000, "/" * 5000, "nowhere/../..", "/dev/zero", "/proc/self/mem", "-", "--seed", "%TAG", "@", "`", "\t1",
    "x: y: z",
)  # fmt: skip
KEYS = ("", "1", "~", "true", "[a]", "{a: 1}", "seed", "config", "command", "help", "json", "Seed", "<<", "!!str seed",
    "*a",
        "x" * 5000, "? x", "2020-01-01", "resume", "arguments", "all-parameters", "_actions", "threads",
        "time-limit")  # fmt: skip
BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{b}: &{b} [{','.join(['*' + a] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
WHOLE = (
    BOMB, BOMB + "source: *i\n", BOMB + "command: *i\n", "source: &s [*s]\n", "- a\n- b\n", "text", "", "---\n---\n",
    "a: 1\n--- \nb: 2\n",
    "\ufeffseed: 1\n",
    "%YAML 9.9\n---\nseed: 1\n", "{" * 100_000, "- " * 50_000, "a:\n" + "".join(" " * k + "a:\n" for k in range(2000)),
    "\x00" * 99,
    "\x07", "[1, 2", "a: b: c", "? " * 1000, "'" * 999, "command: [[[[[[1]]]]]]\n", "command: sweep\n", "command: {}\n",
    "x: " + "y " * 400_000,
)  # fmt: skip


def draw(rng: random.Random, folder: Path) -> judge.Case:
    """A configuration with something wrong, and the command that reads it."""
    name, base = rng.choice((("fit", FIT), ("train", TRAIN), ("record", RECORD), ("sweep", f"command: fit\n{FIT}")))
    lines = base.splitlines()
    at = rng.randrange(len(lines))
    key, _, value = lines[at].partition(": ")
    kind = rng.choice(("value", "value", "value", "key", "double", "drop", "whole", "bytes", "encoding", "indent"))
    if kind == "value":
        lines[at] = f"{key}: {rng.choice(VALUES)}"
    elif kind == "key":
        lines[at] = f"{rng.choice(KEYS)}: {value}"
    elif kind == "double":
        lines.append(f"{rng.choice(KEYS)}: {rng.choice(VALUES)}")
    elif kind == "drop":
        del lines[at]
    elif kind == "indent":
        lines[at] = rng.choice((" ", "\t", "  - ", "    ")) + lines[at]
    text = "\n".join(lines) + "\n"
    data = (rng.choice(WHOLE) if kind == "whole" else text).encode(errors="surrogatepass")
    if kind == "encoding":
        data = text.encode(rng.choice(("utf-16", "utf-32", "utf-16-le", "cp500")))
    if kind == "bytes":
        broken = bytearray(data)
        for _ in range(rng.choice((1, 3, 10))):
            broken[rng.randrange(len(broken))] = rng.randrange(256)
        data = bytes(broken)
    words = (
        ["sweep", "CONFIG", "--seeds", "0:2", "--out", "file/runs"] if name == "sweep" else [name, "--config", "CONFIG"]
    )
    return f"{' '.join(words)}: {data[:300]!r}", lambda: _use(data, words, folder)


def _use(data: bytes, words: list[str], folder: Path) -> str:
    """The command, with an --out below a file so that a configuration that is fine costs no work."""
    (folder / "file").write_bytes(b"")
    (folder / "config.yaml").write_bytes(data)
    words = [str(folder / "config.yaml") if word == "CONFIG" else word for word in words]
    out = [] if "--out" in words else ["--out", str(folder / "file" / "run.npz")]
    return judge.fresh_command(*[word.replace("file/", f"{folder}/file/") for word in words], *out)
