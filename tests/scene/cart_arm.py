"""An arm on a cart, with a servo and feet, whose numbers a test may change."""

from __future__ import annotations

from cmbrl.scene import Scene

from .conftest import Load

WORLD = (
    '<geom name="floor" type="plane" size="1 1 1" pos="0 0 {floor}"/>'
    '<body name="cart" pos="0 0 1">'
    '<joint name="x" type="slide" axis="1 0 0" damping="{damping}" stiffness="{stiffness}"/>'
    '<inertial pos="{com} 0 0" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>'
    '<body name="arm"><joint name="h" axis="0 1 0" armature="{armature}" frictionloss="{loss}"/>'
    '<geom name="rod" type="capsule" size=".1" fromto="0 0 0 1 0 0" friction="{friction}" solref="{time} 1" '
    'solimp="{low} {high} {width}" mass="1"/>'
    "</body></body>"
)


VALUES = {
    "floor": 0.0, "damping": 2.0, "stiffness": 3.0, "com": 0.0, "mass": 2.0, "inertia": 0.1, "armature": 0.5,
    "loss": 0.2, "friction": 1.5, "time": 0.05, "gear": 10.0, "g": -9.81, "across": 0.0,
    "kp": 7.0, "kv": 2.0, "low": 0.8, "high": 0.96, "width": 0.003,
}  # fmt: skip


def scene_with(load: Load, contact_law: str = "mujoco", **changes: float) -> Scene:
    values = VALUES | changes
    rest = (
        '<option gravity="{across} 0 {g}"/><actuator><position joint="h" gear="{gear}" kp="{kp}" kv="{kv}"/></actuator>'
    )
    return load(WORLD.format(**values), rest.format(**values), contact_law=contact_law)[0]


def column(scene: Scene, name: str) -> int:
    return [p.name for p in scene.parameters].index(name)
