"""One group of bodies on its way through its segments, and the sums over all groups."""

import traceback
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import numpy as np

from particlerb.contact.contact_output import ContactOutput
from particlerb.forces import Terms, energies_of_loads, has_energy
from particlerb.forces.gravity_tree.opening_angle import fitting_angle, sampled_error
from particlerb.forces.gravity_tree.tree import Tree
from particlerb.forces.impulse import apply_impulse
from particlerb.forces.python import given_to, wrong_result
from particlerb.forces.python_pairs import wrong_pair
from particlerb.forces.user_kicks import Written
from particlerb.integrators import METHODS
from particlerb.joints.reactions import energy_of_joints
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import has_held
from particlerb.model.state import Frames, State, state_in, state_of, states_in
from particlerb.model.superblocks import Range
from particlerb.model.worlds import shape_of
from particlerb.plan.segments import GroupPlan, Segment
from particlerb.simulation.joint_values import JointReader, JointValues
from particlerb.simulation.joint_watch import TensionWatch
from particlerb.stepping.make_motion import make_motion
from particlerb.stepping.motion import Energies, Motion, few_at_once
from particlerb.stepping.pair_forces import PairForces
from particlerb.stepping.saved_arrays import OF_BODIES, Saved, under, within
from particlerb.stepping.shared_motion import SharedMotion
from particlerb.user_force import place_of, told

_STEP_ROUNDING: Final = 1e-9  # share of a step that is none


class GroupRun:
    """One group on its way through its segments."""

    def __init__(self, plan: GroupPlan, state: State, before: Motion | None = None) -> None:
        self.joint_values: JointValues | None = None  # rows of the next `record`, where asked for
        self.sums: Floats | None = None  # over its bodies, of these rows, where asked for
        self.reader: JointReader | None = None
        self.watch: TensionWatch | None = None
        self.plan = plan
        self.external_before = np.zeros((*shape_of(plan.worlds), 7))  # in earlier segments
        self.gross_work_before: Floats | float = 0.0  # [J] gross work of contacts in them
        self.number = 0
        self.broken: dict[int, float] = {}  # joints that broke in earlier segments, and when [s]
        self.first_state = state  # of this segment
        self.angle = 0.0  # of the tree that sums the attraction, where it is fitted to the scene
        self.tree_error = 0.0  # the largest seen, of this tree
        self.pairs: PairForces | None = None
        self.fit_tree()
        self.pairs = self.pair_forces()
        self.motion = self.start_segment(plan.segments[0], state, before)
        self.contacts: dict[int, ContactOutput] = {}  # in rows of the last `record`, if asked for
        self.tallies: dict[int, Floats] = {}  # of impulses, in these rows

    def checkpoint(self, of: Range) -> Saved:
        """The segment, how it began, and its motion; of some bodies where ranks share it."""
        motion = self.motion
        kept = motion.checkpoint_of(of) if isinstance(motion, SharedMotion) else motion.checkpoint()
        saved = under("motion", kept)
        if self.number:
            first = {"first": np.vstack(self.first_state)}
            saved |= self._first_of(of) if self.plan.shared else first
            saved["before"] = self.external_before.copy()
            saved["turnover"] = np.array(self.gross_work_before)
            saved |= {"broken": np.array([*self.broken.items()])} if self.broken else {}
        return saved | {"number": np.array(self.number), "angle": np.array(self.angle)}

    def _first_of(self, of: Range) -> Saved:
        """The first state of the segment, of some bodies of the scene, and who these are."""
        shared, members = self.plan.shared, self.plan.members
        assert shared is not None
        rows = np.column_stack([shared.places(members), np.vstack(self.first_state).T])
        number = shared.first + members
        return under(OF_BODIES, {"first": rows[(number >= of.first) & (number < of.stop)]})

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        self.number, self.angle = int(saved["number"]), float(saved["angle"])
        if self.number:
            self.external_before, self.gross_work_before = saved["before"], float(saved["turnover"])
            self.broken = {int(j): float(t) for j, t in saved.get("broken", ())}
            rows = within(OF_BODIES, saved).get("first")
            first = saved["first"] if rows is None else rows[np.argsort(rows[:, 0]), 1:].T
            self.first_state = state_of(first)
            self.pairs = self.pair_forces()
            self.motion = self.segment_motion(self.motion)
        self.motion.restore(within("motion", saved))

    @property
    def segment(self) -> Segment:
        """The segment that it is in."""
        return self.plan.segments[self.number]

    @property
    def terms(self) -> Terms:
        """What acts in the segment, with the opening angle that was fitted."""
        terms = self.segment.terms
        return terms._replace(opening_angle=self.angle) if terms.tree_accuracy else terms

    @property
    def tree(self) -> Tree | None:
        """The tree whose angle was fitted."""
        return self.pairs.tree if self.pairs is not None and self.angle else None

    def fit_tree(self) -> None:
        """Choose an opening angle for the first state of the segment, where one may be chosen.

        One that was chosen before stays where it still does: its potential energy was found last.
        """
        terms = self.segment.terms
        if terms.attraction is None or not terms.tree_accuracy:
            return
        tree = self.tree
        if tree is not None and sampled_error(tree) <= terms.tree_accuracy:
            return
        y = np.vstack((self.first_state.com, self.first_state.q))
        self.angle = fitting_angle(terms.attraction, y, terms.tree_accuracy)

    def pair_forces(self) -> PairForces | None:
        """What the bodies of the segment do to each other; None where it is nothing."""
        if not (terms := self.terms).is_coupled:
            return None
        return PairForces(terms, self.plan.members.size, True, worlds=self.plan.worlds)

    @property
    def sums_itself(self) -> bool:
        """Whether its motion sums over the bodies, in all segments alike."""
        is_adaptive = any(METHODS[segment.method].is_adaptive for segment in self.plan.segments)
        return not (is_adaptive or self.plan.touches or has_held(self.plan.bodies))

    @property
    def is_bound(self) -> bool:
        """Whether the bodies have a potential energy beside that of uniform gravity."""
        return self.pairs is not None or has_energy(self.segment.terms)

    def potential(self, com: Floats, q: Floats) -> Floats:
        """Potential energy of all springs, and of the bodies with each other [J].

        Where an error of the tree was asked for, this looks at what it is.
        """
        return self.between_bodies(com, q) + self.of_loads(com, q, 1)[0]

    def between_bodies(self, com: Floats, q: Floats) -> Floats:
        """What of it bodies have with each other, and by joints."""
        energy = np.zeros(shape_of(self.plan.worlds))
        if self.pairs is not None:
            energy = energy + self.pairs.potential_energy(com, q)
        if self.tree is not None:
            self.tree_error = max(self.tree_error, sampled_error(self.tree))
        joints = self.segment.terms.joints
        if joints is not None:
            energy = energy + energy_of_joints(joints, com, q, self.plan.worlds)
        return energy

    def of_loads(self, com: Floats, q: Floats, n_states: int) -> Floats:
        """What of it loads have, (T, ...), in states one after the other."""
        group = self.plan.group(self.segment)
        energy = np.zeros((n_states, *shape_of(self.plan.worlds)))
        for energies in energies_of_loads(self.segment.terms, com, q, n_states):
            energy += group.totals(energies).T
        return energy

    def potentials(self, frames: Frames, rows: Ints) -> Floats:
        """Potential energies in rows of the frames, (T, ...) [J]."""
        energy = np.zeros((rows.size, *shape_of(self.plan.worlds)))
        if self.pairs is not None or self.segment.terms.joints is not None:
            energy += [self.between_bodies(*self.state_in(frames, r)[:2]) for r in rows.tolist()]
        for few in few_at_once(rows.size * has_energy(self.segment.terms), self.plan.members.size):
            com, q, _, _ = states_in(frames, rows[few], self.plan.members, self.plan.bodies)
            energy[few] += self.of_loads(com, q, rows[few].size)
        return energy

    def start_segment(self, segment: Segment, state: State, before: Motion | None) -> Motion:
        """Apply the impulses at the start of a segment; its motion, after another one."""
        for jump in segment.jumps:
            state, external = apply_impulse(jump, self.plan.bodies, state)
            self.external_before = self.external_before + self.plan.group(segment).totals(external)
        self.first_state = state
        return self.segment_motion(before)

    def segment_motion(self, before: Motion | None = None) -> Motion:
        """Motion of this segment from its first state."""
        segment = self.segment
        group = self.plan.group(segment)
        if segment.terms.tree_accuracy:
            group = group._replace(terms=self.terms)
        method, times = METHODS[segment.method], (segment.start, segment.dt)
        begin = method, group, self.first_state, *times, segment.tolerance
        motion = make_motion(*begin, before=before, is_own=self.number > 0)
        if before is not None:
            motion.continue_joints(before)
        return motion

    def cross(self) -> None:
        """Go from this segment into the next.

        Who connects a spring that is stretched gives its energy, and gets it who disconnects it.
        """
        state, external = self.motion.finish(self.segment.stop)
        if self.segment.terms.joints is not None:
            self.watch_tension(self.segment.stop, lambda: state)
        self.broken = self.broken_until(self.segment.stop)
        self.gross_work_before = self.gross_work()
        self.external_before += external
        self.external_before[..., 0] -= self.potential(state.com, state.q)
        self.number, self.first_state = self.number + 1, state
        self.fit_tree()
        self.pairs = self.pair_forces()
        self.external_before[..., 0] += self.potential(state.com, state.q)
        self.motion = self.start_segment(self.segment, state, self.motion)

    def broken_until(self, time: float) -> dict[int, float]:
        """Joints that have broken by a time of this segment [s], and when [s]."""
        if (joints := self.segment.terms.joints) is None:
            return self.broken
        ends = zip(joints.number.tolist(), self.motion.broken.tolist(), strict=False)
        return self.broken | {j: t for j, t in ends if j >= 0 and t <= time}

    def finish(self, time: float) -> tuple[State, Floats]:
        """State at a time of this segment [s], and (7,) of external work until then."""
        state, external = self.motion.finish(time)
        return state, self.external_before + external

    def gross_work(self) -> Floats | float:
        """Gross work of contacts until the last frame [J]."""
        return self.gross_work_before + self.motion.gross_work()

    def record(self, times: Floats, frames: Frames) -> tuple[Floats, Energies]:
        """Write rows 0.. of the frames at ascending times.

        A frame at the instant of an edge shows the state after it.

        Returns
        -------
        external : ndarray, shape (T, 7) or (T, n_worlds, 7)
            External work since t = 0.
        energies : Energies
            Beside those of the bodies themselves.
        """
        each = times.size, *shape_of(self.plan.worlds)
        external, potential, kinetic = np.empty((*each, 7)), np.zeros(each), np.zeros(each)
        self.contacts, self.tallies = {}, {}
        done = 0
        while done < times.size:
            segment = self.segment
            until = int(times.searchsorted(segment.stop))
            if until > done:
                rows, span = np.arange(done, until), slice(done, until)
                self.motion.sums = None if self.sums is None else self.sums[span]
                given = self.motion.record(times[span], rows, frames)
                external[span] = self.external_before + given
                self.motion.sums = None
                if self.is_bound:
                    potential[span] = self.potentials(frames, rows)
                if segment.terms.contact is not None:
                    contacts = self.motion.contact_energies(rows)
                    potential[span] += contacts.potential
                    kinetic[span] += contacts.kinetic
                self.contacts |= self.motion.contacts
                self.tallies |= self.motion.impulse_tallies(rows)
                if self.joint_values is not None:
                    self.read_joints(times, rows, frames, self.joint_values)
                if segment.terms.joints is not None:
                    last = partial(self.state_in, frames, until - 1)
                    self.watch_tension(float(times[until - 1]), last)
                done = until
            if done < times.size:
                self.cross()
        return external, Energies(potential, kinetic)

    def pose_at(self, time: float, frames: Frames) -> None:
        """Write the states at a time [s] into the first row of the frames, and add no work."""
        while time >= self.segment.stop:
            self.cross()
        self.motion.pose(time, frames)
        if self.segment.terms.joints is not None:
            self.watch_tension(time, lambda: self.state_in(frames, 0))

    def read_joints(self, times: Floats, rows: Ints, frames: Frames, values: JointValues) -> None:
        """Find what joints carry in rows of the frames, all of this segment."""
        for number, time in self.broken.items():
            values.joint_break_time[rows, number] = time
        if self.segment.terms.joints is None:
            return
        reader = self.joint_reader()
        for row in rows.tolist():
            state = self.state_in(frames, row)
            turned = self.motion.coordinates[row] if self.motion.coordinates.size else None
            broken = self.motion.broken
            contacts = self.motion.contacts.get(row)
            is_first = times[row] - self.segment.start <= _STEP_ROUNDING * self.segment.dt
            if self.motion.impulse_tally().size and is_first:
                contacts = None  # no step has been taken
            reader.read(float(times[row]), state, contacts, turned, broken, values, row)

    def watch_tension(self, time: float, state_of: Callable[[], State]) -> None:
        """Look whether the step is too long for what joints carry in a state at a time [s]."""
        if self.watch is None:
            self.watch = TensionWatch()
        self.watch.look(self, time, state_of)

    def joint_reader(self) -> JointReader:
        """What finds values of the joints of this segment."""
        if self.reader is None or self.reader.segment is not self.segment:
            self.reader = JointReader(self.plan, self.segment, self.first_state)
        return self.reader

    def state_in(self, frames: Frames, row: int) -> State:
        """State of the group in a frame."""
        return state_in(frames, row, self.plan.members, self.plan.bodies)


def record_all(
    runs: Sequence[GroupRun],
    times: Floats,
    frames: Frames,
    joints: JointValues | None = None,
    sums: Floats | None = None,
) -> tuple[Floats, Energies]:
    """Sums over the groups of what `GroupRun.record` returns; values of joints where asked for.

    `sums` (T, 10) are added to, of groups that do so by themselves.
    """
    recorded = []
    for run in runs:
        run.joint_values, run.sums = joints, sums
        recorded.append(run.record(times, frames))
    external, energies = recorded[0]
    for group_external, group_energies in recorded[1:]:
        external += group_external
        energies = Energies(*(a + b for a, b in zip(energies, group_energies, strict=True)))
    return external, energies


def initial_energies(runs: Sequence[GroupRun], initial: Frames) -> Energies:
    """Energies at t = 0 beside those of the bodies themselves, (1,) or (1, n_worlds)."""
    bound = sum(run.potential(*run.state_in(initial, 0)[:2]) for run in runs if run.is_bound)
    potential, kinetic = runs[0].motion.initial_energies
    for more in [run.motion.initial_energies for run in runs[1:]]:
        potential, kinetic = potential + more.potential, kinetic + more.kinetic
    if runs[0].plan.worlds is not None:
        potential, kinetic = potential.reshape(1, -1), kinetic.reshape(1, -1)
    return Energies(potential + bound, kinetic)


def tally_of(runs: Sequence[GroupRun]) -> Floats | None:
    """What was counted of impulses; None where there are none."""
    tallies = [run.motion.impulse_tally() for run in runs]
    return next((tally for tally in tallies if tally.size), None)


def own_failure(error: Exception, groups: Sequence[GroupPlan]) -> str:
    """What is to be said of an error in a force that a user wrote; empty where it is none."""
    terms = [segment.terms for group in groups for segment in group.segments]
    forces = [load.force for one in terms for load in one.loads if isinstance(load, Written)]
    forces += [f for one in terms if one.user_pairs for f in one.user_pairs.functions.forces]
    files = {force.function.__code__.co_filename for force in forces}
    passed = [frame.filename for frame in traceback.extract_tb(error.__traceback__)]
    return next((told(error, name) for name in reversed(passed) if name in files), "")


def own_forces_on(b: int, runs: Sequence[GroupRun], times: Floats, frames: Frames, f: int) -> str:
    """What forces that users wrote have to do with body b, which is not finite in frame f."""
    words = ""
    for run in runs:
        indices = np.flatnonzero(run.plan.members == b)
        loads = [load for load in run.segment.terms.loads if isinstance(load, Written)]
        for load in loads if indices.size else ():
            words = f"; {place_of(load.force.function)}: {load.force.name} acts on it"
            state = run.state_in(frames, max(f - 1, 0))
            given = given_to(load, run.plan.bodies, state, int(indices[0]))
            is_known = all(np.isfinite(given.get(name, 0.0)).all() for name in load.force.signature)
            if is_known and (wrong := wrong_result(load.force, given, float(times[f]))):
                return f": {wrong}"
        pairs = run.segment.terms.user_pairs
        if pairs is not None and indices.size:
            before = run.state_in(frames, f - 1) if f > 0 else None
            context = run.plan.bodies, before, int(indices[0]), float(times[f])
            words, wrong = wrong_pair(pairs, *context)
            if wrong:
                return f": {wrong}"
    return words
