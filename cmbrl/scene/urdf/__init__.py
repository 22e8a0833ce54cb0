"""From a URDF to an MJCF with everything that a URDF does not say: base, floor, actuators."""

from cmbrl.scene.urdf.convert import Conversion as Conversion
from cmbrl.scene.urdf.convert import convert as convert
