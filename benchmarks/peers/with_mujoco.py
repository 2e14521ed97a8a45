"""MuJoCo: all bodies in one model, each on a free joint, stepped by one C call.

Everything that a free body does not need is disabled (contacts, constraints, passive forces,
sensors, and gravity and actuation where nothing acts). The body frame is the rotor frame, so that
MuJoCo takes its short cut for diagonal mass matrices.

Constant world forces must turn with the body inside all four stages of RK4, and MuJoCo has no such
force that is cheap: `xfrc_applied` acts at the centre of mass, and an actuator on a site with a
`refsite` fixed in the world is right (to 1e-15 rad) but forms Jacobians over all bodies: six times
the cost for 100 bodies, and growing with their number. So the pushes are put
into `qfrc_applied` by a control callback, a compiled Numba function that MuJoCo calls by address
at every stage without entering Python.

Traps: the arena must be sized by hand for thousands of bodies. The compiler rejects flat bodies
whose moments miss the triangle inequality by rounding, so it is given spheres and the true masses
and moments follow by `mj_setConst`. An unstable run is reset to its start, with a line in a file
MUJOCO_LOG.TXT and no error, unless `autoreset` is disabled and warnings have a handler: here it
ends in NaN. Handlers and callbacks are global to the process: they are put back.
"""

from functools import cache

import numpy as np

from particlerb.compiled.threads import THREADS

from .scene import (
    Course,
    Result,
    Scene,
    absent,
    equal_steps,
    loads,
    needs_solid_bodies,
    result,
    stops,
    to_rotor,
    to_world,
)

NAME = "MuJoCo"
ADAPTIVE = False
HOLDS = ("joints",)
VARIANTS = {
    "Euler": (0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001),
    "implicitfast": (0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001),
    "RK4": (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002),
}
CONTACT = {name: VARIANTS[name] for name in ("implicitfast", "RK4")}
OTHERWISE = (
    "springs of hooke are softer by 1 %, between two bodies by m_eff/m, other contacts critically"
    " damped, as stiff as the step bears; what rests creeps"
)
STORES = True  # whether the energy of contacts is in springs like ours

table = np.zeros(4, np.uintp)  # where the callback finds the number of bodies and three arrays


def missing() -> str | None:
    """Why MuJoCo cannot be used here."""
    return absent("mujoco", "numba")


def refusal(scene: Scene) -> str | None:
    """Why MuJoCo cannot hold the scene."""
    if scene.joints is not None and (scene.pushes or not scene.model):
        return "it is given joints with gravity alone, in a model that it can hold"
    return needs_solid_bodies(scene, NAME)


def model_of(scene: Scene):
    """Model with one free body per row of the scene, and its data at the start."""
    import mujoco

    n = len(scene.mass)
    # 4 kB a body: stack and sparse factors of six degrees of freedom, with room to spare.
    body = '<body><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
    memory = f'<size memory="{16 + 4 * n // 1024}M"/>'
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco>{memory}<worldbody>{body * n}</worldbody></mujoco>"
    )
    model.body_mass[1:], model.body_inertia[1:] = scene.mass, scene.inertia
    model.opt.gravity[:] = scene.gravity
    off = mujoco.mjtDisableBit
    flags = [
        off.mjDSBL_CONSTRAINT,
        off.mjDSBL_CONTACT,
        off.mjDSBL_EQUALITY,
        off.mjDSBL_FRICTIONLOSS,
        off.mjDSBL_LIMIT,
        off.mjDSBL_SPRING,
        off.mjDSBL_DAMPER,
        off.mjDSBL_CLAMPCTRL,
        off.mjDSBL_WARMSTART,
        off.mjDSBL_SENSOR,
        off.mjDSBL_MIDPHASE,
        off.mjDSBL_EULERDAMP,
        off.mjDSBL_ISLAND,
        off.mjDSBL_AUTORESET,
    ]
    if not scene.gravity.any():
        flags.append(off.mjDSBL_GRAVITY)
    if not scene.pushes:
        flags.append(off.mjDSBL_ACTUATION)
    for flag in flags:
        model.opt.disableflags |= int(flag)
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    mujoco.mj_resetData(model, data)
    x, v = data.qpos.reshape(n, 7), data.qvel.reshape(n, 6)
    x[:, :3], x[:, 3:] = scene.position, scene.orientation
    # Of a free joint, the linear velocity is in the world frame and the angular one in the body's.
    v[:, :3], v[:, 3:] = scene.velocity, to_rotor(scene.orientation, scene.angular_velocity)
    return model, data


@cache
def compiled_callback():
    """Function of (model, data) that writes force and torque of the pushes into `qfrc_applied`."""
    from numba import carray, cfunc, types

    from .rotation import doubles_at, matrix, torque

    address = table.ctypes.data

    @cfunc(types.void(types.voidptr, types.voidptr), error_model="numpy", fastmath={"contract"})
    def push(model, data):
        # The table holds integers: they are read through a pointer to their own address.
        entries = carray(doubles_at(address), 4).view(np.uintp)
        n = entries[0]
        q = carray(doubles_at(entries[1]), (n + 1, 4))  # of the world, then of the bodies
        loads = carray(doubles_at(entries[2]), (n, 4, 3))  # rows of G, and the net force
        applied = carray(doubles_at(entries[3]), (n, 6))  # force, world; torque, body frame
        for b in range(n):
            G = loads[b]
            R = matrix(q[b + 1, 0], q[b + 1, 1], q[b + 1, 2], q[b + 1, 3])
            t = torque(R, G[0], G[1], G[2])
            for k in range(3):
                applied[b, k] = G[3, k]
                applied[b, 3 + k] = t[k]

    return push


def run_mechanism(scene: Scene, variant: str, step: float) -> Result:
    """Integrate bodies with joints."""
    found = course(scene._replace(times=np.array([scene.t_end])), variant, step)
    return result(scene, found.seconds, *(values[0] for values in found[1:]))


def course(scene: Scene, variant: str, step: float) -> Course:
    """Integrate a model, its equalities and contacts without a spring as stiff as the step lets."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(scene.model)
    number, model.opt.timestep = stops(scene, step)
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{variant.upper()}")
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    for limits in (model.eq_solref, model.geom_solref):
        limits[limits[:, 0] > 0.0, 0] = 2.0 * model.opt.timestep
    data = mujoco.MjData(model)
    own = [model.body(name).id for name in scene.names]
    warn = mujoco.get_mju_user_warning()
    seconds, rows = 0.0, []
    try:
        mujoco.set_mju_user_warning(lambda text: None)
        mujoco.mj_step(model, data, 3)  # touches all memory once
        mujoco.mj_resetDataKeyframe(model, data, 0)
        for _ in scene.times:
            started = THREADS.local.clock()
            mujoco.mj_step(model, data, number)
            seconds += THREADS.local.clock() - started
            rows.append(pose_and_speed(model, data, own))
    finally:
        mujoco.set_mju_user_warning(warn)
    x, q, v, w = (np.array(column) for column in zip(*rows, strict=True))
    r = scene.rotor_frame
    scalar = q[..., :1] * r[:, :1] - (q[..., 1:] * r[:, 1:]).sum(axis=-1, keepdims=True)
    rest = q[..., :1] * r[:, 1:] + r[:, :1] * q[..., 1:] + np.cross(q[..., 1:], r[:, 1:])
    turned = np.concatenate([scalar, rest], axis=-1)
    pairs = zip(turned, w, strict=True)
    L = [to_world(a, scene.inertia * to_rotor(a, spin)) for a, spin in pairs]
    return Course(seconds, x, turned, v, np.array(L))


def pose_and_speed(model, data, own: list[int]) -> tuple[np.ndarray, ...]:
    """Centres, orientations, velocities and angular velocities of bodies, world frame."""
    import mujoco

    for part in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
        part(model, data)
    speeds, kind = np.zeros((len(own), 6)), mujoco.mjtObj.mjOBJ_BODY
    for row, body in zip(speeds, own, strict=True):
        mujoco.mj_objectVelocity(model, data, kind, body, row, 0)
    return data.xpos[own], data.xquat[own], speeds[:, 3:], speeds[:, :3]


def run(scene: Scene, variant: str, step: float) -> Result:
    """Integrate the scene.

    Parameters
    ----------
    variant : str
        `Euler`, `implicitfast` or `RK4`.
    step : float
        Step [s]; reduced a little so that the last one ends at `t_end`.
    """
    import mujoco

    if scene.model:
        return run_mechanism(scene, variant, step)
    model, data = model_of(scene)
    number, model.opt.timestep = equal_steps(scene, step)
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{variant.upper()}")
    force, tensor = loads(scene)
    n = len(scene.mass)
    rows = np.concatenate([tensor, force[:, None]], axis=1)
    start = [array.copy() for array in (data.qpos, data.qvel)]
    warn = mujoco.get_mju_user_warning()
    try:
        mujoco.set_mju_user_warning(lambda text: None)
        if scene.pushes:
            table[:] = (
                n,
                data.xquat.ctypes.data,
                rows.ctypes.data,
                data.qfrc_applied.ctypes.data,
            )
            mujoco.set_mjcb_control(compiled_callback().ctypes)
        mujoco.mj_step(model, data, 3)  # touches all memory once
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = start
        started = THREADS.local.clock()
        mujoco.mj_step(model, data, number)
        seconds = THREADS.local.clock() - started
    finally:
        mujoco.set_mju_user_warning(warn)
        mujoco.set_mjcb_control(None)
    x, v = data.qpos.reshape(n, 7), data.qvel.reshape(n, 6)
    L = to_world(x[:, 3:], scene.inertia * v[:, 3:])
    return result(scene, seconds, x[:, :3].copy(), x[:, 3:], v[:, :3], L)
