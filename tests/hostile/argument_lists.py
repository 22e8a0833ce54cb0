"""Hostile command lines: words replaced, repeated, dropped and inserted."""

from __future__ import annotations

import os
import random
from pathlib import Path

from . import judge

LINES = (
    "info hopper", "info hopper --json", "info scene.xml --ignore tendon --contact-law rigid",
    "record hopper --steps 3 --out log.npz --seed 1",
    "record hopper --steps 3 --out log --behaviour pd", "record cube_toss --steps 3 --data text.xml --out log.npz",
    "import text.xml --scene scene.xml --map a=b.position:deg --joints a b --rate 200 --gap 3 --kp 2 --out log.npz",
    "fit hopper --data nowhere.npz --out run --set mass.torso=3.6 --groups friction --horizon 2 --time-step 0.002",
    "fit scene.xml --data text.xml --out run --method cma --integrator midpoint --time-limit 3 --threads 1",
    "error --data nowhere.npz --scene hopper hold nominal --horizons 1 5 --contact-gap 0.002",
    "train hopper --out text.xml/run --algorithm shac --set critic_epochs=4 --set actor_hidden=32,32 --iterations 3",
    "train hopper --out text.xml/run --smoothing barrier:kappa=1e-4 --derivative gaussian:length=1e-3 --seed 3",
    "train cheetah --out text.xml/run --algorithm fopg --derivative bundle:samples=4,position=1e-3",
    "train hopper --out text.xml/run --algorithm sac --model real --set batch=32 --checkpoint-seconds 5",
    "evaluate nowhere --model nominal --episodes 3 --smoothing exact", "play nowhere --out clip.gif --seconds 2",
    "export nowhere --onnx p.onnx",
    "sweep config.yaml --seeds 0:3 --out text.xml/seeds --jobs 2", "bench speed --scene nowhere --quick",
    "bench stale nowhere", "--version",
)  # fmt: skip
WORDS = (
    "", " ", "-", "--", "-1", "0", "1", "1.5", "nan", "inf", "-inf", "1e300", "1e400", "-1e-300", "9" * 5000,
    "-" + "9" * 5000, "0x10", "1_0",
    "１", "½", "99999999999", "\x00", "\udc80", "\n", "a\nb", "\x1b[31m", "x" * 5000, "/" * 5000, "a/" * 2500 + "b.xml",
    "x" * 5000 + ".npz",
    "x" * 300 + ".xml", "~", ".", "..", "/", "/dev/null", "/dev/zero", "/proc/self/mem", "pipe", "pipe.xml", "pipe.npz",
    "folder", "folder.npz",
    "folder.xml", "text.xml", "scene.xml", "None", "[1]", "{}", "a=b", "=", "a=", "=b", "mass.torso=nan",
    "mass.torso=1e300", "mass.torso=",
    "critic_epochs=1e300", "critic_epochs=2147483647", "actor_hidden=2147483647", "actor_hidden=", "actor_hidden=0",
    "hidden=1,1e9", "window=inf",
    "window=1e300", "window=nan", "discount=1e300", "discount=inf", "environments=1e9", "horizon=1e9", "batch=1e300",
    "buffer=2e9", "clip=nan",
    "actor_rate=inf", "tame=-1", "barrier:kappa=1e300", "barrier:kappa=nan", "barrier", "barrier:", "barrier:kappa",
    "gaussian:length=inf", "bcg:branches=1e300",
    "barrier:length=1e-320", "gaussian:length=1e-300,floor=1e300", "bundle:samples=1e9", "bundle:samples=-1",
    "bundle:position=inf", "bcg:length=0.5",
    "exact:speed=1e300", "exact:speed=0", "0:99999999999", "0:0", "3:1", ":", "0:" + "9" * 5000, "1,1", "minari:",
    "minari:../x", "minari:a/b",
    "--help", "-h", "--config", "--json", "--seed", "--set", "--resume", "--ignore", "--out", "--quick", "--version",
    "--threads", "257", "all", "stale",
    "hopper", "nominal", "real", "ensemble", "loop", "mbpo", "policy", "%s", "$HOME", "`id`", "*",
)  # fmt: skip
SCENE = """<mujoco><worldbody><geom type="plane" size="1 1 1"/>
<body pos="0 0 1"><freejoint/><geom size=".1"/></body></worldbody></mujoco>"""


def draw(rng: random.Random, folder: Path) -> judge.Case:
    """A command line with one to three words changed."""
    words = rng.choice(LINES).split()
    for _ in range(rng.choice((1, 1, 2, 3))):
        at = rng.randrange(len(words))
        kind = rng.choice(("replace", "replace", "replace", "insert", "drop", "double", "swap"))
        if kind == "replace":
            words[at] = rng.choice(WORDS)
        elif kind == "insert":
            words.insert(at + 1, rng.choice(WORDS))
        elif kind == "drop" and len(words) > 1:
            del words[at]
        elif kind == "double":
            words.insert(at, words[at])
        elif kind == "swap":
            other = rng.randrange(len(words))
            words[at], words[other] = words[other], words[at]
    if "bench" in words and not {"nowhere", "stale"} & set(words):
        words += ["--scene", "nowhere"]  # a study is right, and takes minutes
    if "train" in words:
        words += ["--out", "text.xml/run"]
    return str([word[:80] for word in words]), lambda: judge.fresh_command(*words, furnish=_furnish)


def _furnish(place: Path) -> None:
    """A scene, a text that is none, a configuration, pipes and folders."""
    (place / "scene.xml").write_text(SCENE, encoding="utf-8")
    (place / "text.xml").write_text("dear diary", encoding="utf-8")
    (place / "config.yaml").write_text("command: fit\nsource: hopper\ndata: nowhere.npz\n", encoding="utf-8")
    for name in ("pipe", "pipe.xml", "pipe.npz"):
        os.mkfifo(place / name)
    for name in ("folder", "folder.npz", "folder.xml"):
        (place / name).mkdir()
