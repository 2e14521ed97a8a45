"""From a mesh to particles, and how many particles or spheres suffice for a wanted error.

`mesh_particles` fills a mesh; `coarsest_within` is the stop rule `inertia_error` of a case: it
tries finer and finer sets until one has at most this error, and keeps what it has tried.

The error of a set is the larger of ‖I_sum − I‖₂ / ‖I‖₂, each tensor per mass and about its own
com, and of the distance of the coms in radii of gyration, as in docs/convergence.md. The error of
a packing of spheres is that of their union, whose volume is compared as well.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from particlerb.geometry.analytic import Analytic
from particlerb.geometry.cells import cell_particles, cut_mesh, grid_over
from particlerb.geometry.mass_properties import mass_properties
from particlerb.geometry.mesh import TriangleMesh, mesh_solid
from particlerb.geometry.overlapping_spheres import union_solid
from particlerb.geometry.packing import packing
from particlerb.geometry.particles import Mass, Particles, checked_mass, kind_of, with_surface
from particlerb.geometry.solid import UniformSolid, equimomental_points
from particlerb.maths.vec3 import Floats

MAX_PARTICLES: Final = 1_000_000
_MAX_SPHERES: Final = 1000
_CELLS_RATIO: Final = 1.2  # of the numbers of cells that are tried one after the other
_SPHERES_RATIO: Final = 1.5  # of the numbers of spheres that are tried one after the other


class _Trial(NamedTuple):
    """A set that was tried."""

    n: int
    """Cells along the largest extent, particles per edge, or spheres."""
    particles: int
    inertia_error: float
    com_error: float
    volume_error: float = math.nan
    """Of the union of spheres, relative, signed; NaN where there are none."""

    @property
    def error(self) -> float:
        """The larger of the two that the motion feels."""
        return max(self.inertia_error, self.com_error)


class FilledShape(NamedTuple):
    """Particles, and what was tried on the way to them."""

    particles: Particles
    trials: tuple[_Trial, ...] = ()
    notes: tuple[str, ...] = ()
    """What was changed in a mesh, in words."""

    @property
    def lines(self) -> list[str]:
        """Notes, and a table of the trials, the chosen one last."""
        if not self.trials:
            return list(self.notes)
        last = self.trials[-1]
        head = f"inertia error {last.error:.3g} with n = {last.n}, as requested; tried:"
        return [*self.notes, head, *table(self.trials)]


def table(trials: Sequence[_Trial]) -> list[str]:
    """Lines of a table of trials, its head first."""
    has_volume = math.isfinite(trials[0].volume_error)
    lines = [f"    n  particles    inertia        com{'      volume' * has_volume}"]
    for n, particles, inertia, com, volume in trials:
        line = f"{n:>5}  {particles:>9}  {inertia:>9.2e}  {com:>9.2e}"
        lines.append(line + f"  {volume:>+10.2e}" * has_volume)
    return lines


def errors(particles: Particles, analytic: Analytic) -> tuple[float, float]:
    """Error of the tensor per mass and of the com of one kind of particles.

    Parameters
    ----------
    particles : Particles
    analytic : Analytic
        Of the solid that they stand for.
    """
    summed = mass_properties(particles)
    return differences(summed.com[0], summed.inertia_tensor[0] / summed.mass[0], analytic)


def differences(com: Floats, tensor: Floats, analytic: Analytic) -> tuple[float, float]:
    """The same of a com [m] and a tensor per mass [m²]."""
    gyration = math.sqrt(0.5 * np.trace(analytic.tensor))
    off, size = np.linalg.norm([tensor - analytic.tensor, analytic.tensor], 2, axis=(1, 2))
    return float(off) / float(size), float(np.linalg.norm(com - analytic.com)) / gyration


def coarsest_within(
    analytic: Analytic, wanted: float, make: Callable[[int], Particles]
) -> FilledShape:
    """Coarsest set that was tried of a solid with at most the wanted error.

    Tried are n = 1, 2, ... and, from 5 on, a fifth more each time.

    Parameters
    ----------
    analytic : Analytic
        Of the solid.
    wanted : float
    make : callable
        Particles for n; ValueError where n is too small.

    Raises
    ------
    ValueError
        If a million particles are too few; with the table of what was tried.
    """
    trials: list[_Trial] = []
    n = 1
    while True:
        try:
            particles = make(n)
            one = kind_of(particles, 0)  # others differ in their mass alone
            made = _Trial(n, len(one.mass), *errors(one, analytic))
        except ValueError:  # none of the cells is inside, or all lie in a plane
            if trials or n > _CELLS_RATIO**20:
                raise
        else:
            trials.append(made)
            if made.error <= wanted:
                return FilledShape(particles, tuple(trials))
            if made.particles * _CELLS_RATIO**3 > MAX_PARTICLES:
                raise ValueError(_missed(wanted, trials))
        n = max(n + 1, round(_CELLS_RATIO * n))


def _missed(wanted: float, trials: Sequence[_Trial]) -> str:
    """What was tried in vain."""
    best = min(trial.error for trial in trials)
    head = f"inertia_error = {wanted:g} is not met; the best of these has {best:.3g}"
    return "\n".join([head, *table(trials)])


# Meshes


def per_mass(solid: UniformSolid) -> Analytic:
    """What is compared of a solid."""
    return Analytic(solid.com, solid.inertia / solid.volume, solid.volume)


def mesh_particles(
    mesh: TriangleMesh,
    mass: Mass | None = None,
    density: Mass | None = None,
    arrangement: str = "exact",
    n: int = 10,
    inertia_error: float | None = None,
) -> FilledShape:
    """Particles of the matter inside a mesh.

    Parameters
    ----------
    mesh : TriangleMesh
        As `geometry.mesh.checked` leaves it.
    mass, density : float, or ndarray of shape (k, 1) [kg, kg/m³]
        One of them.
    arrangement : {"exact", "cells", "spheres"}
        Six particles with exactly the com and tensor of the mesh; cells, each weighted by its share
        inside, with the same com and tensor; inscribed spheres without mass, to touch with, and
        the six particles.
    n : int
        Cells along the largest extent, or spheres.
    inertia_error : float, optional
        Chooses n: the error of cells, or of the union of the spheres.

    Raises
    ------
    ValueError
        If the mass is not positive and finite, n is too small, or the error is not met.
    """
    solid = mesh_solid(mesh)
    of_density = 0.0 if density is None else density * solid.volume
    total = checked_mass(of_density if mass is None else mass)
    if arrangement == "exact":
        return FilledShape(equimomental_points(solid, total), (), mesh.notes)
    if arrangement == "cells":
        make = partial(_mesh_cells, mesh, total)
        if inertia_error is None:
            return FilledShape(make(n), (), mesh.notes)
        analytic = per_mass(solid)
        return coarsest_within(analytic, inertia_error, make)._replace(notes=mesh.notes)
    filled = _spheres_in(mesh, solid, total, n, inertia_error)
    return filled._replace(notes=mesh.notes)


def _mesh_cells(mesh: TriangleMesh, mass: Mass, n: int) -> Particles:
    """Particles of cells of a mesh, n along its largest extent."""
    grid = grid_over(mesh.vertices.min(axis=0), mesh.vertices.max(axis=0), n)
    return cell_particles(cut_mesh(mesh.vertices, mesh.faces, grid), grid, mass)


def _spheres_in(
    mesh: TriangleMesh, solid: UniformSolid, mass: Mass, n: int, inertia_error: float | None
) -> FilledShape:
    """Inscribed spheres without mass, and six particles with all of it."""
    analytic = per_mass(solid)

    def filled(count: int, trials: Sequence[_Trial]) -> FilledShape:
        matter = equimomental_points(solid, mass)
        made = with_surface(matter, balls.centre[:count], balls.radius[:count])
        return FilledShape(made, tuple(trials))

    balls = packing(mesh, n if inertia_error is None else 16)
    if inertia_error is None:
        if len(balls.radius) < n:
            found = f"only {len(balls.radius)} of {n} spheres find space"
            raise ValueError(f"{found}, as their centres are tried in some 40 000 cells: lower n")
        return filled(n, ())
    trials: list[_Trial] = []
    count = 1
    while count <= len(balls.radius):
        union = union_solid(balls.centre[:count], balls.radius[:count])
        off = differences(union.com, union.inertia / union.volume, analytic)
        trials.append(_Trial(count, count + 6, *off, union.volume / solid.volume - 1.0))
        if trials[-1].error <= inertia_error:
            return filled(count, trials)
        count = max(count + 1, round(_SPHERES_RATIO * count))
        if count > len(balls.radius) and len(balls.radius) < _MAX_SPHERES:
            balls = packing(mesh, min(4 * count, _MAX_SPHERES))
    raise ValueError(_missed(inertia_error, trials))
