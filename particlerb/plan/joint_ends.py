"""Between which bodies joints stand, where, and about which axes."""

from collections.abc import Sequence
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from particlerb.case.joints import InFrame, JointTable
from particlerb.case.problems import Problem, problem_at
from particlerb.contact.sphere_search import pair_keys
from particlerb.forces.links import WORLD
from particlerb.joints.types import Ends
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.merging import Merging
from particlerb.model.state import axes_across, body_orientation, lengths, rotate, rotate_back
from particlerb.model.system import System

_MAX_DISTANCE: Final = 1e100  # [m] of its bodies that a joint may be: squares of it are numbers
_MIN_ROLLING_RADIUS: Final = 1e-9  # over the size of its joint
_MAX_RACK_COSINE: Final = 1e-6  # of the angle between the axis of a pinion and its rack
FramedVector: TypeAlias = tuple[float, float, float] | InFrame


class Ties(NamedTuple):
    """Bodies that joints tie."""

    record: Ints  # index of [[joint]]
    body_a: Ints  # bodies of the system
    body_b: Ints  # bodies, or WORLD


def pairs_of(system: System, table: JointTable) -> tuple[Ints, Ints]:
    """Bodies at both ends of each joint of a table."""
    first = system.names.find_in_order(table.body).reshape(system.n_worlds, -1)
    if table.chain:
        return first[:, 1:].ravel(), first[:, :-1].ravel()
    if table.to is None:
        return first.ravel(), np.full(first.size, WORLD)
    second = system.names.find_in_order(table.to).reshape(system.n_worlds, -1)
    return first.ravel(), np.broadcast_to(second, first.shape).ravel()


def excluded_pairs(system: System) -> Ints:
    """Pairs of bodies that joints tie and that are not to touch each other, ascending keys."""
    keys = [np.zeros(0, dtype=np.int64)]
    for table in system.joint:
        first, second = pairs_of(system, table)
        if not table.collide:
            inside = second != WORLD
            keys.append(pair_keys(first[inside], second[inside]))
    return np.unique(np.concatenate(keys))


def _frames(system: System, bodies: Ints) -> tuple[Floats, Floats, Floats]:
    """Centres of mass (3, k), body frames and rotor frames (4, k); of the world 0 and no turn."""
    inside = bodies != WORLD
    index = np.where(inside, bodies, 0)
    com = np.where(inside, system.state.com[:, index], 0.0)
    none = np.array([[1.0], [0.0], [0.0], [0.0]])
    rotor = np.where(inside, system.state.q[:, index], none)
    orientation = body_orientation(system.state.q[:, index], system.bodies.rotor_frame[:, index])
    body = np.where(inside, orientation, none)
    return com, body, rotor


@np.errstate(over="ignore", invalid="ignore")  # such a size is refused
def ends_of(system: System, table: JointTable, first: Ints, second: Ints) -> Ends:
    """Points and directions of the joints of a table, in rotor frames."""
    k = first.size
    com_a, body_a, rotor_a = _frames(system, first)
    com_b, body_b, rotor_b = _frames(system, second)

    def spread(vector: tuple[float, ...]) -> Floats:
        return np.tile(np.array(vector)[:, None], k)

    def point(vector: FramedVector | None, com: Floats, q: Floats, default: Floats) -> Floats:
        if vector is None:
            return default
        if isinstance(vector, InFrame):
            return rotate(q, spread(vector.body)) + com
        return spread(vector)

    def direction(vector: FramedVector, q: Floats) -> Floats:
        vectors = spread(vector.body if isinstance(vector, InFrame) else vector)
        vectors = np.ldexp(vectors, -np.frexp(np.abs(vectors).max(axis=0))[1])
        vectors = rotate(q, vectors) if isinstance(vector, InFrame) else vectors
        return vectors / lengths(vectors)

    here = point(table.at, com_a, body_a, com_a)
    stands_apart = table.type in ("distance", "gear")
    there = point(table.at_to, com_b, body_b, com_b if stands_apart else here)
    world = {"n": direction(table.axis or (0.0, 0.0, 1.0), body_a)}
    world["e"], world["f"] = axes_across(world["n"])
    if table.axis_to is not None:
        world["m"] = direction(table.axis_to, body_b)
        world["l"] = np.cross(world["m"], world["n"], axis=0)
    roll, world["mark"] = _rolling(table, there - here, world)
    first_at, second_at = rotate_back(rotor_a, here - com_a), rotate_back(rotor_b, there - com_b)
    length = lengths(here - there)
    size = np.maximum(lengths(first_at), np.where(second == WORLD, 0.0, lengths(second_at)))
    size = np.maximum(size, length if table.type == "distance" else 0.0)
    reach = system.reach[system.kind[first]]
    size = np.where(size > 1e-3 * reach, size, np.where(reach > 0.0, reach, 1.0))
    axes = dict(zip("xyz", np.eye(3)[:, :, None] * np.ones(k), strict=True))
    return Ends(
        first,
        second,
        first_at.T,
        second_at.T,
        {name: rotate_back(rotor_a, axis).T for name, axis in world.items()},
        {name: rotate_back(rotor_b, axis).T for name, axis in world.items()}
        | {name: axis.T for name, axis in axes.items()}
        | {"at": rotate_back(rotor_b, here - com_b).T},
        length,
        size,
        roll,
    )


def _rolling(table: JointTable, between: Floats, world: dict[str, Floats]) -> tuple[Floats, Floats]:
    """k, z_b/z_a and pitch of what rolls, (k, 3), and where the marks of both bodies are, (3, k).

    `between` leads from the point of the first body to that of the second.
    """
    n, roll = world["n"], np.zeros((between.shape[1], 3))
    if table.type == "gear":
        teeth, teeth_to = table.teeth or (1, 1)
        line = between - n * (n * between).sum(axis=0)
        distance = lengths(line)
        roll[:, 0], roll[:, 1] = distance * teeth / (teeth + teeth_to), teeth_to / teeth
        roll[:, 2] = 2.0 * np.pi * np.abs(roll[:, 0]) / abs(teeth)
        return roll, line / np.where(distance > 0.0, distance, 1.0)
    if table.type == "rack":
        roll[:, 0] = -(between * np.cross(n, world["m"], axis=0)).sum(axis=0)
    elif table.type == "screw":
        roll[:, 0] = -(table.lead or 0.0) / (2.0 * np.pi)
    roll[:, 2] = 2.0 * np.pi * np.abs(roll[:, 0])
    return roll, world["e"]


def wrong_place(system: System, number: int, ends: Ends) -> Problem | None:
    """What is wrong with where a joint is: points that are to be apart, or too far from bodies."""
    table, key = system.joint[number], f"joint[{number}]"
    name = joint_name(system, table, ends.a, ends.b, 0)
    if table.type == "distance" and not ends.length.all():
        return problem_at(system, key, f"{name} has no length", "give points apart")
    is_tiny = (np.abs(ends.roll[:, 0]) < _MIN_ROLLING_RADIUS * ends.size).any()
    if table.type in ("rack", "gear") and is_tiny:
        hint = "give `at` and `at_to` apart, across the axis"
        return problem_at(system, key, f"{name} has no pitch radius", hint)
    if table.type == "rack":
        across = np.abs((ends.directions_b["n"] * ends.directions_b["m"]).sum(axis=1)).max()
        if across > _MAX_RACK_COSINE:
            reason = f"{name} is not across `axis`: it would not roll"
            return problem_at(system, f"{key}.axis_to", reason, "let it stand across")
    if (ends.size < _MAX_DISTANCE).all():
        return None
    reason = f"acts too far from its bodies: squares overflow beyond {_MAX_DISTANCE:g} m"
    return problem_at(system, f"{key}.at", reason, "place it nearer")


def in_hosts(ends: Ends, merging: Merging) -> Ends:
    """The same joints between the bodies that carry theirs."""

    def carried(bodies: Ints, name: str, vectors: Floats) -> Floats:
        inside, turned = bodies != WORLD, vectors.copy()
        if name not in ("x", "y", "z"):
            turned[inside] = merging.in_hosts(bodies[inside], vectors[inside], name == "at")
        return turned

    def host(bodies: Ints) -> Ints:
        return np.where(bodies == WORLD, WORLD, merging.host[bodies])

    return ends._replace(
        a=host(ends.a),
        b=host(ends.b),
        at_a=carried(ends.a, "at", ends.at_a),
        at_b=carried(ends.b, "at", ends.at_b),
        directions_a={name: carried(ends.a, name, v) for name, v in ends.directions_a.items()},
        directions_b={name: carried(ends.b, name, v) for name, v in ends.directions_b.items()},
    )


def joint_name(system: System, table: JointTable, first: Ints, second: Ints, k: int) -> str:
    """Name of one joint of a table."""
    if table.name is not None:
        return table.name if first.size == 1 else f"{table.name}[{k}]"
    other = "world" if second[k] == WORLD else system.names[int(second[k])]
    return f"{system.names[int(first[k])]}-{other}"


def unique(names: Sequence[str], is_given: Sequence[bool]) -> tuple[str, ...]:
    """The names, those that others have with a number behind them; given ones have theirs first."""
    labels, seen = list(names), dict[str, int]()
    for j in sorted(range(len(names)), key=lambda j: not is_given[j]):
        own, k = names[j], seen.get(names[j], 0)
        while own in seen:
            own, k = f"{names[j]} ({k + 1})", k + 1
        labels[j] = own
        seen[own], seen[names[j]] = 1, max(k, 1)
    return tuple(labels)
