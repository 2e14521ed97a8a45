"""Other engines on the same bodies; the adapters lie in `benchmarks/peers`, one per engine.

This module finds them, hands them a scene in plain arrays, and turns what they give back into the
errors of a chart. It knows no engine.
"""

import importlib.util
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from particlerb.case.forces import PushTable
from particlerb.case.placement import resolve_bodies
from particlerb.case.schema import Case
from particlerb.case.to_system import System
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import taken
from particlerb.model.state import Frames, kinetic_energy, multiplied, omega_world, turned_back
from particlerb.simulation.trials import BodySubset, Error, errors

PeerScene: TypeAlias = Any  # the adapters' own type: bodies, pushes, gravity, t_end


class Engine(NamedTuple):
    """One peer."""

    name: str
    missing: str  # why it cannot be used here; empty where it can
    variants: Mapping[
        str, tuple[float, ...]
    ]  # ladder of steps times the fastest rate, or tolerances
    is_adaptive: bool
    module: Any

    def refusal(self, scene: PeerScene) -> str | None:
        """Why it cannot hold the scene."""
        reason: str | None = self.module.refusal(scene)
        return reason

    def run(self, scene: PeerScene, variant: str, step: float) -> Any:
        """Run the scene to its end."""
        return self.module.run(scene, variant, step)


@cache
def adapters() -> ModuleType:
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
            name = "particlerb_peers"
            spec = importlib.util.spec_from_file_location(
                name, path, submodule_search_locations=[str(folder)]
            )
            assert spec is not None
            assert spec.loader is not None
            module = importlib.util.module_from_spec(spec)
            sys.modules[name] = module
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
    known = adapters().ENGINES
    wanted = list(known) if "all" in names else list(dict.fromkeys(names))
    for name in wanted:
        if name not in known:
            raise ValueError(f"{name}: no such peer; there are all, {', '.join(known)}")
    found = []
    for name in wanted:
        module = known[name]()
        found.append(
            Engine(module.NAME, module.missing() or "", module.VARIANTS, module.ADAPTIVE, module)
        )
    return found


GIVEN: Final = "peers are given gravity and constant world pushes"


def peer_scene(case: Case, scene: System) -> PeerScene:
    """The scene in plain arrays.

    Raises
    ------
    ValueError
        If something acts that the adapters have no word for.
    """
    types = sys.modules[f"{adapters().__name__}.scene"]
    bodies, state = scene.bodies, scene.state
    if case.attraction is not None:
        raise ValueError(f"{GIVEN} alone")
    pushes = []
    for force in case.force:
        if not isinstance(force, PushTable) or force.frame != "world" or force.during is not None:
            raise ValueError(f"{GIVEN} alone")
        for b in resolve_bodies(case, force.body).tolist():
            at = to_rotor(bodies.rotor_frame[:, b], force.at)
            pushes.append(types.Push(b, at, np.array(force.force)))
    gravity = case.gravity.acceleration if case.gravity else (0.0, 0.0, 0.0)
    return types.Scene(
        bodies.mass,
        np.ascontiguousarray(bodies.inertia.T),
        np.ascontiguousarray(state.com.T),
        np.ascontiguousarray(state.q.T),
        np.ascontiguousarray((state.p * bodies.inv_mass).T),
        np.ascontiguousarray(omega_world(bodies, state).T),
        np.array(gravity),
        tuple(pushes),
        case.run.t_end,
    )


def to_rotor(frame: Floats, vector: Sequence[float]) -> Floats:
    """A vector of the body frame in the rotor frame."""
    return turned_back(frame[:, None], np.array(vector)[:, None])[:, 0]


def peer_errors(
    result: Any, scene: System, which: Ints, part: BodySubset, times: Floats, reference: Frames
) -> tuple[Error, float, float]:
    """Errors of a peer's end state, and its relative drifts of energy and angular momentum.

    Its drifts count where nothing acts; elsewhere they are NaN.
    """
    bodies = taken(scene.bodies, which)
    inverse = bodies.rotor_frame * np.array([[1.0], [-1.0], [-1.0], [-1.0]])
    orientation = multiplied(np.ascontiguousarray(result.orientation[which].T), inverse).T

    def repeated(values: Floats) -> Floats:
        return np.repeat(values[None], times.size, axis=0)

    found = reference._replace(
        position=repeated(result.position[which]), orientation=repeated(orientation)
    )
    error = errors(part, times, found, reference)[-1]
    is_free = not any(s.terms != type(s.terms)() for g in part.groups for s in g.segments)
    if not is_free:
        return error, np.nan, np.nan
    kinetic = kinetic_energy(bodies, part.state)
    energy = np.abs(result.kinetic_energy[which] - kinetic).sum() / kinetic.sum()
    spin = np.linalg.norm(result.angular_momentum[which] - part.state.L.T, axis=1).sum()
    return error, float(energy), float(spin / np.linalg.norm(part.state.L, axis=0).sum())
