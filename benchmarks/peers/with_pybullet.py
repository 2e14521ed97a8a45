"""PyBullet in both of its forms of a body: `btMultiBody` (its default) and `btRigidBody`.

The two treat the gyroscopic term explicitly and implicitly, and both are of order 1. Without pushes
64 steps go by in one call, as sub-steps of a longer step: the same motion to the bit, with less of
Python in it. A push needs the body's present position and orientation, then `applyExternalForce`
before each step; those Python calls are part of the time, since PyBullet offers no other way.

Masses, moments and forces of each body are divided by its largest moment, which changes no motion:
the implicit gyroscopic term has an absolute threshold and stops at moments of 1e-12 kg m².

Traps: a `btRigidBody` (`useMaximalCoordinates`) without a shape never moves, so each gets a tiny
sphere that meets nothing. Its inertia in the world frame is that of the sphere until a first step
and follows no reset of the orientation, so the warm-up is made at rest in the starting pose.
`changeDynamics` needs mass and moments in the same call, and damping, which is on by default, set
to zero. `btMultiBody` clamps its speeds at 100 unless told otherwise, and `btRigidBody` its spin at
a quarter turn a step. `multiplyTransforms` rounds to single precision. At short steps a body
loses its bounce to what slows it before it touches, unless `contactProcessingThreshold` is 0.
Bullet takes the quaternion scalar last. The package prints its build time when it is imported.
"""

import math
from xml.etree import ElementTree as ET

import numpy as np

from particlerb.compiled.threads import THREADS

from .scene import (
    Course,
    Result,
    Scene,
    absent,
    equal_steps,
    needs_solid_bodies,
    result,
    stops,
    to_rotor,
    to_world,
)

NAME = "PyBullet"
ADAPTIVE = False
LADDER = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
VARIANTS = {"btMultiBody": LADDER, "btRigidBody": LADDER}
CONTACT = {"btMultiBody": LADDER}
OTHERWISE = "rigid, with the restitution of the case: it bounces without a time of contact"
STORES = False  # whether the energy of contacts is in springs like ours
SWEEPS = 50  # of its solver, its default

BURST = 64  # a power of two: dividing by it is exact, so that Bullet counts its sub-steps right


def missing() -> str | None:
    """Why PyBullet cannot be used here."""
    return absent("pybullet")


def refusal(scene: Scene) -> str | None:
    """Why PyBullet cannot hold the scene: it takes a zero moment for an infinite one."""
    return needs_solid_bodies(scene, NAME)


def run(scene: Scene, variant: str, step: float) -> Result:
    """Integrate the scene.

    Parameters
    ----------
    variant : str
        `btMultiBody` (explicit gyroscopic term) or `btRigidBody` (implicit).
    step : float
        Step [s]; reduced a little so that the last one ends at `t_end`.
    """
    import pybullet

    number, step = equal_steps(scene, step)
    given, scene = scene, scaled(scene)
    world = pybullet.connect(pybullet.DIRECT)
    try:
        bodies = [add_body(scene, b, variant, world) for b in range(len(scene.mass))]
        pushes = {body: [] for body in bodies}
        for push in scene.pushes:
            pushes[bodies[push.body]].append((push.at.tolist(), push.force.tolist()))
        pushes = {body: some for body, some in pushes.items() if some}
        advance({}, step, BURST + 1, world)  # at rest
        pybullet.setGravity(*scene.gravity, physicsClientId=world)
        for body, v, w in zip(bodies, scene.velocity, scene.angular_velocity, strict=True):
            pybullet.resetBaseVelocity(body, v.tolist(), w.tolist(), physicsClientId=world)
        started = THREADS.local.clock()
        advance(pushes, step, number, world)
        seconds = THREADS.local.clock() - started
        pose = [pybullet.getBasePositionAndOrientation(b, physicsClientId=world) for b in bodies]
        speed = [pybullet.getBaseVelocity(b, physicsClientId=world) for b in bodies]
    finally:
        pybullet.disconnect(world)
    x, q = np.array([x for x, _ in pose]), np.array([q for _, q in pose])[:, [3, 0, 1, 2]]
    v, w = np.array([v for v, _ in speed]), np.array([w for _, w in speed])
    return result(given, seconds, x, q, v, to_world(q, given.inertia * to_rotor(q, w)))


def course(scene: Scene, variant: str, step: float) -> Course:
    """Run balls, clumps and planes of the model of a scene, with contact by impulses.

    Restitution and friction of a pair are products of those of its two bodies.
    """
    import pybullet

    number, step = stops(scene, step)
    restitution, friction = map(math.sqrt, scene.contact)
    world = pybullet.connect(pybullet.DIRECT)
    here = {"physicsClientId": world}
    seconds, rows = 0.0, []
    try:
        pybullet.setGravity(*scene.gravity, **here)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=step,
            numSubSteps=0,
            numSolverIterations=SWEEPS,
            restitutionVelocityThreshold=0.0,
            **here,
        )
        root = ET.fromstring(scene.model).find("worldbody")
        planes = [add_plane(geom, here) for geom in root.findall("geom")]
        parts = {element.get("name"): element for element in root.findall("body")}
        bodies = [add_touching(scene, b, parts[name], here) for b, name in enumerate(scene.names)]
        surface = {"restitution": restitution, "lateralFriction": friction}
        for body in (*planes, *bodies):
            pybullet.changeDynamics(body, -1, contactProcessingThreshold=0.0, **surface, **here)
        for _ in scene.times:
            started = THREADS.local.clock()
            for _ in range(number):
                pybullet.stepSimulation(world)
            seconds += THREADS.local.clock() - started
            rows.append(
                [
                    (
                        *pybullet.getBasePositionAndOrientation(body, **here),
                        *pybullet.getBaseVelocity(body, **here),
                    )
                    for body in bodies
                ]
            )
    finally:
        pybullet.disconnect(world)
    x, q, v, w = (np.array([[one[k] for one in row] for row in rows]) for k in range(4))
    q = np.roll(q, 1, axis=-1)
    L = [to_world(a, scene.inertia * to_rotor(a, spin)) for a, spin in zip(q, w, strict=True)]
    return Course(seconds, x, q, v, np.array(L))


def add_plane(geom: ET.Element, here: dict[str, int]) -> int:
    """Plane of a model; Bullet's number for it."""
    import pybullet

    normal = [float(part) for part in geom.get("zaxis", "0 0 1").split()]
    place = [float(part) for part in geom.get("pos", "0 0 0").split()]
    shape = pybullet.createCollisionShape(pybullet.GEOM_PLANE, planeNormal=normal, **here)
    return pybullet.createMultiBody(0.0, shape, -1, place, **here)


def add_touching(scene: Scene, b: int, element: ET.Element, here: dict[str, int]) -> int:
    """Body `b` of the scene with the spheres that the model gives it, on its way."""
    import pybullet

    spheres = element.findall("geom")
    turn = (
        np.concatenate([[1.0], np.zeros(3)]) if scene.rotor_frame is None else scene.rotor_frame[b]
    )
    places = np.array([[float(x) for x in one.get("pos").split()] for one in spheres])
    local = to_rotor(np.tile(turn, (len(places), 1)), places)
    radii = [float(one.get("size")) for one in spheres]
    shape = pybullet.createCollisionShapeArray(
        [pybullet.GEOM_SPHERE] * len(radii),
        radii=radii,
        collisionFramePositions=local.tolist(),
        **here,
    )
    held = element.find("inertial") is None
    body = pybullet.createMultiBody(
        0.0 if held else scene.mass[b],
        shape,
        -1,
        scene.position[b].tolist(),
        np.roll(scene.orientation[b], -1).tolist(),
        **here,
    )
    if held:
        return body
    set_inertia(scene, b, body, here)
    v, w = scene.velocity[b].tolist(), scene.angular_velocity[b].tolist()
    pybullet.resetBaseVelocity(body, v, w, **here)
    return body


def set_inertia(scene: Scene, b: int, body: int, here: dict[str, int]) -> None:
    """Give Bullet's body the mass and moments of body `b`, and nothing that damps or bounds it."""
    import pybullet

    pybullet.changeDynamics(
        body,
        -1,
        mass=scene.mass[b],
        localInertiaDiagonal=scene.inertia[b].tolist(),
        linearDamping=0.0,
        angularDamping=0.0,
        maxJointVelocity=1e100,
        **here,
    )


def scaled(scene: Scene) -> Scene:
    """Scene that moves alike, with every largest moment of inertia near 1 kg m²."""
    unit = np.exp2(np.floor(np.log2(scene.inertia.max(1))))  # a power of two rounds nothing
    return scene._replace(
        mass=scene.mass / unit,
        inertia=scene.inertia / unit[:, None],
        pushes=tuple(push._replace(force=push.force / unit[push.body]) for push in scene.pushes),
    )


def add_body(scene: Scene, b: int, variant: str, world: int) -> int:
    """Body `b` of the scene, at rest where it starts; Bullet's number for it."""
    import pybullet

    maximal = variant == "btRigidBody"
    here = {"physicsClientId": world}
    shape = -1
    if maximal:
        shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=1e-6, **here)
    body = pybullet.createMultiBody(
        scene.mass[b],
        shape,
        -1,
        scene.position[b],
        np.roll(scene.orientation[b], -1),
        useMaximalCoordinates=maximal,
        **here,
    )
    set_inertia(scene, b, body, here)
    if maximal:
        pybullet.setCollisionFilterGroupMask(body, -1, 0, 0, **here)
    return body


def advance(pushes: dict[int, list], step: float, number: int, world: int) -> None:
    """Make `number` steps of `step` seconds; `pushes` of a body as (point, force)."""
    import pybullet

    pose, advance_world = pybullet.getBasePositionAndOrientation, pybullet.stepSimulation
    push, frame = pybullet.applyExternalForce, pybullet.WORLD_FRAME
    bursts, rest = (0, number) if pushes else divmod(number, BURST)
    pybullet.setPhysicsEngineParameter(
        fixedTimeStep=BURST * step, numSubSteps=BURST, numSolverIterations=1, physicsClientId=world
    )
    for _ in range(bursts):
        advance_world(world)
    pybullet.setPhysicsEngineParameter(fixedTimeStep=step, numSubSteps=0, physicsClientId=world)
    for _ in range(rest):
        for body, some in pushes.items():
            x, q = pose(body, world)
            for at, force in some:
                push(body, -1, force, point(x, q, at), frame, world)
        advance_world(world)


def point(x: tuple, q: tuple, at: list) -> tuple[float, float, float]:
    """Point of a body in the world, in plain Python: NumPy is slower for three numbers.

    Parameters
    ----------
    x, q : tuple
        Centre of mass, world [m]; quaternion, scalar last.
    at : list
        Point in the rotor frame, from the centre of mass [m].
    """
    i, j, k, w = q
    a, b, c = at
    s, t, u = 2 * (j * c - k * b), 2 * (k * a - i * c), 2 * (i * b - j * a)
    return (
        x[0] + a + w * s + j * u - k * t,
        x[1] + b + w * t + k * s - i * u,
        x[2] + c + w * u + i * t - j * s,
    )
