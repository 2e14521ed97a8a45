"""Tells where particles that fill a shape are another body than the solid that they stand for.

A lattice of few cells has other moments than the solid; with one cell across it is a rod, with one
in all a point. Whole bodies are compared: a part that is off by much may matter little.
"""

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from particlerb.case.bodies import Body
from particlerb.case.matter import size_of, solid_of
from particlerb.case.placement import random_stream
from particlerb.case.problems import Problem, problem_at
from particlerb.case.shapes import AnyShape
from particlerb.case.to_system import part_particles, turn_of
from particlerb.geometry import shapes
from particlerb.geometry.analytic import ANALYTIC
from particlerb.geometry.mass_properties import mass_properties, tensor_off_com
from particlerb.geometry.particles import Particles
from particlerb.maths.vec3 import Floats
from particlerb.model.system import System
from particlerb.rotors.rotor_class import NAMES, POINT, ROD
from particlerb.words import count_of

_MAX_MOMENT_ERROR: Final = 0.01  # of a principal moment, relative
_ERROR_ROUNDING: Final = 1e-9  # a lattice of 10 cells in a row is off by 1 % to rounding
MAX_TRIED_PARTICLES: Final = 100_000  # of a lattice that is tried for advice,
_MAX_CELLS_ALONG: Final = 200  # the largest extent
_CELLS_RATIO: Final = 1.1  # of the numbers of cells that are tried one after the other
_ARRANGEMENTS: Final = {  # with exactly the tensor of the solid
    **dict.fromkeys(("box", "ball", "ellipsoid", "rod", "tetrahedron"), "exact"),
    **dict.fromkeys(("shell", "cylinder", "cone", "torus"), "cells"),
}


def lattice_errors(system: System) -> Iterator[tuple[int, Floats, Floats]]:
    """Bodies with a lattice: number, ideal moments (3,) and relative errors of its own (3,)."""
    for i, body in enumerate(system.body):
        if not any(_is_lattice(shape) for _, shape in _shapes_of(body)):
            continue
        try:
            with np.errstate(all="ignore"):
                ideal = _ideal_moments(system, i, body)
        except (ArithmeticError, np.linalg.LinAlgError):
            continue  # powers of its sizes are no numbers: nothing to compare with
        moments = np.sort(system.properties.moments[system.first_kind[i]])
        off = moments / np.maximum(ideal, math.ulp(0.0)) - 1.0
        off[ideal == 0.0] = 0.0
        yield i, ideal, off


def coarse(system: System) -> Iterator[Problem]:
    """Bodies with other moments than they should have.

    Where a shape says `inertia_error` only a change of the rotor class is told.
    """
    for i, ideal, off in lattice_errors(system):
        body = system.body[i]
        filled = [shape for _, shape in _shapes_of(body) if _is_lattice(shape)]
        k = int(system.first_kind[i])
        worst = int(np.argmax(np.abs(off)))
        code = int(system.properties.rotor_class[k])
        is_changed = code == POINT or (code == ROD and ideal[0] > 0.0)
        is_asked = all(getattr(shape, "inertia_error", None) is not None for shape in filled)
        is_off = abs(off[worst]) > _MAX_MOMENT_ERROR * (1.0 + _ERROR_ROUNDING)
        if not is_changed and (is_asked or not is_off):
            continue
        count = int(system.summed[k])
        subject = f"{body.name}: as {count_of(count, 'particle')} it"
        if is_changed:
            reason = f"{subject} is a {NAMES[code]}, which the solid is not, and cannot turn as it"
        else:
            side = "above" if off[worst] > 0.0 else "below"
            reason = f"{subject} has a principal moment {abs(100 * off[worst]):.3g} % {side} that"
            reason += " of the solid"
        key, shape = _worst_shape(body)
        yield problem_at(system, f"body[{i}].{key}", reason, _advice(shape))


def _shapes_of(body: Body) -> list[tuple[str, AnyShape]]:
    """Shapes of a body, with their keys in its table."""
    if body.shape is not None:
        return [("shape", body.shape)]
    return [(f"part[{j}].shape", part.shape) for j, part in enumerate(body.part)]


def _is_lattice(shape: AnyShape) -> bool:
    """Whether a shape is a solid that whole cells fill."""
    return shape.type in ANALYTIC and getattr(shape, "arrangement", "") == "lattice"


def _cells_of(shape: AnyShape) -> Any:
    """Cells along the largest extent of a lattice; three numbers of a box."""
    return shape.model_dump(include={"n"})["n"]


def _ideal_moments(system: System, i: int, body: Body) -> Floats:
    """Principal moments of a body whose lattices are solids, ascending, (3,) [kg m²]."""
    if body.shape is not None:
        whole = float(system.properties.mass[system.first_kind[i]])
        return np.asarray(np.linalg.eigvalsh(whole * solid_of(body.shape).tensor))
    parts, stream = [], random_stream(system.run.seed, i, "shape")
    for part in body.part:
        particles = part_particles(system.files, part, stream).particles
        if not particles.mass.any():
            continue
        made = mass_properties(particles)
        mass, com, tensor = float(made.mass[0]), made.com[0], made.inertia_tensor[0]
        if _is_lattice(part.shape):
            R, solid = turn_of(part), solid_of(part.shape)
            com, tensor = R @ solid.com + part.position, mass * (R @ solid.tensor @ R.T)
        parts.append((mass, com, tensor))
    centre = sum(mass * com for mass, com, _ in parts) / sum(mass for mass, *_ in parts)
    tensors = [tensor_off_com(mass, tensor, com - centre) for mass, com, tensor in parts]
    return np.asarray(np.linalg.eigvalsh(sum(tensors, np.zeros((3, 3)))))


def _worst_shape(body: Body) -> tuple[str, AnyShape]:
    """Lattice of a body that is farthest from its solid, with its key."""
    lattices = [(key, shape) for key, shape in _shapes_of(body) if _is_lattice(shape)]
    return max(
        lattices, key=lambda one: _error_of(one[1], _particles_of(one[1], _cells_of(one[1])))
    )


def _particles_of(shape: AnyShape, n: object) -> Particles:
    """Lattice of a shape, of 1 kg."""
    return getattr(shapes, shape.type)(**size_of(shape), mass=1.0, n=n)


def _error_of(shape: AnyShape, particles: Particles) -> float:
    """Largest relative error of a principal moment of a lattice."""
    ideal = np.linalg.eigvalsh(solid_of(shape).tensor)
    moments = np.sort(mass_properties(particles).moments[0])
    some = ideal > 0.0
    return float(np.abs(moments[some] / ideal[some] - 1.0).max(initial=0.0))


def _advice(shape: AnyShape) -> str:
    """What would do: a finer lattice if there is one that is not too large, and the exact set."""
    n, finer = int(np.max(_cells_of(shape))), ""
    while not finer and n < _MAX_CELLS_ALONG:
        n = max(n + 1, round(_CELLS_RATIO * n))
        try:
            particles = _particles_of(shape, n)
        except ValueError:  # no cell is inside
            continue
        if len(particles.mass) > MAX_TRIED_PARTICLES:
            break
        if _error_of(shape, particles) <= _MAX_MOMENT_ERROR * (1.0 + _ERROR_ROUNDING):
            finer = f"n = {n} is within {100 * _MAX_MOMENT_ERROR:g} %; "
    exact = f'arrangement = "{_ARRANGEMENTS[shape.type]}" has exactly the moments of the solid'
    return f"{finer}{exact}"
