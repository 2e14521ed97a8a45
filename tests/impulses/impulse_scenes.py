"""Scenes of contact by impulses, run in memory."""

import math

import numpy as np

import particlerb

G = 9.81
R = 0.1
DOWN = {"acceleration": [0.0, 0.0, -G]}
STATE = ("position", "orientation", "linear_momentum", "angular_momentum")
CORNERS = [[x, y, z] for x in (-R, R) for y in (-R, R) for z in (-R, R)]


def tilted(angle, heading=0.0):
    """Gravity over a slope [rad] whose way down points to a heading."""
    across = G * math.sin(angle)
    return {"acceleration": [across * math.cos(heading), across * math.sin(heading),
                             -G * math.cos(angle)]}  # fmt: skip


def sphere(name="ball", radius=R, **keys):
    """Ball of 2 kg that touches."""
    return {"name": name, "shape": {"type": "sphere", "radius": radius}, "mass": 2.0} | keys


def plane(normal=(0, 0, 1), name="floor", **keys):
    """Wall through the origin."""
    return {"type": "plane", "name": name, "normal": list(normal)} | keys


def case(*bodies, contact, t_end=1.0, every=0.1, **keys):
    """Case; keys that are not tables belong to [run]."""
    names = ("gravity", "material", "wall", "output", "force", "joint", "attraction")
    tables = {k: keys.pop(k) for k in names if k in keys}
    run = {"t_end": t_end, "every": every} | keys
    return {"run": run, "body": list(bodies), "contact": contact} | tables


def impulse(restitution=0.0, friction=0.5, **keys):
    """[contact] without stiffness."""
    return {"law": "impulse", "restitution": restitution, "friction": friction} | keys


def exact(restitution=0.0, friction=0.5, **keys):
    """The same, solved to rounding."""
    return impulse(restitution, friction, tolerance=1e-13, iterations=2000) | keys


def events(restitution=1.0, friction=0.0, **keys):
    """[contact] by events."""
    return {"law": "events", "restitution": restitution, "friction": friction} | keys


def clump(name, mass=1.0, **keys):
    """Eight balls on the corners of a cube."""
    shape = {"type": "points", "mass": mass / 8.0, "radius": R, "position": CORNERS}
    return {"name": name, "shape": shape} | keys


def go(*bodies, contact, **keys):
    """Trajectory of bodies."""
    return particlerb.run(case(*bodies, contact=contact, **keys))


def weightless(*bodies, **keys):
    """The same by the loop for gravity, which others compile too: so little changes no bit."""
    return go(*bodies, gravity={"acceleration": [0.0, 0.0, -1e-300]}, **keys)


def assert_alike(one, other, names=STATE):
    """The same bits in all frames of trajectories, of a state or of what else is named."""
    for name in names:
        a, b = (getattr(t, name) if name in STATE else t.observable(name) for t in (one, other))
        assert (a == b).all(), name


def assert_goes_on_alike(scene, part, path, names=STATE):
    """A run to `part` [s] that is resumed has the same bits as a whole one, which is returned."""
    whole = particlerb.run(scene)
    particlerb.run(scene | {"run": scene["run"] | {"t_end": part}}, path).close()
    with particlerb.resume(path, t_end=scene["run"]["t_end"]) as t:
        assert_alike(t, whole, names)
    return whole


def errors(t):
    """Largest errors of the energy balance [J, N s, N m s] over frames."""
    names = ("energy_error", "linear_momentum_error", "angular_momentum_error")
    return [np.abs(t.observable(name)).max() for name in names]
