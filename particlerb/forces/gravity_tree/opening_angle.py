"""Opening angle of the tree for an error that is asked for.

A bound that holds in the worst scene is twenty times too cautious in ordinary ones. So the error is
measured: the field at some particles, spread evenly through the tree, beside the direct sum.
"""

from typing import Final

import numpy as np

from particlerb.compiled.jit import kernel
from particlerb.compiled.threads import THREADS
from particlerb.forces.attraction import Attraction, add_near_source
from particlerb.forces.gravity_tree.multipole import ORDER
from particlerb.forces.gravity_tree.tree import Tree
from particlerb.maths.rows import column3, rows3
from particlerb.maths.vec3 import Floats, Ints

SAMPLE: Final = 512  # particles: some 5 % of the time of an evaluation, whatever their number
WIDEST: Final = 1.0
_WORST_ERROR: Final = 0.1  # of any scene, over θ^{p+1}; measured by benchmarks/attraction.py
_AIMED_SHARE: Final = 0.55  # of the error asked for: bodies move, a sample errs by a tenth or so
_FIRST_ANGLE_FACTOR: Final = 1.5  # over the safe angle
_CLOSE_PAIR_PERCENTILE: Final = 99.0  # above which fields are those of close pairs


def safe_angle(accuracy: float) -> float:
    """Opening angle θ [rad] at which no scene that was measured errs by more than `accuracy`.

    The error, √(Σ |Δa|²/Σ |a|²) over bodies, is _WORST_ERROR θ^{p+1} at most.
    """
    return min(WIDEST, float(np.exp(np.log(accuracy / _WORST_ERROR) / (ORDER + 1))))


def fitting_angle(attraction: Attraction, y: Floats, accuracy: float) -> float:
    """Opening angle θ [rad] that keeps to an error in a scene as it is.

    Parameters
    ----------
    attraction : Attraction
    y : ndarray, shape (13, n_bodies)
        Centre of mass [m], unit quaternion from rotor frame to world; the rest is not used.
    accuracy : float
        Relative error of the accelerations, rms.

    Returns
    -------
    float
        `safe_angle` at least.
    """
    least = safe_angle(accuracy)
    tree = Tree(attraction, min(_FIRST_ANGLE_FACTOR * least, WIDEST))
    for _ in range(2):  # the second corrects what is not a power
        tree.walk(y)
        error = max(sampled_error(tree), np.finfo(np.float64).tiny)
        tree.angle = float(np.clip(other_angle(tree.angle, error, accuracy), least, WIDEST))
    return tree.angle


def other_angle(angle: float, error: float, accuracy: float) -> float:
    """Opening angle [rad] for an accuracy, from what a scene errs at another angle."""
    return float(angle * (_AIMED_SHARE * accuracy / error) ** (1.0 / (ORDER + 1)))


def sampled_error(tree: Tree) -> float:
    """Relative error of the fields that a tree has found last, rms, at some particles.

    Fields of close pairs, which are right in any case, would hide the errors of all others: they
    count as no larger than those of most particles.
    """
    points = tree.points
    n = points.mass.size
    sample = np.arange(min(n, SAMPLE)) * n // min(n, SAMPLE)
    exact = np.zeros((3, sample.size))
    THREADS.alone(
        _direct_fields, points.place, points.mass, points.owner, sample, tree.softening, exact
    )
    squares = (exact * exact).sum(axis=0)
    usual = np.minimum(squares, np.percentile(squares, _CLOSE_PAIR_PERCENTILE)).mean()
    off = ((points.field[:, sample] - exact) ** 2).sum(axis=0).mean()
    return float(np.sqrt(off / usual)) if usual > 0.0 else 0.0


@kernel
def _direct_fields(
    place: Floats, mass: Floats, owner: Floats, sample: Ints, eps2: float, field: Floats
) -> None:
    """Add Σ m_j d/(d² + ε²)^{3/2} over the particles of other bodies, at chosen particles."""
    chosen, n, bodies = place[:, sample], sample.size, owner[sample]
    sources, targets, fields = rows3(place, 0, mass.size), rows3(chosen, 0, n), rows3(field, 0, n)
    for j in range(mass.size):
        x = column3(sources, j)
        add_near_source(x, mass[j], owner[j], eps2, targets, fields, bodies)
