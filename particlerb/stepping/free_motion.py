"""Motion in closed form, at any time at once: a translation, and a rotation without steps.

The centre of mass is on a parabola, or under linear drag, or on springs without length
(translations.py, damped_oscillators.py). The body turns freely (rotors/exact.py), is Lagrange's top
or a pendulum (rotors/tops.py), or turns about a line by a torque and drag. Any time costs the same;
the error does not depend on how many frames were asked for.
"""

from collections.abc import Iterator
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import Flag, flag, inline, unfused_kernel
from particlerb.compiled.threads import BLOCK, THREADS
from particlerb.forces import FIXED_LINE
from particlerb.forces.drag import Drag
from particlerb.forces.torque import Torque
from particlerb.maths.quaternion import Rows4
from particlerb.maths.rows import column3, column4, put_column3, put_column4, rows3, rows4
from particlerb.maths.vec3 import Floats, Ints, Rows3, rows_of
from particlerb.model.block import COM, EXTERNAL, STRIDE, L, P, Q, get, get3, in_blocks
from particlerb.model.bodies import Bodies, taken
from particlerb.model.state import (
    CONJUGATE,
    Frames,
    State,
    load_last,
    quaternion_product,
    rotate,
    show,
    store_last,
    store_rows,
)
from particlerb.model.totals import N_TOTALS, BlockRows, sum_block
from particlerb.model.worlds import bins_among, over_bins, over_bodies, part_of_worlds, shape_of
from particlerb.rotors.exact import (
    HyperbolicTurn,
    SteadyTurn,
    ThetaTurn,
    by_kind,
    turn_block,
    turns_of,
)
from particlerb.rotors.tops import N_THETA, prepare_tops
from particlerb.stepping.closed_forms import (
    Levers,
    lever_of,
    levers_on,
    torques_on,
    translations_of,
    turned_about,
)
from particlerb.stepping.damped_oscillators import DampedOscillator, braked
from particlerb.stepping.motion import Motion, MotionError, SegmentGroup, constant_force, force_of
from particlerb.stepping.orbits import Orbit, orbited, orbits_of
from particlerb.stepping.saved_arrays import Saved
from particlerb.stepping.top_rows import top_block
from particlerb.stepping.translations import (
    N_EXTERNAL,
    Centres,
    Damping,
    ExternalWork,
    Oscillator,
    Spinning,
    add_drift,
    add_external,
    damped,
    parabola,
    sprung,
    spun,
)

_INPUT_ROWS: Final = 21  # rows of what a block starts from, and of its constants
_WEIGHTLESS: Final = np.zeros(3)
_AXIS_3: Final = np.array([[0.0], [0.0], [1.0]])


class _Part(NamedTuple):
    """Bodies of one kind of turn, as the kernel takes them; what does not act is None."""

    com: Rows3  # of the whole group, as the next seven
    p: Rows3
    L: Rows3
    force: Rows3
    rotor_frame: Rows4
    inv_mass: Floats
    mass: Floats
    inv_inertia: Rows3
    gravity: Floats  # (3,) [m/s²]
    bodies: Ints  # of the group, that these are
    drag: Damping | None = None
    spring: Oscillator | None = None
    braked: DampedOscillator | None = None
    drift: Floats | None = None
    orbit: Orbit | None = None
    spinning: Spinning | None = None
    steady: SteadyTurn | None = None
    theta: ThetaTurn | None = None
    hyperbolic: HyperbolicTurn | None = None
    top: Floats | None = None  # blocks of the tables of rotors/tops.py
    near: Floats | None = None
    changes_spin: Flag = None
    is_pair: Flag = None  # bodies that act on each other alone, and add no impulse

    @property
    def sums(self) -> bool:
        """Whether what forces give is summed by the kernel."""
        orbit_and_spring = (None, None) if self.is_pair else (self.orbit, self.spring)
        terms = (self.drag, self.braked, self.changes_spin, *orbit_and_spring)
        return terms.count(None) < len(terms)


class _Turned(NamedTuple):
    """What a force on their axis gives tops."""

    axes: Floats  # (4, n) from those in which it acts on axis 3 to the rotor frame
    first: Floats  # (..., 7) work, up to a constant, and L, when the segment begins


@inline
def _gather(part: _Part, lo: int, n: int, inputs: Floats) -> None:
    """Copy bodies from `lo` on into rows: x, p, L, force, rotor frame, 1/M, M, 1/I."""
    for b in range(n):
        j = part.bodies[lo + b]
        put_column3(rows3(inputs[0:3], 0, n), b, column3(part.com, j))
        put_column3(rows3(inputs[3:6], 0, n), b, column3(part.p, j))
        put_column3(rows3(inputs[6:9], 0, n), b, column3(part.L, j))
        put_column3(rows3(inputs[9:12], 0, n), b, column3(part.force, j))
        put_column4(rows4(inputs[12:16], 0, n), b, column4(part.rotor_frame, j))
        inputs[16, b], inputs[17, b] = part.inv_mass[j], part.mass[j]
        put_column3(rows3(inputs[18:21], 0, n), b, column3(part.inv_inertia, j))


@inline
def _translate(part: _Part, of: Centres, lo: int, t: float, external: Any) -> None:
    """Centres of mass of a block, by whatever moves them in closed form."""
    if part.drag is not None:
        damped(of, part.drag, lo, t, external)
    if part.spring is not None:
        sprung(of, part.spring, lo, t, external)
    if part.braked is not None:
        braked(of, part.braked, lo, t, external)
    if part.drift is not None:
        add_drift(of, part.drift, lo, t)
    if part.orbit is not None:
        orbited(of, part.orbit, lo, t, external)
    if part.drag is None and part.spring is None and part.braked is None and part.orbit is None:
        parabola(of, t)


@inline
def _move_block(
    part: _Part, k: int, t: float, of: Centres, q: Rows4, out: Floats, external: Any
) -> None:
    """State of block k after the time t, in rows of `out`; L where it changes."""
    lo, n = k * BLOCK, of.inv_mass.size
    turn_block(part.steady, part.theta, part.hyperbolic, t, lo, lo + n, q)
    if part.spinning is not None:
        spun(part.spinning, lo, lo + n, t, out, external)
    top_block(part.top, part.near, k, t, n, out)
    if part.top is not None or part.near is not None:
        for b in range(n):
            add_external(external, lo + b, get(out, EXTERNAL, b), (0.0, 0.0, 0.0), get3(out, L, b))
    _translate(part, of, lo, t, external)


@unfused_kernel
def _fly_blocks(
    part: _Part,
    times: Floats,
    rows: Ints,
    members: Ints,
    frames: Frames,
    binned: Floats | None,
    bins: Ints | None,
    sums: Floats,
    first: int,
    end: int,
) -> None:
    """All frames of some blocks of one kind of turn; times count from the state.

    Of as many frames as `sums` (T, bins, 10) has, the bodies are summed; without bins each block is
    one.
    """
    g, room = (part.gravity[0], part.gravity[1], part.gravity[2]), np.empty((N_TOTALS, STRIDE))
    out, inputs = np.empty((EXTERNAL + 1) * STRIDE), np.empty((_INPUT_ROWS, STRIDE))
    local, place = out.reshape((EXTERNAL + 1, STRIDE)), np.empty(BLOCK, np.int64)
    orientations = np.empty((8, STRIDE))
    for k in range(first, end):
        lo = k * BLOCK
        n = min(BLOCK, part.bodies.size - lo)
        _gather(part, lo, n, inputs)
        for b in range(n):
            place[b] = members[part.bodies[lo + b]]
        com, p = rows3(local[COM : COM + 3], 0, n), rows3(local[P : P + 3], 0, n)
        start, p0, F = rows3(inputs[0:3], 0, n), rows3(inputs[3:6], 0, n), rows3(inputs[9:12], 0, n)
        of = Centres(start, p0, F, inputs[16, :n], com, p)
        q, spin = rows4(local[Q : Q + 4], 0, n), rows3(inputs[6:9], 0, n)
        if part.changes_spin is not None:
            spin = rows3(local[L : L + 3], 0, n)
        frame, inverse = rows4(inputs[12:16], 0, n), rows3(inputs[18:21], 0, n)
        last, shown = rows4(orientations[0:4], 0, n), rows4(orientations[4:8], 0, n)
        load_last(frames, place[:n], last)
        summed = BlockRows(com, q, p, spin, inputs[17, :n], inputs[16, :n], inverse)
        for f in range(times.size):
            external = None if binned is None or bins is None else ExternalWork(binned[f], bins)
            _move_block(part, k, times[f], of, q, out, external)
            show(q, frame, last, frames.is_frame[rows[f]], shown)
            store_rows(frames, rows[f], place[:n], com, shown, p, spin)
            if f < sums.shape[0]:
                sum_block(summed, g, None if bins is None else bins[lo : lo + n], k, sums[f], room)
        store_last(frames, place[:n], last)


@unfused_kernel
def _end_blocks(part: _Part, t: float, end: State, external: ExternalWork | None) -> None:
    """State of the bodies of a part at one time; L only where it changes."""
    out, inputs = np.empty((EXTERNAL + 1) * STRIDE), np.empty((_INPUT_ROWS, STRIDE))
    local = out.reshape((EXTERNAL + 1, STRIDE))
    for k in range(-(-part.bodies.size // BLOCK)):
        lo = k * BLOCK
        n = min(BLOCK, part.bodies.size - lo)
        _gather(part, lo, n, inputs)
        com, p = rows3(local[COM : COM + 3], 0, n), rows3(local[P : P + 3], 0, n)
        start, p0, F = rows3(inputs[0:3], 0, n), rows3(inputs[3:6], 0, n), rows3(inputs[9:12], 0, n)
        of = Centres(start, p0, F, inputs[16, :n], com, p)
        _move_block(part, k, t, of, rows4(local[Q : Q + 4], 0, n), out, external)
        for b in range(n):
            j = part.bodies[lo + b]
            for i in range(4):
                end.q[i, j] = local[Q + i, b]
            for i in range(3):
                end.com[i, j], end.p[i, j] = local[COM + i, b], local[P + i, b]
                if part.changes_spin is not None:
                    end.L[i, j] = local[L + i, b]


class FreeMotion(Motion):
    """A group of bodies in closed form, sorted into kinds of turn; see `motion.Motion`."""

    def __init__(self, group: SegmentGroup, state: State, start: float) -> None:
        self.group, self.state, self.start = group, state, start
        self.moves = moves = translations_of(group, state)
        self.orbit = orbits_of(group, state)
        self.is_pair = moves.drift is not None or bool(self.orbit and group.terms.is_coupled)
        p = state.p  # relative to what carries pairs
        if moves.drift is not None:
            p = p - group.bodies.mass * moves.drift
        self.rows = rows_of(state.com), rows_of(p), rows_of(state.L), rows_of(force_of(group)[1])
        is_constant = group.terms.gravity is not None or bool(group.terms.loads)
        no_parabola = moves.drag, moves.spring, moves.braked, self.orbit
        is_constant &= self.is_pair or no_parabola.count(None) == len(no_parabola)
        self.constant = constant_force(group, state) if is_constant else None
        self.parts = list(self.sorted_parts())

    def sorted_parts(self) -> Iterator[tuple[Ints, _Part, _Turned | None]]:
        """Bodies of each kind of turn, what the kernel takes, and what turns them."""
        bodies, state = self.group.bodies, self.state
        terms, free = self.group.terms, np.arange(bodies.mass.size)
        lever = lever_of(terms)
        if lever is not None:
            levers = levers_on(bodies, lever)
            if terms.axis is not None:
                levers = turned_about(levers, bodies, lever, terms.axis, state.q)
            yield from self.top_parts(levers)
            free = np.flatnonzero(levers.is_free)
        if terms.loads and any(isinstance(load, Drag | Torque) for load in terms.loads):
            torque, drag = torques_on(terms, bodies.mass.size)
            is_spun = (drag[free] > 0.0) | torque[:, free].any(axis=0)
            if is_spun.any():
                yield self.spun_part(free[is_spun], torque, drag)
                free = free[~is_spun]
        if not free.size:
            return
        if free.size < bodies.mass.size:
            bodies, state = taken(bodies, free), taken(state, free)
        for among, turn in turns_of(bodies.inertia, bodies.rotor_class, state.q, state.L):
            index = free[among]
            turns = dict(zip(("steady", "theta", "hyperbolic"), by_kind(turn), strict=True))
            yield index, self.part(index, self.group.bodies, **turns), None

    def spun_part(self, index: Ints, torque: Floats, drag: Floats) -> tuple[Ints, _Part, None]:
        """Bodies that a torque or drag turns about a line."""
        bodies, axis = self.group.bodies, self.group.terms.axis
        k = np.zeros(index.size, dtype=np.int64) if axis is None else np.maximum(axis[index], 0)
        inverse = bodies.inv_inertia[k % FIXED_LINE, index]
        columns = [np.ascontiguousarray(v[:, index]) for v in (self.state.q, self.state.L, torque)]
        spinning = Spinning(drag[index] * inverse, inverse, *columns)
        return index, self.part(index, bodies, spinning=spinning, changes_spin=flag(True)), None

    def top_parts(self, levers: Levers) -> Iterator[tuple[Ints, _Part, _Turned]]:
        """The same of tops, in the axes in which the force acts on axis 3."""
        bodies, all_tops = self.group.bodies, np.flatnonzero(levers.is_top)
        tops, axes = taken(levers.tops, all_tops), levers.axes[:, all_tops]
        state = taken(self.state, all_tops)
        q = quaternion_product(state.q, axes)
        work = (tops.lever * rotate(q, _AXIS_3)).sum(axis=0)
        for among, table in prepare_tops(tops, q, state.L) if all_tops.size else []:
            index = all_tops[among]
            kind = "top" if len(table) == N_THETA else "near"
            turn: Any = {kind: in_blocks(among.size, len(table), [(0, table)])}
            if axes[1:].any():  # other ones than those of the rotor frame
                frame, inverse = bodies.rotor_frame.copy(), bodies.inv_inertia.copy()
                frame[:, index] = quaternion_product(frame[:, index], axes[:, among])
                turned = np.stack([rotate(axes[:, among], e[:, None]) for e in np.eye(3)])
                inverse[:, index] = (turned * turned * inverse[:, index]).sum(axis=1)
                bodies = bodies._replace(rotor_frame=frame, inv_inertia=inverse)
            part = self.part(index, bodies, changes_spin=flag(True), **turn)
            worlds = part_of_worlds(self.group.worlds, index)
            before = over_bodies(work[None, among], worlds), over_bodies(state.L[:, among], worlds)
            first = np.concatenate([before[0], 0.0 * before[1], before[1]], axis=-1)
            yield index, part, _Turned(axes[:, among], first)

    def part(self, index: Ints, bodies: Bodies, **turn: Any) -> _Part:
        """Some bodies of the group, with constants of all, and their turn, if that is known."""
        moves, gravity = self.moves, self.group.terms.gravity
        drift = None if moves.drift is None else np.ascontiguousarray(moves.drift[:, index])
        acting = moves.drag, moves.spring, moves.braked, self.orbit
        for name, record in zip(("drag", "spring", "braked", "orbit"), acting, strict=True):
            if record is not None:
                turn[name] = taken(record, index)
        return _Part(
            *self.rows,
            rows_of(bodies.rotor_frame),
            bodies.inv_mass,
            bodies.mass,
            rows_of(bodies.inv_inertia),
            _WEIGHTLESS if gravity is None else gravity.acceleration,
            index,
            drift=drift,
            is_pair=flag(self.is_pair),
            **turn,
        )

    def external(self, elapsed: Floats) -> Floats:
        """What forces have given that are constant in the world, (T, 7); zeros without such."""
        if self.constant is None:
            return np.zeros((elapsed.size, *shape_of(self.group.worlds), N_EXTERNAL))
        return self.constant.external(elapsed)

    def refuse_fall(self, t: float) -> None:
        """Raise MotionError where a body passes through what attracts it within a time t [s]."""
        if self.orbit is not None and self.orbit.until.min() <= t:
            first = self.orbit.until.argmin()
            when = self.start + self.orbit.until[first]
            what = f"body {self.group.members[first]} falls into what attracts it"
            hint = "end the run before, or let it pass beside the centre"
            raise MotionError(f"{what} at t = {when:.6g} s: {hint}")

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; external work, (T, 7)."""
        elapsed = times - self.start
        if self.orbit is not None:
            self.refuse_fall(elapsed.max(initial=0.0))
        external = self.external(elapsed)
        for index, part, turned in self.parts:
            worlds, binned, bins, n_bins = self.group.worlds, None, None, -(-index.size // BLOCK)
            if part.sums or worlds is not None:
                bins, n_bins = bins_among(index, worlds, BLOCK)
            if part.sums:
                binned = np.zeros((times.size, n_bins, N_EXTERNAL))
            sums = np.zeros((0 if self.sums is None else times.size, n_bins, N_TOTALS))
            room = self.group.members, frames, binned, bins, sums
            fly = partial(_fly_blocks, part, elapsed, rows, *room)
            THREADS.spread(fly, index.size, index.size * times.size)
            if binned is not None:
                external += over_bins(binned, worlds)
            if self.sums is not None:
                self.sums += over_bins(sums, worlds)
            if turned is not None:
                external -= turned.first
        return external

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) of external work until then."""
        t = stop - self.start
        self.refuse_fall(t)
        end = State(*(values.copy() for values in self.state))
        external = self.external(np.array([t]))[0]
        for index, part, turned in self.parts:
            worlds, binned = self.group.worlds, None
            if part.sums:
                bins, n_bins = bins_among(index, worlds, index.size)
                binned = ExternalWork(np.zeros((n_bins, N_EXTERNAL)), bins)
            THREADS.alone(_end_blocks, part, t, end, binned)
            if binned is not None:
                external += binned.sums[0] if worlds is None else binned.sums
            if turned is not None:
                end.q[:, index] = quaternion_product(end.q[:, index], turned.axes * CONJUGATE)
                external -= turned.first
        return end, external

    def checkpoint(self) -> Saved:
        """Nothing: all follows from the start."""
        return {}

    def restore(self, saved: Saved) -> None:
        """Do nothing."""
