"""Scenes: worlds read from an MJCF, with named parameters. From a file to what the core takes, in order of reading:

``source``     a file, a text or a specification becomes a compiled MuJoCo model; ``urdf``: files as ROS has them
``parts``      every element is read: what touches (``collision``), what acts besides (``forces``), ``records`` of both;
               ``reduction``: in one plane, if all moves in it
``core``       the arrays of the C++ core, in the order of ``layout``; ``fittable``: the numbers that a fit may change
``build``      all of it together, as the fields of ``scene``; ``drives``: other laws for actuators; ``differences``:
               what MuJoCo does in another way
``info``       what ``cmbrl info`` says of a scene; ``writing``: files with fitted values, with joints held or with play
"""

from cmbrl.scene.records import LeftOut, Parameter
from cmbrl.scene.scene import Scene

__all__ = ["LeftOut", "Parameter", "Scene"]
