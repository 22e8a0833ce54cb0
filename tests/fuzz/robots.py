"""Random robots as MJCF text, from a seed: elements of every kind that a user's file may have, in any combination.

A file draws which themes it has, so that simple files come up as well as crowded ones. MuJoCo decides what is valid.
"""

from __future__ import annotations

import numpy as np

THEMES = (
    "actfrc", "activation", "adhesion", "armature", "ball", "compiler", "condim", "contype", "curved", "direct",
    "disabled", "elliptic", "equality", "fluid", "free", "gravcomp", "limits", "linkage", "loose", "loss", "margin",
    "mesh", "motor", "multi", "override", "pairs", "poly", "refsafe", "servo", "site", "skewed", "slide", "softness",
    "spring", "tendon", "varying", "wrap",
)  # fmt: skip
SHARE = 0.35  # of files, for each theme
INTEGRATORS = ("Euler", "implicit", "implicitfast", "RK4")
BRICK = "-.05 -.05 -.03 .05 -.05 -.03 .05 .05 -.03 -.05 .05 -.03 -.05 -.05 .03 .05 -.05 .03 .04 .05 .03 -.05 .05 .03"


class Robots:
    """One file; ``text`` may be called once."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.themes = {theme for theme in THEMES if self.rng.random() < SHARE}
        self.joints: list[str] = []  # hinges and slides
        self.balls: list[str] = []
        self.bodies: list[str] = []
        self.sites: list[str] = []
        self.geoms: list[str] = []
        self.round: list[str] = []  # spheres, which tendons may go around
        self.tendons: list[str] = []
        self.count = 0

    def text(self) -> str:
        trees = "".join(self.body(int(self.rng.integers(0, 4)), root=True) for _ in range(self.rng.integers(1, 3)))
        loose = "".join(
            f'<body pos="{self.u(-0.5, 0.5, 2)} .3"><freejoint/>{self.geom()}</body>'
            for _ in range(2 * self.has("loose"))
        )
        floor = f'<geom name="floor" type="plane" size="5 5 .1"{self.surface()}/>'
        compiler = self.one_of("", ' balanceinertia="true"', ' settotalmass="5"', ' eulerseq="zyx"') * self.has(
            "compiler"
        )
        tendons, equalities = self.tendon_elements(), self.equality_elements()
        head = (
            f'<compiler angle="radian"{compiler}/>{self.option()}<asset><mesh name="brick" vertex="{BRICK}"/></asset>'
        )
        rest = self.contacts() + tendons + equalities + self.actuators()
        return f"<mujoco>{head}<worldbody>{floor}{loose}{trees}</worldbody>{rest}</mujoco>"

    # numbers and words

    def u(self, low: float, high: float, count: int = 1) -> str:
        return " ".join(f"{x:.4g}" for x in self.rng.uniform(low, high, count))

    def log(self, low: float, high: float) -> str:
        return f"{np.exp(self.rng.uniform(np.log(low), np.log(high))):.4g}"

    def one_of(self, *words: str) -> str:
        return words[self.rng.integers(len(words))]

    def has(self, theme: str, share: float = 0.6) -> bool:
        return bool(self.rng.random() < share) and theme in self.themes

    def some(self, share: float, attribute: str) -> str:
        return f" {attribute}" * bool(self.rng.random() < share)

    def name(self, kind: str) -> str:
        self.count += 1
        return f"{kind}{self.count}"

    def turn(self) -> str:
        return self.one_of("", f' euler="{self.u(-1, 1, 3)}"', f' quat="{self.u(-1, 1, 4)}"')

    def soft(self, of: str) -> str:
        """solref and solimp of limits, dry friction, contacts or equalities."""
        if self.has("direct", 0.3):
            return f' solref{of}="-{self.log(100, 5000)} -{self.log(5, 100)}"'
        shape = (
            f"{self.u(0.5, 0.9)} {self.u(0.9, 0.99)} {self.log(0.0005, 0.02)} {self.u(0.2, 0.8)} {self.one_of(*'123')}"
        )
        return f' solref{of}="{self.log(0.004, 0.1)} {self.u(0.5, 1.5)}" solimp{of}="{shape}"' * self.has("softness")

    # bodies

    def body(self, depth: int, root: bool = False) -> str:
        name = self.name("body")
        self.bodies.append(name)
        place = f"{self.u(-0.15, 0.15, 2)} {self.u(0.3, 0.6)}" if root else self.u(-0.2, 0.2, 3)
        lift = f' gravcomp="{self.u(0.3, 1.2)}"' * self.has("gravcomp", 0.4)
        inside = (
            "<freejoint/>"
            if root and self.has("free", 0.8)
            else self.some_joints()
            if root or self.rng.random() > 0.15
            else ""
        )
        inside += "".join(self.geom() for _ in range(self.rng.integers(1, 3)))
        inside += "".join(self.site() for _ in range(self.rng.integers(0, 3)))
        if depth:
            inside += "".join(self.body(depth - 1) for _ in range(self.rng.integers(1, 3)))
        return f'<body name="{name}" pos="{place}"{self.turn()}{lift}>{inside}</body>'

    def some_joints(self) -> str:
        if self.has("ball", 0.4):
            return self.joint("ball")
        count = self.rng.integers(1, 4) if self.has("multi") else 1
        axes = self.rng.permutation(["1 0 0", "0 1 0", "0 0 1"])[:count]
        return "".join(self.joint("slide" if self.has("slide", 0.5) else "hinge", axis) for axis in axes)

    def joint(self, kind: str, axis: str = "1 0 0") -> str:
        name = self.name("joint")
        (self.balls if kind == "ball" else self.joints).append(name)
        out = f'<joint name="{name}" type="{kind}" axis="{axis}"'
        if self.has("limits"):
            out += f' range="{"0" if kind == "ball" else self.u(-0.8, -0.02)} {self.u(0.05, 0.8)}"{self.soft("limit")}'
            out += f' margin="{self.u(0, 0.03)}"' * self.has("margin")
        if self.has("spring"):
            out += f' stiffness="{self.log(0.5, 50)}"' + f' springref="{self.u(-0.3, 0.3)}"' * (kind != "ball")
        out += f' damping="{self.log(0.005, 5)}{self.has("poly") * f" {self.log(0.01, 0.5)}"}"' * (
            self.rng.random() < 0.7
        )
        out += f' armature="{self.log(0.0005, 0.1)}"' * self.has("armature")
        out += f' frictionloss="{self.log(0.01, 1)}"{self.soft("friction")}' if self.has("loss") else ""
        out += f' actuatorfrcrange="-{self.log(0.5, 10)} {self.log(0.5, 10)}"' * (kind != "ball" and self.has("actfrc"))
        return out + "/>"

    def geom(self) -> str:
        name = self.name("geom")
        self.geoms.append(name)
        curved = ("cylinder", "ellipsoid") * ("curved" in self.themes)
        kind = self.one_of("sphere", "capsule", "box", *curved, *["mesh"] * ("mesh" in self.themes))
        self.round += [name] * (kind == "sphere")
        shape = 'mesh="brick"' if kind == "mesh" else f'size="{self.u(0.02, 0.08, 3)}"'
        weight = self.one_of("", f' mass="{self.log(0.1, 3)}"', f' density="{self.log(500, 4000)}"')
        pose = f'pos="{self.u(-0.08, 0.08, 3)}"{self.turn()}'
        weight += ' fluidshape="ellipsoid"' * ("fluid" in self.themes and self.count % 3 == 0)
        return f'<geom name="{name}" type="{kind}" {shape} {pose}{weight}{self.surface()}/>'

    def surface(self) -> str:
        out = f' condim="{self.one_of("1", "3", "4", "6")}"' * self.has("condim")
        out += self.some(0.6, f'friction="{self.u(0.1, 1.5)} .02 .001"')
        out += self.some(0.2, f'priority="1" solmix="{self.log(0.1, 5)}"')
        out += f' margin="{self.u(0, 0.02)}" gap="{self.u(0, 0.01)}"' * self.has("margin", 0.3)
        out += f' contype="{self.one_of("0", "1", "2")}" conaffinity="{self.one_of("1", "3")}"' * self.has("contype")
        return out + self.soft("")

    def site(self) -> str:
        self.sites.append(self.name("site"))
        return f'<site name="{self.sites[-1]}" pos="{self.u(-0.1, 0.1, 3)}"{self.turn()}/>'

    # what acts between them

    def contacts(self) -> str:
        if not self.has("pairs") or len(self.geoms) < 2:
            return ""
        first, second = self.rng.permutation(self.geoms)[:2]
        slides, rolls = [self.u(0.1, 1)] * 2, [self.log(0.0001, 0.01)] * 2
        if self.has("skewed", 1):
            slides, rolls = [self.u(0.1, 1) for _ in range(2)], [self.log(0.0001, 0.01) for _ in range(2)]
        friction, dim = " ".join([*slides, ".01", *rolls]), self.one_of("3", "4", "6")
        pair = f'<pair geom1="{first}" geom2="{second}" friction="{friction}" condim="{dim}"{self.soft("")}/>'
        one, other = self.rng.permutation([*self.bodies, "world"])[:2]
        return f'<contact>{pair}<exclude body1="{one}" body2="{other}"/></contact>'

    def tendon_elements(self) -> str:
        out = ""
        if self.joints and self.has("tendon"):
            chosen = self.rng.permutation(self.joints)[:1]  # MuJoCo leaves out what others couple of two branches
            path = "".join(f'<joint joint="{joint}" coef="{self.u(-1.5, 1.5)}"/>' for joint in chosen)
            limits = f'range="{self.u(-0.5, -0.05)} {self.u(0.05, 0.5)}"'
            out += f'<fixed name="{self.tendon()}" {limits}{self.pull()}>{path}</fixed>'
        if len(self.sites) > 1 and self.has("tendon"):
            first, *rest = self.rng.permutation(self.sites)[: self.rng.integers(2, 4)]
            around = f'<geom geom="{self.one_of(*self.round)}"/>' if self.round and self.has("wrap") else ""
            path = f'<site site="{first}"/>' + "".join(f'{around}<site site="{site}"/>' for site in rest)
            out += f'<spatial name="{self.tendon()}" range="0 {self.u(0.2, 0.7)}"{self.pull()}>{path}</spatial>'
        return f"<tendon>{out}</tendon>" * bool(out)

    def tendon(self) -> str:
        self.tendons.append(self.name("tendon"))
        return self.tendons[-1]

    def pull(self) -> str:
        spring = f'stiffness="{self.log(1, 100)}" springlength="{self.u(0, 0.1)} {self.u(0.12, 0.3)}"'
        out = self.some(0.5, spring) + self.some(0.4, f'damping="{self.log(0.01, 2)}"') + self.soft("limit")
        return out + f' frictionloss="{self.log(0.05, 2)}"{self.soft("friction")}' * self.has("loss")

    def equality_elements(self) -> str:
        if not self.has("equality", 0.9):
            return ""
        body, found, idle = self.one_of(*self.bodies), [], self.some(0.3, 'active="false"')
        found.append(f'<connect body1="{body}" anchor="{self.u(-0.1, 0.1, 3)}"{self.soft("")}{idle}/>')
        pose = f'relpose="{self.u(-0.2, 0.2, 3)} {self.u(-1, 1, 4)}" torquescale="{self.log(0.2, 3)}"'
        found.append(f'<weld body1="{body}" {pose}/>')
        if len(self.joints) > 1:
            one, other = self.rng.permutation(self.joints)[:2]
            curve = f"{self.u(-0.3, 0.3)} {self.u(-1.5, 1.5)} {self.u(-1, 1)} 0 {self.u(-0.1, 0.1)}"
            found.append(f'<joint joint1="{one}" joint2="{other}" polycoef="{curve}"{self.soft("")}/>')
        if len(self.sites) > 1:
            one, other = self.rng.permutation(self.sites)[:2]
            found.append(f'<{self.one_of("connect", "weld")} site1="{one}" site2="{other}"{self.soft("")}/>')
        return f"<equality>{self.one_of(*found)}</equality>"

    def actuators(self) -> str:
        out = ""
        for _ in range(self.rng.integers(1, 5)):
            targets = [f'joint="{self.one_of(*self.joints)}"'] * 2 if self.joints else []
            targets += [f'tendon="{self.one_of(*self.tendons)}"'] if self.tendons else []
            if targets:
                out += self.actuator(self.one_of(*targets))
        if self.sites and self.has("site"):
            out += f'<motor site="{self.one_of(*self.sites)}" gear="{self.u(-2, 2, 6)}" ctrlrange="-1 1"/>'
        if self.balls:
            out += f'<motor joint="{self.one_of(*self.balls)}" gear="{self.u(-2, 2, 3)}" ctrlrange="-1 1"/>'
        if self.has("linkage", 1):
            out += "".join(self.actuator(target) for target in self.linkages())
        if self.has("adhesion", 1):
            out += f'<adhesion body="{self.one_of(*self.bodies, "world")}" gain="{self.log(1, 30)}" ctrlrange="0 1"/>'
        return f"<actuator>{out}</actuator>"

    def linkages(self) -> list[str]:
        """What actuators drive between two sites, or of a ball joint."""
        found = [f'{self.one_of("joint", "jointinparent")}="{self.one_of(*self.balls)}"'] * bool(self.balls)
        if len(self.sites) > 1:
            one, other = self.rng.permutation(self.sites)[:2]
            found += [f'site="{one}" refsite="{other}"', f'site="{one}"']
            found += [f'cranksite="{one}" slidersite="{other}" cranklength="{self.log(0.05, 1)}"']
        return found

    def actuator(self, target: str) -> str:
        gear = f' gear="{self.one_of("-", "")}{self.log(0.3, 3)}"'
        if target.startswith("site"):
            gear = f' gear="{self.one_of("0 0 0", self.u(-2, 2, 3))} {self.one_of("0 0 0", self.u(-2, 2, 3))}"'
        common = gear + self.some(0.6, f'ctrlrange="-{self.log(0.3, 3)} {self.log(0.3, 3)}"')
        common += self.some(0.3, f'forcerange="-{self.log(1, 30)} {self.log(1, 30)}"')
        common += self.some(0.3, f'group="{self.one_of("0", "1")}"')
        common += self.some(0.2, f'armature="{self.log(0.001, 0.02)}" damping="{self.log(0.001, 0.5)}"') * (
            "joint=" in target
        )
        bias = f'biastype="affine" biasprm="{self.u(-1, 1)} {self.u(-30, 0)} {self.u(-2, 0)}"'
        kinds = [f"<motor {target}{common}/>"]
        if self.has("servo", 1):
            kinds += [f'<position {target} kp="{self.log(2, 200)}" kv="{self.log(0.1, 5)}"{common}/>']
            kinds += [f'<velocity {target} kv="{self.log(0.2, 10)}"{common}/>', f"<general {target} {bias}{common}/>"]
        if self.has("activation", 1):
            limits = self.some(0.5, f'actlimited="true" actrange="-{self.log(0.1, 1)} {self.log(0.1, 1)}"')
            kind, early = self.one_of("filter", "filterexact", "integrator"), self.some(0.3, 'actearly="true"')
            kinds += [
                f'<general {target} dyntype="{kind}" dynprm="{self.log(0.01, 0.3)}" {bias}{limits}{early}{common}/>'
            ]
            kinds += [f'<cylinder {target} timeconst="{self.log(0.01, 0.3)}" area="{self.log(0.3, 3)}"{common}/>']
        if self.has("motor", 1):
            shape = f'motorconst="{self.log(0.05, 0.5)}" resistance="{self.log(0.5, 5)}"{gear}'
            inputs = self.one_of("pos", "pos vel", "vel ff", "pos vel ff")
            gains = f'controller="{self.log(2, 200)} 0 {self.log(0.1, 5)} 0 0 0"'
            kinds += [f'<dcmotor {target} {shape} cogging="{self.u(0, 0.3)} 6 {self.u(-1, 1)}"/>']
            kinds += [
                f'<dcmotor {target} {shape} input="{inputs} voltage" {gains} saturation="{self.log(1, 30)} 0 0"/>'
            ]
            kinds += [f'<pid {target} kp="{self.log(2, 200)}" kv="{self.log(0.1, 5)}" input="{inputs}"{common}/>']
        if self.has("varying", 1):
            kinds += [f'<general {target} gaintype="affine" gainprm="{self.u(1, 9)} -2 -.3"{common}/>']
            kinds += [f'<damper {target} kv="{self.log(0.2, 5)}" ctrlrange="0 {self.log(0.3, 3)}"{gear}/>']
        return self.one_of(*kinds)

    def option(self) -> str:
        out = f'timestep="{self.log(0.0005, 0.008)}" integrator="{self.one_of(*INTEGRATORS)}"'
        out += f' cone="elliptic" impratio="{self.log(0.5, 20)}"' * self.has("elliptic")
        out += f' density="{self.log(1, 1000)}" viscosity="{self.log(1e-5, 0.1)}" wind="{self.u(-3, 3, 3)}"' * self.has(
            "fluid"
        )
        out += ' o_margin="0" o_solref=".03 1" o_friction=".7 .7 .005 .0001 .0001"' * ("override" in self.themes)
        out += ' actuatorgroupdisable="1"' * self.has("disabled")
        off = ("spring", "damper", "gravity", "clampctrl", "filterparent", "actuation", "eulerdamp")
        flags = f' {self.one_of(*off)}="disable"' * self.has("disabled") + ' refsafe="disable"' * (
            "refsafe" in self.themes
        )
        flags += ' override="enable"' * ("override" in self.themes)
        return f"<option {out}><flag{flags}/></option>"
