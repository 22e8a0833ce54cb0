"""A compiled MuJoCo robot as bodies, joints, servos and shapes of a Drake plant, and its state in both layouts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from cmbrl.envs.drake_shapes import add_shapes, filter_pairs
from cmbrl.errors import UserError
from cmbrl.scene.source.mjcf import name_of

_FREE, _BALL, _SLIDE = map(int, (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL, mujoco.mjtJoint.mjJNT_SLIDE))
_PLAIN = tuple(map(int, (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtDyn.mjDYN_NONE)))
_BIASES = tuple(map(int, (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)))


@dataclass
class DrakeRobot:
    """Joints and servos of a Drake plant in MuJoCo's order."""

    plant: Any
    model: mujoco.MjModel
    bodies: list[Any] = field(default_factory=list)
    joints: dict[int, Any] = field(default_factory=dict)  #: by number of the hinge or slide
    roots: dict[int, Any] = field(default_factory=dict)  #: the body of each free joint
    servos: dict[int, Any] = field(default_factory=dict)  #: by number of MuJoCo's actuator

    def put(self, context: Any, q: np.ndarray, v: np.ndarray) -> None:
        """Sets the state q (nq,), v (nv,), in MuJoCo's layout."""
        from pydrake.common.eigen_geometry import Quaternion
        from pydrake.math import RigidTransform, RotationMatrix
        from pydrake.multibody.math import SpatialVelocity

        model = self.model
        for number, body in self.roots.items():
            at, dof = int(model.jnt_qposadr[number]), int(model.jnt_dofadr[number])
            quaternion = q[at + 3 : at + 7] / np.linalg.norm(q[at + 3 : at + 7])
            turned = RotationMatrix(Quaternion(quaternion))
            self.plant.SetFreeBodyPose(context, body, RigidTransform(turned, q[at : at + 3]))
            velocity = SpatialVelocity(turned.multiply(v[dof + 3 : dof + 6]), v[dof : dof + 3])
            self.plant.SetFreeBodySpatialVelocity(context, body, velocity)
        for number, joint in self.joints.items():
            at = int(model.jnt_qposadr[number])
            _put(joint, context, q[at] - model.qpos0[at], v[model.jnt_dofadr[number]])

    def state(self, context: Any) -> tuple[np.ndarray, np.ndarray]:
        """q (nq,), v (nv,) in MuJoCo's layout."""
        model, q, v = self.model, np.zeros(self.model.nq), np.zeros(self.model.nv)
        for number, body in self.roots.items():
            at, dof = int(model.jnt_qposadr[number]), int(model.jnt_dofadr[number])
            pose = self.plant.GetFreeBodyPose(context, body)
            moving = body.EvalSpatialVelocityInWorld(context)
            q[at : at + 3], q[at + 3 : at + 7] = pose.translation(), pose.rotation().ToQuaternion().wxyz()
            v[dof : dof + 3] = moving.translational()
            v[dof + 3 : dof + 6] = pose.rotation().inverse().multiply(moving.rotational())
        for number, joint in self.joints.items():
            at = int(model.jnt_qposadr[number])
            position, velocity = _get(joint, context)
            q[at], v[model.jnt_dofadr[number]] = model.qpos0[at] + position, velocity
        return q, v

    def command(self, context: Any, u: np.ndarray) -> None:
        """Gives the servos their targets, and the motors their forces, for controls u (nu,) in MuJoCo's order."""
        plant, model, count = self.plant, self.model, self.plant.num_actuators()
        target, force = np.zeros(2 * count), np.zeros(count)
        clipped = np.where(model.actuator_ctrllimited, np.clip(u, *model.actuator_ctrlrange.T), u)
        for k, servo in self.servos.items():
            gear, gain = model.actuator_gear[k, 0], model.actuator_gainprm[k, 0]
            pushed = gain * clipped[k] + model.actuator_biasprm[k, 0]
            at, stiffness = servo.input_start(), -model.actuator_biasprm[k, 1]
            if not servo.has_controller():
                force[at] = gear * np.clip(pushed, *_limits(model, k))
            else:
                target[at] = pushed / (stiffness * gear) - model.qpos0[_address(model, k)]
        plant.get_actuation_input_port().FixValue(context, force)
        if any(servo.has_controller() for servo in self.servos.values()):
            from pydrake.multibody.tree import default_model_instance

            plant.get_desired_state_input_port(default_model_instance()).FixValue(context, target)


def build(plant: Any, graph: Any, model: mujoco.MjModel) -> DrakeRobot:
    """Fills ``plant`` and its scene ``graph``, and finishes it.

    Raises UserError for what is not the same there: ball joints, tendons, fluids, other equality constraints than
    ``_add_tie`` has, and actuators other than position servos and motors of one joint.
    """
    _check(model)
    robot = DrakeRobot(plant, model, bodies=[plant.world_body()])
    for body in range(1, model.nbody):
        _add_body(robot, body)
    for k in range(model.nu):
        _add_servo(robot, k)
    _add_rotors(robot)
    for k in range(model.neq):
        _add_tie(robot, k)
    added = add_shapes(plant, model, robot.bodies)
    plant.mutable_gravity_field().set_gravity_vector(model.opt.gravity)
    plant.Finalize()
    filter_pairs(graph, model, added)
    return robot


def _check(model: mujoco.MjModel) -> None:
    for what, count in (
        ("ball joints", int((model.jnt_type == _BALL).sum())),
        ("tendons", model.ntendon),
        ("flexes", model.nflex),
        ("fluids (density or viscosity)", int(model.opt.density > 0 or model.opt.viscosity > 0)),
    ):
        if count:
            raise UserError(f"the simulator drake does not have this robot's {what}: judge it in MuJoCo")


def _add_body(robot: DrakeRobot, body: int) -> None:
    """A body with its joints, in turn as MuJoCo's of one body: each but the last moves a body without mass."""
    from pydrake.math import RigidTransform
    from pydrake.multibody.tree import FixedOffsetFrame, PrismaticJoint, RevoluteJoint, SpatialInertia, WeldJoint

    plant, model = robot.plant, robot.model
    name = f"{name_of(model, 'body', body)}#{body}"
    own = plant.AddRigidBody(name, _inertia(model, body))
    robot.bodies.append(own)
    parent, placed = robot.bodies[int(model.body_parentid[body])], _pose(model.body_pos[body], model.body_quat[body])
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    if not count:
        plant.AddJoint(WeldJoint(f"{name} weld", parent.body_frame(), own.body_frame(), placed))
    for number in range(first, first + count):
        if model.jnt_type[number] == _FREE:
            robot.roots[number] = own
            continue
        last = number == first + count - 1
        child = own if last else plant.AddRigidBody(f"{name} joint {number}", SpatialInertia.Zero())
        anchor = RigidTransform(model.jnt_pos[number])
        frames = [
            plant.AddFrame(FixedOffsetFrame(f"{name} {number} {side}", at.body_frame(), where))
            for side, at, where in (("parent", parent, placed @ anchor), ("child", child, anchor))
        ]
        kind = PrismaticJoint if model.jnt_type[number] == _SLIDE else RevoluteJoint
        damping = float(model.dof_damping[model.jnt_dofadr[number]])
        joint = plant.AddJoint(kind(f"joint {number}", *frames, model.jnt_axis[number], damping=damping))
        if model.jnt_limited[number]:
            low, high = model.jnt_range[number] - model.qpos0[model.jnt_qposadr[number]]
            joint.set_position_limits([low], [high])
        _add_spring(plant, model, number, joint)
        robot.joints[number] = joint
        parent, placed = child, RigidTransform()


def _add_spring(plant: Any, model: mujoco.MjModel, number: int, joint: Any) -> None:
    from pydrake.multibody.tree import PrismaticSpring, RevoluteSpring

    if model.jnt_stiffness[number] > 0:
        at = int(model.jnt_qposadr[number])
        kind = PrismaticSpring if model.jnt_type[number] == _SLIDE else RevoluteSpring
        plant.AddForceElement(kind(joint, float(model.qpos_spring[at] - model.qpos0[at]), model.jnt_stiffness[number]))


def _add_servo(robot: DrakeRobot, k: int) -> None:
    from pydrake.multibody.tree import PdControllerGains

    model, name = robot.model, name_of(robot.model, "actuator", k)
    joint = robot.joints.get(int(model.actuator_trnid[k, 0]))
    _, stiffness, damping = model.actuator_biasprm[k, :3] * (1.0, -1.0, -1.0)
    kinds = model.actuator_trntype[k], model.actuator_gaintype[k], model.actuator_dyntype[k]
    plain = tuple(map(int, kinds)) == _PLAIN and int(model.actuator_biastype[k]) in _BIASES
    if joint is None or not plain or stiffness < 0 or damping < 0 or (damping > 0 and not stiffness):
        raise UserError(
            f"the simulator drake has no actuator such as {name!r}: it takes position servos and motors of one joint"
        )
    gear = abs(float(model.actuator_gear[k, 0]))
    most = gear * float(np.abs(_limits(model, k)).min())
    servo = robot.plant.AddJointActuator(f"actuator {k}", joint, most)
    if stiffness:
        servo.set_controller_gains(PdControllerGains(p=gear**2 * stiffness, d=gear**2 * damping))
    robot.servos[k] = servo


def _add_rotors(robot: DrakeRobot) -> None:
    """Armature, which Drake knows of actuators alone; a joint without one gets an actuator that rests."""
    plant, model = robot.plant, robot.model
    driven = {servo.joint().index(): servo for servo in robot.servos.values()}
    if len(driven) < len(robot.servos):
        raise UserError("the simulator drake takes one actuator a joint, and this robot has joints with several")
    for number, joint in robot.joints.items():
        armature = float(model.dof_armature[model.jnt_dofadr[number]])
        if armature > 0:
            servo = driven.get(joint.index()) or plant.AddJointActuator(f"rotor {number}", joint)
            servo.set_default_rotor_inertia(armature)
            servo.set_default_gear_ratio(1.0)


def _add_tie(robot: DrakeRobot, k: int) -> None:
    """A linear one of two joints, or a ball joint that closes a loop."""
    model, kind = robot.model, mujoco.mjtEq(robot.model.eq_type[k])
    if not model.eq_active0[k]:
        return
    one, other, data = int(model.eq_obj1id[k]), int(model.eq_obj2id[k]), model.eq_data[k]
    if kind == mujoco.mjtEq.mjEQ_JOINT and {one, other} <= robot.joints.keys() and not data[2:5].any():
        robot.plant.AddCouplerConstraint(robot.joints[one], robot.joints[other], data[1], data[0])
    elif kind == mujoco.mjtEq.mjEQ_CONNECT and model.eq_objtype[k] == mujoco.mjtObj.mjOBJ_BODY:
        robot.plant.AddBallConstraint(robot.bodies[one], data[:3], robot.bodies[other], data[3:6])
    else:
        raise UserError(
            f"the simulator drake has no equality constraint such as {name_of(model, 'equality', k)!r}: it takes "
            "linear ones of two joints, and connect of two bodies"
        )


def _limits(model: mujoco.MjModel, k: int) -> np.ndarray:
    """(2,): least and largest force of an actuator before its gear, its joint's limit included."""
    low, high = model.actuator_forcerange[k] if model.actuator_forcelimited[k] else (-np.inf, np.inf)
    joint = int(model.actuator_trnid[k, 0])
    if model.jnt_actfrclimited[joint]:
        gear = model.actuator_gear[k, 0]
        bounds = np.sort(model.jnt_actfrcrange[joint] / gear)
        low, high = max(low, bounds[0]), min(high, bounds[1])
    return np.array([low, high])


def _address(model: mujoco.MjModel, k: int) -> int:
    return int(model.jnt_qposadr[model.actuator_trnid[k, 0]])


def _inertia(model: mujoco.MjModel, body: int) -> Any:
    from pydrake.multibody.tree import RotationalInertia, SpatialInertia

    if model.body_mass[body] <= 0:
        return SpatialInertia.Zero()
    turn = _pose(np.zeros(3), model.body_iquat[body]).rotation()
    about_centre = RotationalInertia(*model.body_inertia[body]).ReExpress(turn)
    return SpatialInertia.MakeFromCentralInertia(float(model.body_mass[body]), model.body_ipos[body], about_centre)


def _pose(position: np.ndarray, quaternion: np.ndarray) -> Any:
    from pydrake.common.eigen_geometry import Quaternion
    from pydrake.math import RigidTransform, RotationMatrix

    return RigidTransform(RotationMatrix(Quaternion(quaternion / np.linalg.norm(quaternion))), position)


def _put(joint: Any, context: Any, position: float, velocity: float) -> None:
    if hasattr(joint, "set_angle"):
        joint.set_angle(context, position)
        joint.set_angular_rate(context, velocity)
    else:
        joint.set_translation(context, position)
        joint.set_translation_rate(context, velocity)


def _get(joint: Any, context: Any) -> tuple[float, float]:
    if hasattr(joint, "get_angle"):
        return joint.get_angle(context), joint.get_angular_rate(context)
    return joint.get_translation(context), joint.get_translation_rate(context)
