"""Impulses on bodies that joints hold together: the whole mechanism moves, and the joints hold.

So joints are eliminated: a contact of a mechanism has the inverse mass that the mechanism has at
its point, and what solves contacts is the same for bodies by themselves and those in mechanisms.
Where there are no joints, nothing of this is compiled.
"""

from particlerb.compiled.jit import inline
from particlerb.impulses.records import Mechanisms
from particlerb.maths.vec3 import Bools, Floats, Vec3


@inline
def push_mechanism(
    mechanisms: Mechanisms | None, velocity: Floats, b: int, p: Vec3, m: Vec3
) -> bool:
    """Change the velocities of all that joints tie to partner b; whether there is anything.

    Parameters
    ----------
    mechanisms : Mechanisms, optional
        With the response of b.
    velocity : ndarray, shape (partners, 6)
    b : int
    p, m : tuple of 3 floats [N s, N m s]
        Impulse and angular impulse on b.
    """
    if mechanisms is None:
        return False
    c, response = mechanisms.number[b], mechanisms.response
    if c < 0:
        return False
    first, last = mechanisms.first[c], mechanisms.first[c + 1]
    w = 6 * (last - first)
    at = mechanisms.start[c] + 6 * w * mechanisms.local[b]
    for k in range(first, last):
        other = mechanisms.member[k]
        for i in range(6):
            change = p[0] * response[at] + p[1] * response[at + w] + p[2] * response[at + 2 * w]
            change += m[0] * response[at + 3 * w] + m[1] * response[at + 4 * w]
            velocity[other, i] += change + m[2] * response[at + 5 * w]
            at += 1
    return True


@inline
def count_members(mechanisms: Mechanisms | None, b: int) -> int:
    """How many bodies move where partner b is pushed."""
    if mechanisms is None:
        return 1
    c = mechanisms.number[b]
    return 1 if c < 0 else mechanisms.first[c + 1] - mechanisms.first[c]


@inline
def member(mechanisms: Mechanisms | None, b: int, j: int) -> int:
    """One of them."""
    if mechanisms is None:
        return b
    c = mechanisms.number[b]
    return b if c < 0 else mechanisms.member[mechanisms.first[c] + j]


@inline
def has_response(mechanisms: Mechanisms | None, b: int) -> bool:
    """Whether it is known how partner b is moved: something touches it, or no joint holds it."""
    if mechanisms is None:
        return True
    return bool(mechanisms.number[b] < 0 or mechanisms.is_known[b])


@inline
def through_joints(
    mechanisms: Mechanisms | None, body: int, source: int, i: int, v: Vec3, omega: Vec3
) -> tuple[Vec3, Vec3]:
    """Velocities of a body by unit i of an impulse on another; v and omega where none is tied."""
    if mechanisms is None:
        return v, omega
    c, response = mechanisms.number[body], mechanisms.response
    if c < 0:
        return v, omega
    w = 6 * (mechanisms.first[c + 1] - mechanisms.first[c])
    at = mechanisms.start[c] + (6 * mechanisms.local[source] + i) * w + 6 * mechanisms.local[body]
    v = (response[at], response[at + 1], response[at + 2])
    return v, (response[at + 3], response[at + 4], response[at + 5])


@inline
def all_have_moved(mechanisms: Mechanisms | None, has_moved: Bools, b: int) -> None:
    """Say that all that joints tie to partner b has moved with it."""
    if mechanisms is None:
        return
    c = mechanisms.number[b]
    if c >= 0:
        for k in range(mechanisms.first[c], mechanisms.first[c + 1]):
            has_moved[mechanisms.member[k]] = True
