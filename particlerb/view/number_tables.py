"""The numbers of one body beside the hand calculation of its last push, as text and as a table.

A number is shown with the digits that are asked for; `…` follows where the float has more, so that
nothing is rounded silently; numbers that end within them are shown whole. Knows HTML, no browser.
"""

import html
import math
from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np

from particlerb.case.shapes import AnyShape, Box
from particlerb.maths.vec3 import Floats
from particlerb.model.bodies import taken
from particlerb.model.state import derived, inertia_in_body, rotate_back, rotation_matrix
from particlerb.model.system import System
from particlerb.view.session import AppliedPush

MOST_DIGITS: Final = 17  # that a float64 needs to be told from all others
_NOISE_DIGITS: Final = 13  # digits of the largest number of a quantity behind which rounding begins
_DIFFERENCE_DIGITS: Final = 2
_MAX_NARROW_DIGITS: Final = 6  # up to which three numbers stand side by side
_ELLIPSIS: Final = "…"
_STYLE: Final = """<style>
.pb{font:11.5px/1.5 ui-monospace,SFMono-Regular,Menlo,Consolas,monospace}
.pb{color:#1b1f24;padding:0 14px 8px 8px}
.pb b{font:600 13px system-ui,sans-serif}
.pb h4{margin:9px 0 2px;font:600 11px/1.3 system-ui,sans-serif;color:#b4530a;
letter-spacing:.04em;border-bottom:1px solid #e6e8eb}
.pb div{display:flex;gap:5px;white-space:pre}.pb div.t{margin-top:4px}
.pb u{flex:0 0 8em;font:12px/1.45 system-ui,sans-serif;color:#57606a;text-decoration:none}
.pb u.s{flex-basis:1.5em}.pb span{flex:1 1 0;text-align:right}
.pb p{margin:0 0 3px;font:12px/1.4 system-ui,sans-serif;color:#57606a;white-space:normal}
.pb i{color:#8b949e;font-style:normal}</style>"""


class NumberRow(NamedTuple):
    """A quantity: a word for tests and screen readers, what is shown, and its numbers."""

    key: str
    label: str
    values: tuple[float, ...]
    scale: float
    """What is small is told by it: the largest number of the vector, or tensor."""


class NumberGroup(NamedTuple):
    """Quantities under a heading."""

    title: str
    rows: tuple[NumberRow, ...]
    remarks: tuple[str, ...] = ()


class BodyMotion(NamedTuple):
    """State of one body, outside view."""

    position: Floats  # (3,) [m]
    orientation: Floats  # (4,)
    linear_momentum: Floats  # (3,) [kg m/s]
    angular_momentum: Floats  # (3,) [kg m²/s]
    velocity: Floats  # (3,) [m/s]
    angular_velocity: Floats  # (3,) [rad/s]

    @property
    def kinetic_energy(self) -> float:
        """½ p·v + ½ L·ω [J]."""
        linear = float(self.linear_momentum @ self.velocity)
        return 0.5 * (linear + float(self.angular_momentum @ self.angular_velocity))


def motion_of(system: System, b: int, *state: Floats) -> BodyMotion:
    """Motion of body b from position, orientation and momenta of all bodies, (N, 3) and (N, 4)."""
    x, q, p, L = (np.array(values[b], dtype=np.float64) for values in state)
    bodies = taken(system.bodies, np.array([b]))
    v, omega = derived(bodies, q[None, None], p[None, None], L[None, None])
    return BodyMotion(x, q, p, L, v[0, 0], omega[0, 0])


def shown(value: float, digits: int) -> str:
    """A number with so many digits; whole where these suffice, else with `…`."""
    if value == 0.0:
        return "0"  # of either sign
    rounded = f"{value:#.{digits}g}"  # with the zeros that are digits too
    return repr(value) if float(rounded) == value else f"{rounded}{_ELLIPSIS}"


def _texts(quantity: NumberRow, digits: int) -> list[str]:
    """Its numbers as they are shown; what rounding leaves beside larger ones is `0…`.

    With all 17 digits that is shown as well.
    """
    n_digits = _DIFFERENCE_DIGITS if quantity.key.startswith("difference_") else digits
    least = 0.0 if digits == MOST_DIGITS else quantity.scale * 10.0 ** -max(digits, _NOISE_DIGITS)
    is_noise = [0.0 < abs(value) < least for value in quantity.values]
    pairs = zip(quantity.values, is_noise, strict=True)
    return [f"0{_ELLIPSIS}" if small else shown(value, n_digits) for value, small in pairs]


def euler_deg(q: Floats) -> Floats:
    """Roll, pitch, yaw [°] of a unit quaternion: intrinsic z-y-x, as in a case."""
    w, x, y, z = (float(c) for c in q)
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x))))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.degrees([roll, pitch, yaw])


def fastest(system: System, p: Floats, L: Floats) -> float:
    """About how fast the fastest point of all bodies is [m/s], from momenta (N, 3)."""
    reach = np.maximum(system.reach[system.kind], 1e-300)
    speeds = np.linalg.norm(p, axis=1) + np.linalg.norm(L, axis=1) / reach
    return float((speeds / system.bodies.mass).max())


def state_parts(
    system: System, b: int, motion: BodyMotion, speed: float = 0.0
) -> list[NumberGroup]:
    """Everything that is known of a body now, beside a speed [m/s] of the whole scene."""
    M, reach = float(system.bodies.mass[b]), float(system.reach[system.kind[b]])
    rate = speed / max(reach, 1e-300)
    q = motion.orientation
    body = inertia_in_body(system.bodies, b)
    R = rotation_matrix(q)
    world = R @ body @ R.T
    spin = rotate_back(q, motion.angular_velocity)

    def tensor(key: str, values: Floats) -> tuple[NumberRow, ...]:
        largest = float(np.abs(values).max())
        return tuple(row(f"{key}-{k}", "xyz"[k], values[k], largest) for k in range(3))

    where = (
        row("position", "position  m", motion.position),
        row("orientation", "q", q),
        row("euler", "roll pitch yaw  °", euler_deg(q)),
    )
    moves = (
        row("velocity", "v  m/s", motion.velocity, speed),
        row("angular_velocity", "ω  rad/s", motion.angular_velocity, rate),
        row("angular_velocity_body", "ω, body axes", spin, rate),
        row("linear_momentum", "P  kg m/s", motion.linear_momentum, M * speed),
        row("angular_momentum", "L  kg m²/s", motion.angular_momentum, M * reach * speed),
        row("kinetic_energy", "energy  J", [motion.kinetic_energy]),
    )
    mass = (row("mass", "mass  kg", [M]),)
    principal = (row("moments", "principal", np.sort(system.bodies.inertia[:, b])),)
    return [
        NumberGroup("where", where),
        NumberGroup("how it moves", moves),
        NumberGroup("inertia, body axes  kg m²", mass + tensor("inertia", body) + principal),
        NumberGroup("inertia, world axes  kg m²", tensor("inertia_world", world)),
    ]


def push_part(applied: AppliedPush, drift: tuple[float, float] | None) -> NumberGroup:
    """What was done to the body last, and the errors of energy and L since it ended."""
    push = applied.push
    is_push = push.duration > 0.0
    times = [applied.start, applied.stop] if is_push else [applied.start]
    rows = [
        row("at", "body point  m", push.at),
        row("force", "F  N" if is_push else "J  N s", push.vector),
        row("lever", "lever arm r  m", applied.lever),
        row("torque", "r × F  N m" if is_push else "r × J  N m s", applied.torque),
        row("time", "from, to  s" if is_push else "at  s", times),
    ]
    if drift is not None:
        rows.append(row("drift", "errors: E, L", drift, 1.0))
    return NumberGroup("last push", tuple(rows))


def hand_part(
    system: System, applied: AppliedPush, motion: BodyMotion, is_over: bool, has_gravity: bool
) -> NumberGroup:
    """The hand calculation of the paper beside the solver: I, ΔL = r × F Δt, ΔP = F Δt, ω = L/I.

    The lever arm is taken as it is at the start. A push turns the body away under it, so that the
    solver's L differs by what the arm has changed; an impulse leaves no time for that.

    Parameters
    ----------
    motion : BodyMotion
        When the push ended, or now if it is not over.
    """
    push, b = applied.push, applied.push.body
    J = np.array(push.vector) * (push.duration or 1.0)
    hand_L = applied.angular_momentum + np.cross(applied.lever, J)
    hand_P = applied.linear_momentum + J
    mass = float(system.bodies.mass[b])
    rows: list[NumberRow] = []
    moments = _hand_moments(system.body[system.block[b]].shape, mass)
    if moments is not None:
        rows += beside("I", "I  kg m²", moments, np.diag(inertia_in_body(system.bodies, b)))
    rows += beside("L", "L  kg m²/s", hand_L, motion.angular_momentum)
    if moments is not None and np.ptp(moments) == 0.0:
        rows += beside("omega", "ω = L/I", hand_L / moments[0], motion.angular_velocity)
    rows += beside("v", "v = P/M  m/s", hand_P / mass, motion.velocity)
    remarks = _why_they_differ(applied, motion, is_over, has_gravity)
    return NumberGroup("by hand, and by the solver", tuple(rows), remarks)


def _why_they_differ(
    applied: AppliedPush, motion: BodyMotion, is_over: bool, has_gravity: bool
) -> tuple[str, ...]:
    """When both are compared, and why they differ by more than rounding."""
    if not is_over:
        return ("The push still acts.",)
    told = [f"At t = {applied.stop!r} s, when the push ended."]
    if applied.push.duration == 0.0:
        return (f"At t = {applied.stop!r} s, right after the impulse.",)
    turn = 2.0 * math.acos(min(1.0, abs(float(applied.orientation @ motion.orientation))))
    if turn > 0.0:
        angle = f"{math.degrees(turn):.2g}°"
        told.append(f"The body turned by {angle} during the push, and its lever arm with it.")
    if has_gravity:
        told.append("Gravity acted too: v differs by g Δt then, and by more at later times.")
    return tuple(told)


def _hand_moments(shape: AnyShape | None, mass: float) -> Floats | None:
    """Moments of a solid box M (b² + c²)/12, for a cube M a²/6 [kg m²]; None for other shapes."""
    if not isinstance(shape, Box):
        return None
    a, b, c = shape.size
    if a == b == c:
        return np.full(3, mass * a * a / 6.0)
    return mass * np.array([b * b + c * c, a * a + c * c, a * a + b * b]) / 12.0


def beside(key: str, label: str, hand: Iterable[float], solver: Iterable[float]) -> list[NumberRow]:
    """By hand, by the solver, and the difference."""
    hand, solver = np.array(list(hand)), np.array(list(solver))
    largest = float(np.abs(hand).max())
    return [
        row(f"hand_{key}", f"{label}", hand),
        row(f"solver_{key}", "  solver", solver, largest),
        row(f"difference_{key}", "  differs by", solver - hand, largest),
    ]


def row(key: str, label: str, values: Iterable[float], scale: float = 0.0) -> NumberRow:
    """Row of plain floats; its scale is at least the largest of them."""
    numbers = tuple(float(value) for value in values)
    return NumberRow(key, label, numbers, max(scale, *map(abs, numbers)))


def table(title: str, parts: Iterable[NumberGroup], digits: int) -> str:
    """HTML of quantities; the numbers of each lie in elements that carry its key."""
    lines = [_STYLE, f'<div class="pb" style="display:block"><b>{html.escape(title)}</b>']
    for group in parts:
        lines.append(f"<h4>{html.escape(group.title)}</h4>")
        lines += [f"<p>{html.escape(remark)}</p>" for remark in group.remarks]
        lines += [_html_row(quantity, digits) for quantity in group.rows]
    return "".join([*lines, "</div>"])


def _html_row(quantity: NumberRow, digits: int) -> str:
    """One quantity: side by side while there is room, else one below the other."""
    texts = [text.replace(_ELLIPSIS, f"<i>{_ELLIPSIS}</i>") for text in _texts(quantity, digits)]
    if digits > _MAX_NARROW_DIGITS:
        texts = ["<br>".join(texts)]
    begins = ' class="t"' if quantity.key.startswith("hand_") else ""
    is_long = len(texts) > 3
    label = f"<u{' class=s' if is_long else ''}>{html.escape(quantity.label)}</u>"
    cells = "".join(f'<span data-key="{quantity.key}">{text}</span>' for text in texts)
    empty = "<span></span>" * (3 - len(texts)) if digits <= _MAX_NARROW_DIGITS else ""
    return f"<div{begins}>{label}{cells}{empty}</div>"
