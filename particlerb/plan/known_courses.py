"""What the start of a run tells of a motion: bodies that turn about one axis, or move on a line.

A body that turns about a principal axis goes on so while all that turns it is along that axis. The
rest must be exactly zero, since about the middle axis a rounding grows as e^{λt}; only where it
cannot grow (spheres, rods, symmetric bodies about their axis) it may be a rounding. A motion stays
on a line while all forces are along it, exactly.

All that has acted since the start counts, and nothing of what a state comes to be later: so a run
and its continuation have the same plan.
"""

import copy
from collections.abc import Sequence
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from particlerb.forces import FIXED_LINE, Terms, force_of_loads
from particlerb.forces.central import Central
from particlerb.forces.impulse import Impulse
from particlerb.forces.links import WORLD
from particlerb.forces.spring import Spring
from particlerb.maths.double_double import exact_difference
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.bodies import Bodies
from particlerb.model.state import State, cross_columns, exact_matrix, lengths, rotate_back
from particlerb.model.worlds import WorldsDifferError
from particlerb.rotors.rotor_class import ROD, SPHERE, SYMMETRIC
from particlerb.stepping.closed_forms import has_closed_form, lever_of, torques_on

_AT_REST, _LOST = -2, -1
_VECTOR_ROUNDING: Final = 4e-15  # share of a vector that is its rounding, where it cannot grow
_FAR_ASIDE: Final = 1e-10  # share of a vector that no rounding is


class Stretch(NamedTuple):
    """A segment of a group, as far as it matters here."""

    terms: Terms
    jumps: tuple[Impulse, ...]  # at its start


class Courses:
    """What is known of bodies by all that has acted on them since the start of the run."""

    def __init__(self, bodies: Bodies, state: State) -> None:
        self.turning, self.straight = _Turning(bodies, state), _Straight(bodies, state)
        self.asked = False  # whether something might have used it

    def copied(self) -> "Courses":
        """The same, to go on by itself."""
        other = copy.copy(self)
        other.turning, other.straight = copy.copy(self.turning), copy.copy(self.straight)
        other.turning.axis = self.turning.axis.copy()  # these two are written in place
        other.straight.holds = self.straight.holds.copy()
        return other

    @np.errstate(over="ignore", invalid="ignore")
    def under(self, stretch: Stretch) -> Terms:
        """Go on into a stretch: its terms with what is known."""
        terms = stretch.terms
        self.asked |= _asks(terms)
        for jump in stretch.jumps:
            self.turning.jump(jump)
            self.straight.jump(jump)
        axis, on_line = self.turning.axis_under(terms), self.straight.under(terms)
        if axis is None and on_line is None:
            return terms
        return terms._replace(axis=axis, is_straight=on_line)

    def leave(self, is_closed: Bools) -> None:
        """Leave a stretch in which these bodies had a closed form."""
        self.turning.axis[~is_closed] = _LOST
        self.straight.leave(is_closed)


class Behind(NamedTuple):
    """What a group has left behind that shall not be planned again."""

    begin: float  # [s] of the segment that it is in
    courses: Courses | None  # before that; None where it has no closed form by its method


def with_known_courses(
    bodies: Bodies,
    state: State,
    stretches: Sequence[Stretch],
    scene: Ints | None,
    courses: Courses | None = None,
) -> list[tuple[Terms, Bools]]:
    """Terms of all segments with what is known, and which bodies then have a closed form.

    Parameters
    ----------
    bodies, state
        Of a group, at the start of the run.
    scene : ndarray, shape (n,), optional
        Of each body, where those of a scene have a closed form together, or none of them.
    courses : Courses, optional
        What is known before the first stretch, where the run does not start with it.

    Raises
    ------
    WorldsDifferError
        If only some of them have one.
    """
    closed_by_terms: dict[int, Bools] = {}  # by terms, which stretches without a load share

    def closed(terms: Terms) -> Bools:
        """Which bodies have a closed form under terms that are kept."""
        if id(terms) not in closed_by_terms:
            closed_by_terms[id(terms)] = _closed(bodies, terms, scene)
        return closed_by_terms[id(terms)]

    is_needed = courses is not None and courses.asked
    if not (is_needed or any(_asks(stretch.terms) for stretch in stretches)):
        return [(one.terms, closed(one.terms)) for one in stretches]
    courses, results = Courses(bodies, state) if courses is None else courses.copied(), []
    for stretch in stretches:
        terms = courses.under(stretch)
        is_closed = closed(terms)
        courses.leave(is_closed)
        results.append((terms, is_closed))
    return results


def _closed(bodies: Bodies, terms: Terms, scene: Ints | None) -> Bools:
    """Which bodies have a closed form; all or none where they belong together."""
    is_closed = has_closed_form(bodies, terms)
    if scene is None or is_closed.all():
        return is_closed
    if np.unique(scene[~is_closed]).size < np.unique(scene).size:
        raise WorldsDifferError("some scenes have a closed form")
    return np.zeros_like(is_closed)


def _asks(terms: Terms) -> bool:
    """Whether what is known may give a closed form."""
    if terms.links is not None and terms.links.damping is not None:
        return True
    torque, drag = torques_on(terms, 1) if terms.loads else (np.zeros(0), np.zeros(0))
    return bool(torque.any() or drag.any()) or lever_of(terms) is not None


def _are_parallel(u: Floats, v: Floats) -> Bools:
    """Whether vectors (3, n) are parallel, exactly."""
    pairs = (1, 2), (2, 0), (0, 1)
    crossed = np.array([exact_difference(u[i], v[j], u[j], v[i]) for i, j in pairs])
    return np.asarray(~crossed.any(axis=0))


class _Turning:
    """About which principal axis bodies turn."""

    def __init__(self, bodies: Bodies, state: State) -> None:
        n = bodies.mass.size
        self.bodies, self.q = bodies, state.q
        self.axis, self.line = np.full(n, _AT_REST), np.zeros((3, n))
        self.is_exact = np.ones(n, dtype=bool)
        self.meet(state.L)

    @cached_property
    def matrix(self) -> Floats:
        """|q|² R, zero only where it is; (3, 3, n)."""
        return exact_matrix(self.q)

    def is_astray(self, v: Floats) -> bool:
        """Whether each that vectors (3, n) turn is far from turning about a principal axis."""
        code = self.bodies.rotor_class
        across = np.sort(np.abs(rotate_back(self.q, v)), axis=0)[1]
        may_turn = (across <= _FAR_ASIDE * np.abs(v).max(axis=0)) | (code == SPHERE) | (code == ROD)
        return not (may_turn & v.any(axis=0)).any()

    def meet(self, v: Floats) -> None:
        """Something turns bodies about vectors (3, n) in the world; zero: nothing does."""
        if (self.axis == _LOST).all() or not v.any():
            return
        if self.is_astray(v):
            self.axis = np.where(v.any(axis=0), _LOST, self.axis)
            return
        turned, old = np.abs(np.einsum("ijn,in->jn", self.matrix, v)), self.axis
        k = turned.argmax(axis=0)
        size, across = turned.max(axis=0), np.sort(turned, axis=0)[1]
        code = self.bodies.rotor_class
        is_along = (code == SYMMETRIC) & (k == 2) & (across <= _VECTOR_ROUNDING * size)
        aside = lengths(cross_columns(v, self.line))
        is_along |= ((code == SPHERE) | (code == ROD)) & (
            aside <= _VECTOR_ROUNDING * lengths(v) * lengths(self.line)
        )
        is_first = old == _AT_REST
        is_exact = self.is_exact & (across == 0.0) & (is_first | (old == k))
        loose = np.where(code == SYMMETRIC, 2, FIXED_LINE)
        is_loose = is_along & (is_first | np.where(code == SYMMETRIC, old == 2, old >= 0))
        now = np.where(is_exact, k, np.where(is_loose, loose, _LOST))
        acts = v.any(axis=0) & (old != _LOST)
        self.axis = np.where(acts, now, old)
        self.is_exact = np.where(acts, is_exact, self.is_exact)
        self.line = np.where(acts & is_first, v, self.line)

    def meet_lever(self, lever: Floats) -> None:
        """Forces act on levers, (9, n) as `Push.lever`: in the plane of the motion, or not."""
        if (self.axis == _LOST).all():
            return
        T, b = lever.reshape(3, 3, -1), np.arange(self.axis.size)  # [world, rotor frame]
        self.meet(sum((cross_columns(self.matrix[:, k], T[:, k]) for k in range(3)), 0.0 * T[:, 0]))
        k = np.maximum(self.axis, 0) % FIXED_LINE
        n = self.matrix[:, k, b]
        along = np.einsum("in,ikn->kn", n, T)  # arms of the force along the axis
        along[k, b] = 0.0
        is_planar = _are_parallel(T[:, k, b], n) & ~along.any(axis=0)
        is_planar &= self.is_exact & (self.axis >= 0) & (self.axis < FIXED_LINE)
        self.axis[lever.any(axis=0) & ~is_planar] = _LOST

    def jump(self, jump: Impulse) -> None:
        """An impulse acts; one that is given in the body is not looked into."""
        lever = (jump.impulse[:, None] * jump.at).reshape(9, -1)
        if jump.follows:
            self.axis[lever.any(axis=0)] = _LOST
        else:
            self.meet_lever(lever)

    def axis_under(self, terms: Terms) -> Ints | None:
        """Axis of each body, if it holds under these terms; None where nothing asks for it."""
        lever, (torque, drag) = lever_of(terms), torques_on(terms, self.axis.size)
        if torque.any():
            self.meet(torque)
        if lever is not None:
            self.meet_lever(lever)
        asks = lever is not None or torque.any() or drag.any()
        return np.where(self.axis == _AT_REST, 0, self.axis) if asks else None


class _Straight:
    """Which bodies move on a line."""

    def __init__(self, bodies: Bodies, state: State) -> None:
        self.bodies, self.state = bodies, state
        n = bodies.mass.size
        self.holds, self.is_alone = np.ones(n, dtype=bool), True
        self.partners: Ints | None = None  # of pairs that links have tied
        self.line = np.zeros((3, n))
        self.meet(state.p)

    def meet(self, v: Floats) -> None:
        """Vectors (3, n) that must be along the line."""
        if not (self.holds.any() and v.any()):
            return
        known = self.line.any(axis=0)
        if known.any():
            self.holds &= _are_parallel(v, self.line)
        self.line = np.where(known, self.line, v)

    def jump(self, jump: Impulse) -> None:
        """An impulse acts."""
        self.is_alone = False
        self.meet(jump.impulse)
        self.holds &= ~(jump.impulse.any(axis=0) & jump.follows)

    def under(self, terms: Terms) -> Bools | None:
        """Whether they do under these terms; None where no damping asks for it."""
        links, n = terms.links, self.holds.size
        to_world = links is not None and bool((links.body_b == WORLD).any())
        self.is_alone &= not terms.loads and not to_world
        if any(isinstance(load, Central) for load in terms.loads):
            self.holds[:] = False
        if links is not None and (links.body_b != WORLD).any():
            partners = np.full(n, WORLD)
            partners[links.body_a], partners[links.body_b] = links.body_b, links.body_a
            previous = partners if self.partners is None else self.partners
            self.is_alone &= bool((partners == previous).all())
            self.partners, self.holds[:] = partners, False  # pairs are not followed in the world
            x, v = self.state.com, self.state.p * self.bodies.inv_mass
            is_straight = np.ones(n, dtype=bool)
            apart = [u[:, links.body_b] - u[:, links.body_a] for u in (x, v)]
            askew = ~_are_parallel(*apart)
            is_straight[links.body_a[askew]] = is_straight[links.body_b[askew]] = False
            return is_straight & self.is_alone if links.damping is not None else None
        force = force_of_loads(terms, n)
        if terms.gravity is not None:
            force = force + terms.gravity.mass * terms.gravity.acceleration[:, None]
        self.meet(force)
        for spring in (load for load in terms.loads if isinstance(load, Spring)):
            self.meet(self.state.com - spring.anchor)
        if links is None:
            return None
        left = np.arange(links.body_a.size)
        while left.size:  # one link of each body after the other
            bodies, index = np.unique(links.body_a[left], return_index=True)
            y = np.zeros((3, n))
            y[:, bodies] = self.state.com[:, bodies] - links.at_b[:, left[index]]
            self.meet(y)
            left = np.delete(left, index)
        return self.holds.copy()

    def leave(self, is_closed: Bools) -> None:
        """A segment ends in which these bodies had a closed form."""
        self.holds &= is_closed
        self.is_alone &= bool(is_closed.all())
