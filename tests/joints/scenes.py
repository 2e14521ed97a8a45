"""Scenes of tests/reference/joints_*.csv as cases, and what their references say."""

from pathlib import Path

import numpy as np

from particlerb import run
from particlerb.model.bodies import quaternions

REFERENCE = Path(__file__).parents[1] / "reference"
X, Y, Z = np.eye(3).tolist()


def bar(name, start, end, mass=1.0, side=0.1, velocity=(0, 0, 0), spin=(0, 0, 0)):
    """A bar with a square section between two points; its axis 1 is along it."""
    start, end = np.array(start, float), np.array(end, float)
    length = np.linalg.norm(end - start)
    x = (end - start) / length
    y = np.cross(Z if abs(x[2]) < 0.9 else Y, x)
    y /= np.linalg.norm(y)
    frame = np.stack([x, y, np.cross(x, y)], axis=1)
    across = mass / 12 * (length**2 + side**2)
    return body(name, mass, [mass / 6 * side**2, across, across], (start + end) / 2, velocity, spin,
                quaternions(frame[None])[0])  # fmt: skip


def body(name, mass, inertia, position, velocity=(0, 0, 0), spin=(0, 0, 0), q=(1, 0, 0, 0)):
    """A body with these moments about its own axes."""
    return {
        "name": name,
        "mass": mass,
        "shape": {"type": "moments", "inertia": list(map(float, inertia))},
        "position": np.array(position, float).tolist(),
        "orientation": np.array(q, float).tolist(),
        "velocity": np.array(velocity, float).tolist(),
        "angular_velocity": np.array(spin, float).tolist(),
    }


def joint(kind, one, other=None, at=(0, 0, 0), axis=None, **keys):
    """A joint between two bodies, or one and the world."""
    table = {"type": kind, "body": one, "at": np.array(at, float).tolist(), **keys}
    table |= {} if other is None else {"to": other}
    return table | ({} if axis is None else {"axis": np.array(axis, float).tolist()})


def case(bodies, joints, g=(0.0, 0.0, -9.81), **keys):
    """A case without its [run]."""
    return {"gravity": {"acceleration": list(g)}, "body": bodies, "joint": joints, **keys}


def double_rod():
    bodies = [bar("a", [0, 0, 0], [1, 0, 0]), bar("b", [1, 0, 0], [1, 1, 0])]
    return case(bodies, [joint("ball", "a"), joint("ball", "b", "a", [1, 0, 0])])


def bricard(masses=(1, 2, 0.5, 1, 3)):
    """Six hinges in a loop with the world: 30 rows of which one depends on the others."""
    points = [[0, 0, 0], [1, 0, 0], [1, -1, 0], [1, -1, 1], [0, -1, 1], [0, 0, 1]]
    axes = [Y, Z, X, Y, Z, X]
    bodies = [bar(f"b{k}", points[k], points[k + 1], masses[k]) for k in range(5)]
    joints = [joint("hinge", "b0", None, points[0], axes[0])]
    joints += [joint("hinge", f"b{k}", f"b{k - 1}", points[k], axes[k]) for k in range(1, 5)]
    joints.append(joint("hinge", "b4", None, points[5], axes[5]))
    return case(bodies, joints, (0.0, -9.81, 0.0))


def hinge_chain(n=6, total=1.0):
    """Links along x with 1 kg in all, the axes of the hinges y and z in turn."""
    length = total / n
    bodies = [
        bar(f"b{k}", [k * length, 0, 0], [(k + 1) * length, 0, 0], 1.0 / n, 0.2 * length)
        for k in range(n)
    ]
    joints = [
        joint("hinge", f"b{k}", f"b{k - 1}" if k else None, [k * length, 0, 0], (Y, Z)[k % 2])
        for k in range(n)
    ]
    return case(bodies, joints)


def mixed_chain(masses=(1, 2, 0.5, 0.7, 0.4), tilt=0.5):
    """Universal, hinge, ball, slider, cylindrical, and a distance that closes the loop."""
    bodies = [
        bar("b0", [0, 0, 0], [0.6, 0, 0], masses[0], 0.08),
        body("b1", masses[1], [0.02, 0.03, 0.04], [0.75, 0.05, 0]),
        bar("b2", [0.9, 0.1, 0], [0.9, 0.1, 0.5], masses[2], 0.06),
        body("b3", masses[3], [0.01, 0.02, 0.025], [1.0, 0.1, 0.6]),
        bar("b4", [1.0, 0.3, 0.6], [1.0, 0.3, 1.1], masses[4], 0.05),
    ]
    joints = [
        joint("universal", "b0", None, [0, 0, 0], Z, axis_to=Y),
        joint("hinge", "b1", "b0", [0.6, 0, 0], [0, 1, tilt]),
        joint("ball", "b2", "b1", [0.9, 0.1, 0]),
        joint("slider", "b3", "b2", [0.9, 0.1, 0.5], [1, 0, 1]),
        joint("cylindrical", "b4", "b3", [1.0, 0.2, 0.6], Y),
        joint("distance", "b4", "b0", [1.0, 0.3, 1.1], at_to=[0.3, 0.0, 0.0]),
    ]
    return case(bodies, joints)


def four_bar(coupler, is_closed=True):
    """Three bars in a plane, 1 kg but for the coupler; closed, 3 of 20 rows are redundant."""
    pins = [[0, 0, 0], [0.5, 0.8, 0], [1.6, 1.0, 0], [1.5, 0, 0]]
    masses = 1.0, coupler, 1.0
    bodies = [bar(f"b{k}", pins[k], pins[k + 1], masses[k]) for k in range(3)]
    ends = [("b0", None), ("b1", "b0"), ("b2", "b1"), ("b2", None)][: 3 + is_closed]
    joints = [joint("hinge", *ends[k], pins[k], Z) for k in range(len(ends))]
    return case(bodies, joints, (0.0, -9.81, 0.0))


def slider_crank(radius=0.08, length=0.3, height=0.1, masses=(0.12, 0.5, 2.0), speed=6.0):
    """Spatial: a hinge, a ball at the crank, a universal joint at the slider, a slider."""
    axle = np.array([0, 0, height])
    pin = np.array([0, radius, height])
    end = np.array([np.sqrt(length**2 - pin[1] ** 2 - pin[2] ** 2), 0, 0])
    turn = np.array([speed, 0, 0])
    of_pin, u = np.cross(turn, pin - axle), (end - pin) / length
    of_end = np.array([np.dot(of_pin, u) / u[0], 0, 0])
    spin = np.cross(u, of_end - of_pin) / length
    across = np.cross(u, X)
    across /= np.linalg.norm(across)
    p = np.array(Z) - (np.array(Z) @ across) * across
    p /= np.linalg.norm(p)
    spin = spin - u * (np.cross(spin, across) @ p) / (np.cross(u, across) @ p)
    bodies = [
        bar("b0", axle, pin, masses[0], 0.02, of_pin / 2, turn),
        bar("b1", pin, end, masses[1], 0.03, (of_pin + of_end) / 2, spin),
        body("b2", masses[2], [1e-3, 2e-3, 2e-3], end, of_end),
    ]
    joints = [
        joint("hinge", "b0", None, axle, X),
        joint("ball", "b1", "b0", pin),
        joint("universal", "b1", "b2", end, across, axis_to=p.tolist()),
        joint("slider", "b2", None, end, X),
    ]
    return case(bodies, joints)


SCENES = {
    "double_rod": double_rod,
    "bricard": bricard,
    "chain6": hinge_chain,
    "mixed_chain": mixed_chain,
    "slider_crank": slider_crank,
}


def reference(name, t):
    """Positions and velocities (n, 3) of a reference at a time."""
    table = np.genfromtxt(
        REFERENCE / f"joints_{name}.csv", delimiter=",", names=True, skip_header=2
    )
    row = table[np.argmin(np.abs(table["t"] - t))]
    assert abs(row["t"] - t) < 1e-12
    n = sum(key.endswith("_vx") for key in table.dtype.names)
    return tuple(
        np.array([[row[f"b{k}_{kind}{c}"] for c in "xyz"] for k in range(n)]) for kind in ("", "v")
    )


def moved(scene, t, dt, method="rattle", **keys):
    """Trajectory of a scene until t."""
    times = {"t_end": t, "every": t, "dt": dt, "method": method} | keys
    return run({"run": times, **scene})
