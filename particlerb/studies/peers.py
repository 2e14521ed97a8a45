"""Other engines on the same bodies; the adapters lie in `benchmarks/peers`, one per engine.

This module finds them, hands them a scene in plain arrays, and turns what they give back into the
errors of a chart. It knows no engine.
"""

import contextlib
import importlib.util
import sys
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Final, TypeAlias

import numpy as np

from particlerb.case.forces import PushTable, SpringTable
from particlerb.case.joints import ACTIONS, ROLLING
from particlerb.case.problems import CaseError, problem_at
from particlerb.export import ExportError
from particlerb.export.lammps_scene import lammps_scene
from particlerb.export.mjcf_scene import mjcf_scene
from particlerb.export.scene import FREE_STEP, left_out, springs_of, tethers_of
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import Bodies, taken
from particlerb.model.state import (
    Frames,
    body_orientation,
    kinetic_energy,
    omega_world,
    rotate_back,
)
from particlerb.model.system import System
from particlerb.plan.group_terms import links_among
from particlerb.plan.joints import has_loops, joints_of
from particlerb.plan.links import Link
from particlerb.simulation.trials import BodySubset, Error, errors
from particlerb.studies.text import chosen_names

PeerScene: TypeAlias = Any  # the adapters' own type: bodies, pushes, gravity, t_end
Engine: TypeAlias = Any  # module of one of them, with the names that benchmarks/peers tells


@cache
def _adapters() -> ModuleType:
    """The package of adapters, from the repository or the installed copy.

    Raises
    ------
    ValueError
        If neither is there.
    """
    package = Path(__file__).parent.parent
    for folder in (package.parent / "benchmarks" / "peers", package / "_peers"):
        path = folder / "__init__.py"
        if path.is_file():
            spec = importlib.util.spec_from_file_location(
                "particlerb_peers", path, submodule_search_locations=[str(folder)]
            )
            assert spec is not None
            assert spec.loader is not None
            module = importlib.util.module_from_spec(spec)
            sys.modules[spec.name] = module
            spec.loader.exec_module(module)
            return module
    raise ValueError("the adapters to other engines are not installed")


def engines(names: Sequence[str]) -> list[Engine]:
    """Engines by name; `all` is every one.

    Raises
    ------
    ValueError
        If there is no such engine.
    """
    if not names:
        return []
    by_name = _adapters().ENGINES
    asked = chosen_names(names, ("all", *by_name), "peer")
    return [by_name[name]() for name in (by_name if "all" in asked else asked)]


def refusal_by(engine: Engine, scene: PeerScene) -> str:
    """Why an engine cannot hold a scene; empty where it can."""
    for feature in ("joints", "springs", "attraction"):
        if getattr(scene, feature) is not None and feature not in getattr(engine, "HOLDS", ()):
            return f"it is given no {feature}"
    if scene.contact is None:
        return engine.refusal(scene) or ""
    if not hasattr(engine, "CONTACT"):
        return "it has no contact"
    return str((scene.refused or {}).get(engine.NAME, ""))


def variants_of(engine: Engine, system: System) -> dict[str, Sequence[float]]:
    """Ladder of each variant of an engine for a system."""
    if system.contact is not None:
        return dict(getattr(engine, "CONTACT", {"": ()}))
    if system.attraction is not None:
        return dict(getattr(engine, "ATTRACTION", engine.VARIANTS))
    has_springs = any(isinstance(force, SpringTable) for force in system.force)
    return dict(getattr(engine, "SPRINGS", engine.VARIANTS) if has_springs else engine.VARIANTS)


_FORCES: Final = "other engines take gravity, springs and constant pushes in the world frame only"
_NONE_REASON: Final = "other engines, and what charts are measured against, have no {}"
_ATTRACTION: Final = "other engines are given attraction of points alone, of one particle each"


def _refuse_what_they_lack(system: System) -> None:
    """Raise a ValueError where joints or bodies are or do what the adapters have no word for."""
    acting = *ACTIONS, "drive", "during", "breaks_at"
    if any(getattr(t, k) for t in system.joint for k in acting):
        raise ValueError(_FORCES)
    if any(table.type in ROLLING for table in system.joint):
        raise ValueError(_NONE_REASON.format("gears, racks or screws"))
    if any(body.fixed or body.motion is not None for body in system.body):
        raise ValueError(_NONE_REASON.format("bodies that are fixed or have a motion"))


def peer_scene(system: System) -> PeerScene:
    """The scene in plain arrays.

    Raises
    ------
    ValueError
        If something acts that the adapters have no word for.
    """
    types = import_module(f"{_adapters().__name__}.scene")
    bodies = system.bodies
    if system.contact is not None:
        return _touching(system, types)
    if system.attraction is not None:
        return _attracting(system, types)
    _refuse_what_they_lack(system)
    pushes, links = [], springs_of(system)
    if links and system.joint:
        raise ValueError("other engines are given no springs beside joints")
    for number, force in enumerate(system.force):
        if number in {link.number for link in links}:
            continue
        if not isinstance(force, PushTable) or force.frame != "world":
            raise ValueError(_FORCES)
        if force.timed is not None or force.during is not None:
            raise ValueError(_FORCES)
        if force.entries:
            raise ValueError("other engines are given pushes that are the same for all bodies")
        for b in system.names.find(force.body).tolist():
            at = rotate_back(bodies.rotor_frame[:, b], np.array(force.at))
            pushes.append(types.Push(b, at, np.array(force.force)))
    scene = _bodies_of(system, types)._replace(pushes=tuple(pushes))
    if links:
        return scene._replace(springs=_springs(bodies, links))
    setup = joints_of(system)
    if setup is None:
        return scene
    rows = setup.rows
    joints = rows.kind, rows.a, rows.b, rows.vector_a, rows.vector_b, rows.axis, rows.length
    model = ""
    with contextlib.suppress(ExportError):
        model = mjcf_scene(system, system.run.dt or FREE_STEP)
    return scene._replace(joints=joints, has_loops=has_loops(system, setup), model=model)


def _bodies_of(system: System, types: ModuleType) -> PeerScene:
    """Bodies and gravity."""
    bodies, state = system.bodies, system.state
    velocity, omega = state.p * bodies.inv_mass, omega_world(bodies, state)
    columns = (bodies.inertia, state.com, state.q, velocity, omega)
    rows = (np.ascontiguousarray(column.T) for column in columns)
    scene = types.Scene(bodies.mass, *rows, system.acceleration, (), system.run.t_end)
    return scene._replace(names=tuple(system.names), rotor_frame=bodies.rotor_frame.T)


def _attracting(system: System, types: ModuleType) -> PeerScene:
    """Points that attract each other.

    Raises
    ------
    ValueError
        If they are no points, or anything else acts.
    """
    table = system.attraction
    assert table is not None
    acts = system.force or system.joint or system.acceleration.any() or table.body is not None
    if acts or (np.diff(system.particles.offset)[system.kind] > 1).any():
        raise ValueError(_ATTRACTION)
    return _bodies_of(system, types)._replace(attraction=(table.G, table.softening))


def _springs(bodies: Bodies, links: list[Link]) -> tuple[Any, ...]:
    """Ends (2, s), their places (2, s, 3) in rotor frames, and three numbers (3, s) of springs."""
    springs = links_among(np.arange(bodies.mass.size), bodies, links)
    damping = np.zeros_like(springs.stiffness) if springs.damping is None else springs.damping
    at = np.ascontiguousarray(np.stack([springs.at_a.T, springs.at_b.T]))
    numbers = np.array([springs.stiffness, damping, springs.rest_length])
    return np.stack([springs.body_a, springs.body_b]), at, numbers


def _touching(system: System, types: ModuleType) -> PeerScene:
    """Bodies that touch, as the exports write them; engines without a model are refused.

    Raises
    ------
    ValueError
        If no engine has what acts.
    """
    contact, scene = system.contact, _bodies_of(system, types)
    assert contact is not None
    if missing := left_out(system, springs_of(system)):
        raise ValueError(f"other engines are given no {missing[0]} where bodies touch")
    refused, tables = {}, (contact, *contact.pair)
    try:
        scene = scene._replace(model=mjcf_scene(system))
    except ExportError as error:
        refused = dict.fromkeys(("MuJoCo", "PyBullet"), str(error))
    if contact.law != "hooke" and any(table.restitution for table in tables):
        refused["MuJoCo"] = "it has no restitution without springs"
    if system.force or system.joint or contact.pair:
        refused.setdefault("PyBullet", "it is given balls, clumps and planes alone")
    try:
        scene = scene._replace(files=lammps_scene(system, FREE_STEP, "scene"))
        if missing := left_out(system, tethers_of(system)):
            refused["LAMMPS"] = f"it is given no {missing[0]}"
    except ExportError as error:
        refused["LAMMPS"] = str(error)
    law = contact.restitution, contact.friction
    return scene._replace(refused=refused, contact=law)


def course_of(
    engine: Engine, scene: PeerScene, variant: str, step: float, bodies: Bodies
) -> tuple[Frames, float]:
    """States that an engine finds at the times of a scene in which bodies touch, and its time."""
    course = engine.course(scene, variant, step)
    frame = bodies.rotor_frame
    q = np.array([body_orientation(row.T, frame).T for row in course.orientation])
    momenta = course.velocity * bodies.mass[:, None], course.angular_momentum
    is_frame = np.ones(scene.times.size, dtype=np.bool_)
    return Frames(course.position, q, *momenta, q[-1], is_frame), float(course.seconds)


JOINT_ORACLE: Final = "DOP853 (SciPy) on accelerations with multipliers, tolerance 1e-13"


def oracle_states(system: System, indices: Ints, times: Floats) -> Frames:
    """States of some bodies of a system with joints at ascending times, by another formulation.

    Raises
    ------
    CaseError
        If something acts that it does not take.
    """
    try:
        scene = peer_scene(system)
    except ValueError as error:
        raise CaseError([problem_at(system, "joint", str(error), "")]) from None
    textbook = import_module(f"{_adapters().__name__}.with_textbook")
    y = textbook.oracle(scene, times)[:, indices]
    frame = system.bodies.rotor_frame[:, indices]
    q = [body_orientation(row.T, frame).T for row in y[:, :, 3:7]]
    x, v, L = (np.ascontiguousarray(y[:, :, k : k + 3]) for k in (0, 7, 10))
    momenta = v * system.bodies.mass[indices, None], L
    return Frames(x, np.array(q), *momenta, q[-1], np.ones(times.size, dtype=np.bool_))


def peer_errors(
    result: Any, scene: System, indices: Ints, judged: BodySubset, times: Floats, reference: Frames
) -> tuple[Error, float, float]:
    """Errors of a peer's end state, and its relative drifts of energy and angular momentum.

    Its drifts count where nothing acts; elsewhere they are NaN.
    """
    bodies = taken(scene.bodies, indices)
    orientation = body_orientation(result.orientation[indices].T, bodies.rotor_frame).T

    pose = result.position[indices], orientation
    position, turned = (np.repeat(column[None], times.size, axis=0) for column in pose)
    final = reference._replace(position=position, orientation=turned)
    error = errors(judged, times, final, reference)[-1]
    is_free = scene.attraction is None and not scene.force
    if not is_free or any(s.terms != type(s.terms)() for g in judged.groups for s in g.segments):
        return error, np.nan, np.nan
    kinetic = kinetic_energy(bodies, judged.state)
    energy = np.abs(result.kinetic_energy[indices] - kinetic).sum() / kinetic.sum()
    spin = np.linalg.norm(result.angular_momentum[indices] - judged.state.L.T, axis=1).sum()
    return error, float(energy), float(spin / np.linalg.norm(judged.state.L, axis=0).sum())
