"""Markers, the hypothesis profiles, small scenes and an independent integrator for all tests."""

import os
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace

import hypothesis
import numpy as np
import pytest

from particlerb.compiled import jit, plain

hypothesis.settings.register_profile("same", derandomize=True, deadline=None)
hypothesis.settings.register_profile("search", deadline=None, max_examples=1000)
hypothesis.settings.load_profile("same")  # pytest --hypothesis-profile=search looks further

PLAIN = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")
plain._Time.left = 0.0  # what is tested here is compiled, or plain Python throughout
jit.WHEN_COMPILING.clear()  # what tests read on stderr is the same with cold and warm caches


LONGEST = (
    "view/test_page.py",
    "cases/test_cases.py",
    "impulses/test_going_on.py",
    "ranks/test_bricks.py",
    "test_docs.py",
    "studies/test_stability.py",
    "record/test_resume.py",
    "impulses/test_impacts.py",
    "integrators/test_coupled.py",
    "simulation/test_accuracy.py",
    "contact/test_contact_motion.py",
    "joints/test_joint_studies.py",
    "sweeping/test_worlds.py",
    "joints/test_mjcf.py",
    "ranks/test_ranks.py",
    "impulses/test_newton.py",
    "forces/test_user_forces.py",
    "record/test_crashes.py",
    "view/test_page_access.py",
    "contact/test_methods_with_contact.py",
    "view/test_film.py",
    "joints/test_compiled_drives.py",
    "impulses/test_mechanisms.py",
    "cases/test_contact_cases.py",
    "cases/test_granular_cases.py",
)
PLACE = {Path(__file__).parent / name: k for k, name in enumerate(LONGEST)}


def pytest_configure(config: pytest.Config) -> None:
    """Hand files to workers in the order of the tests, and not those with few tests last."""
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what needs the compiler where it is switched off, and what does not where it is on.

    Files that take minutes come first: one that begins last would keep a single worker busy.
    """
    items.sort(key=lambda item: PLACE.get(item.path, len(PLACE)))
    marker = "compiled" if PLAIN else "plain"
    reason = "NUMBA_DISABLE_JIT is set" if PLAIN else "takes long to compile, and shows no more"
    for item in items:
        marks = {mark.name for mark in item.iter_markers()}
        if "plain" in marks and marks & {"slow", "compiled", "once"}:
            raise pytest.UsageError(f"{item.nodeid} runs in no tier: it is plain, and {marks}")
        if marker in marks:
            item.add_marker(pytest.mark.skip(reason=reason))


def body(name: str = "body", inertia: Sequence[float] = (1.0, 2.0, 2.5), **keys) -> dict:
    """Body of 2 kg with given principal moments; asymmetric unless said otherwise."""
    return {
        "name": name,
        "shape": {"type": "moments", "inertia": list(inertia)},
        "mass": 2.0,
    } | keys


def case(*bodies: dict, force: Sequence[dict] = (), t_end=1.0, every=0.1, **keys) -> dict:
    """Case; keys that are not tables go to [run]."""
    names = (
        "gravity",
        "attraction",
        "contact",
        "material",
        "wall",
        "joint",
        "output",
        "check",
        "title",
    )
    tables = {k: keys.pop(k) for k in names if k in keys}
    run = {"t_end": t_end, "every": every} | keys
    return {"run": run, "body": list(bodies), "force": list(force)} | tables


def sphere(name: str = "ball", radius: float = 0.1, **keys) -> dict:
    """Ball of 2 kg that touches."""
    return {"name": name, "shape": {"type": "sphere", "radius": radius}, "mass": 2.0} | keys


def hooke(stiffness: float = 1e5, restitution: float = 0.8, friction: float = 0.5, **keys) -> dict:
    """Numbers of [contact] for all materials."""
    return {"stiffness": stiffness, "restitution": restitution, "friction": friction} | keys


def plane(normal: Sequence[float] = (0, 0, 1), name: str = "floor", **keys) -> dict:
    """Wall through the origin."""
    return {"type": "plane", "name": name, "normal": list(normal)} | keys


def push(force: Sequence[float], at: Sequence[float] = (0, 0, 0), body="body", **keys) -> dict:
    """Push, world frame."""
    return {"type": "push", "body": body, "force": list(force), "at": list(at)} | keys


def torque(torque: Sequence[float], body="body", **keys) -> dict:
    """Torque, world frame."""
    return {"type": "torque", "body": body, "torque": list(torque)} | keys


def impulse(impulse: Sequence[float], at=(0, 0, 0), time=0.0, body="body", **keys) -> dict:
    """Impulse, world frame."""
    return {
        "type": "impulse",
        "body": body,
        "impulse": list(impulse),
        "at": list(at),
        "time": time,
    } | keys


def spring(anchor, stiffness, rest_length=0.0, at=(0, 0, 0), body="body", **keys) -> dict:
    """Spring from a body point to an anchor in the world."""
    return {
        "type": "spring",
        "body": body,
        "at": list(at),
        "anchor": list(anchor),
        "stiffness": stiffness,
        "rest_length": rest_length,
    } | keys


def tie(to: str | Sequence[str] | None = None, stiffness=1.0, body="body", **keys) -> dict:
    """Spring between bodies; without `to` the keys have a reach."""
    ends = {"body": body} if to is None else {"body": body, "to": to}
    return {"type": "spring", **ends, "stiffness": stiffness} | keys


def field(field: Sequence[float], charge=0.0, dipole=(0, 0, 0), body="body", **keys) -> dict:
    """Uniform field on charges and a dipole."""
    vectors = {"field": list(field), "dipole": list(dipole)}
    return {"type": "field", "body": body, "charge": charge} | vectors | keys


def central(mu: float, centre: Sequence[float] = (0, 0, 0), body="body", **keys) -> dict:
    """Central field."""
    return {"type": "central", "body": body, "mu": mu, "centre": list(centre)} | keys


def drag(translation: float, rotation: float, body="body", **keys) -> dict:
    """Linear drag."""
    return {"type": "drag", "body": body, "translation": translation, "rotation": rotation} | keys


def ghosts(body="body", field: bool = True) -> list[dict]:
    """Forces of all kinds but pushes in the world, too small to change a bit.

    With them a case needs no other compiled code than one in which all of them act; without
    `field` they are those of them that rkn6 does not accept, or that have no potential.
    """
    others = [
        drag(1e-300, 0.0, body),
        torque([1e-300, 0, 0], body),
        push([1e-300, 0, 0], body=body, frame="body"),
    ]
    near = [spring([0, 0, 1], 1e-300, body=body)] * 2 + [central(1e-300, [9, 9, 9], body)]
    return near + others if field else others


def pulled(x, R, tensor, mass, v, w, force: dict) -> tuple[np.ndarray, np.ndarray]:
    """Force and torque about the centre of mass, world frame, of a [[force]] on one body.

    Written from the definitions and not from the code: the central field is that of a mass and its
    quadrupole Q = tr I - 3 I, U = -μ (M/d + x·Q x / 2 d⁵), and turns so that x × F + τ = 0.
    """
    kind, zero = force["type"], np.zeros(3)
    if kind == "drag":
        return -force["translation"] * v, -force["rotation"] * w
    if kind == "magnus":
        return force["coefficient"] * np.cross(w, v), zero
    if kind == "torque":
        return zero, np.array(force["torque"])
    if kind == "central":
        r = x - np.array(force["centre"])
        d = np.linalg.norm(r)
        inertia = R @ tensor @ R.T
        Q = np.trace(tensor) * np.eye(3) - 3.0 * inertia
        tidal = force["mu"] * (Q @ r / d**5 - 2.5 * (r @ Q @ r) * r / d**7)
        return tidal - force["mu"] * mass * r / d**3, -np.cross(r, tidal)
    if kind == "field":
        E, q = np.array(force["field"], dtype=float), force["charge"]
        moment = q * np.array(force.get("at", zero)) + np.array(force["dipole"])
        return q * E, np.cross(R @ moment, E)
    arm = R @ np.array(force["at"])
    if kind == "spring":
        way = np.array(force["anchor"]) - x - arm
        length = np.linalg.norm(way)
        rate = -way @ (v + np.cross(w, arm)) / length
        size = force["stiffness"] * (length - force["rest_length"])
        F = (size + force.get("damping", 0.0) * rate) * way / length
    else:
        F = np.array(force["force"], dtype=float)
        F = R @ F if force.get("frame") == "body" else F
    return F, np.cross(arm, F)


def rotation(q: np.ndarray):
    """SciPy's rotation of a quaternion with the scalar first."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(np.asarray(q), scalar_first=True)


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle between orientations [rad]."""
    return np.asarray((rotation(a).inv() * rotation(b)).magnitude())


def integrate(
    tensor: np.ndarray,
    mass: float,
    start: dict,
    load: Callable | Sequence[dict],
    times: Sequence[float],
) -> SimpleNamespace:
    """Newton's and Euler's equations in the body frame, by DOP853 at a tolerance of 1e-13.

    `load(t, R)` gives the force and the torque about the centre of mass, world frame; it may also
    be a list of [[force]] tables. The work of both and the impulses about the origin are integrated
    along.
    """
    from scipy.integrate import solve_ivp

    tensor = np.asarray(tensor, dtype=float)
    inverse = np.linalg.inv(tensor)
    q0 = np.array(start.get("orientation", [1.0, 0, 0, 0]), dtype=float)
    w0 = rotation(q0).inv().apply(start.get("angular_velocity", [0.0, 0, 0]))
    y0 = [start.get("position", [0.0, 0, 0]), start.get("velocity", [0.0, 0, 0]), q0, w0]

    def slope(t, y):
        x, v, q, w = y[0:3], y[3:6], y[6:10], y[10:13]
        R = rotation(q).as_matrix()
        if callable(load):
            F, tau = (np.asarray(u, dtype=float) for u in load(t, R))
        else:
            loads = [pulled(x, R, tensor, mass, v, R @ w, force) for force in load]
            F, tau = np.sum(loads, axis=0)
        dq = 0.5 * np.array([-q[1:] @ w, *(q[0] * w + np.cross(q[1:], w))])
        dw = inverse @ (R.T @ tau - np.cross(w, tensor @ w))
        turning = np.cross(x, F) + tau
        return np.concatenate([v, F / mass, dq, dw, [F @ v + tau @ (R @ w)], F, turning])

    done = solve_ivp(
        slope,
        (0.0, max(times)),
        np.concatenate([*y0, np.zeros(7)]),
        method="DOP853",
        rtol=1e-13,
        atol=1e-13,
        t_eval=times,
    )
    y = done.y.T
    R = rotation(y[:, 6:10]).as_matrix()
    return SimpleNamespace(
        position=y[:, 0:3],
        velocity=y[:, 3:6],
        orientation=y[:, 6:10] / np.linalg.norm(y[:, 6:10], axis=1, keepdims=True),
        angular_velocity=np.einsum("tij,tj->ti", R, y[:, 10:13]),
        angular_momentum=np.einsum("tij,jk,tk->ti", R, tensor, y[:, 10:13]),
        external=y[:, 13:20],
    )


def done(ledger) -> np.ndarray:
    """Work of all forces since t = 0 [J]: that counted, and the loss of potential energy."""
    potential = ledger.potential_energy
    return np.asarray(ledger.work - (potential - potential[0]))


def arrays(case: dict | str, *overrides: str) -> SimpleNamespace:
    """Run in memory; all arrays of the trajectory, and the ledger."""
    import particlerb

    with particlerb.run(case, overrides=overrides) as t:
        names = ("time", "position", "orientation", "linear_momentum", "angular_momentum")
        found = {name: getattr(t, name) for name in names}
        found |= {"velocity": t.velocity, "angular_velocity": t.angular_velocity}
        return SimpleNamespace(ledger=t.ledger, plan=t.parameter("plan"), **found)


def turned_round(there: SimpleNamespace) -> dict:
    """Keys of a body that goes back from where a run has brought the first."""
    return {
        "position": there.position[-1, 0],
        "orientation": there.orientation[-1, 0],
        "velocity": -there.velocity[-1, 0],
        "angular_velocity": -there.angular_velocity[-1, 0],
    }


def python(code: str, **environment: str) -> str:
    """What a new Python process prints; an error of it is one here."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parent,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def assembly(kernel, signature: tuple) -> str:
    """Machine code of a kernel, compiled anew: what is kept on disk lacks what LLVM made of it."""
    anew = type(kernel)(kernel.py_func, kernel.targetoptions, kernel.make_copied, None)
    anew.compile(signature)
    library = anew.overloads[signature].library
    return str(library.codegen._tm.emit_assembly(library._get_module_for_linking()))


def arithmetic(code: str) -> tuple[int, int]:
    """Sums and products in x86-64 code: on packed numbers, and on single ones."""
    packed, single = (
        len(re.findall(rf"\bv?(?:fn?m(?:add|sub)\d+|mul|add|sub){kind}\b", code))
        for kind in ("pd", "sd")
    )
    return packed, single


@pytest.fixture(scope="session")
def make() -> SimpleNamespace:
    """Makers of small cases, and what to judge them by."""
    return SimpleNamespace(
        body=body,
        case=case,
        sphere=sphere,
        hooke=hooke,
        plane=plane,
        push=push,
        torque=torque,
        impulse=impulse,
        spring=spring,
        tie=tie,
        field=field,
        central=central,
        drag=drag,
        ghosts=ghosts,
        pulled=pulled,
        rotation=rotation,
        angle=angle,
        integrate=integrate,
        done=done,
        arrays=arrays,
        turned_round=turned_round,
        python=python,
        assembly=assembly,
        arithmetic=arithmetic,
    )
