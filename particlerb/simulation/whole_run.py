"""A prepared system on its way: all its groups, frames, and the energy balance of these."""

import math
import re
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.balance import ConservationError, EnergyBalance, Entries
from particlerb.model.bodies import Bodies, has_held, taken
from particlerb.model.state import Frames, State, as_frame, room_for
from particlerb.model.superblocks import Range, summed
from particlerb.model.system import System
from particlerb.model.totals import N_TOTALS, totals
from particlerb.plan.joints import asked_of_joints, joints_of
from particlerb.plan.merging import merged
from particlerb.plan.segments import GroupPlan, Plan, in_superblocks
from particlerb.ranks import ALONE, Ranks
from particlerb.record.frame_values import NewFrames
from particlerb.simulation import joint_values
from particlerb.simulation.group_run import GroupRun, initial_energies, own_failure, record_all
from particlerb.simulation.impulse_values import impulse_fields
from particlerb.simulation.joint_watch import told_of_tension
from particlerb.simulation.outcome import Probe, TreeError, restored_probes, saved_probes
from particlerb.simulation.restarts import restart_from
from particlerb.simulation.state_checks import StateChecks
from particlerb.stepping.motion import Energies, Motion, MotionError
from particlerb.stepping.saved_arrays import Saved, under, within
from particlerb.stepping.shared_motion import SharedMotion

_Sums: TypeAlias = Sequence[Floats | None]
SHARED: Final = "shared"  # name in checkpoints of a group that ranks share,
BY_HAND: Final = "by_hand"  # and of until when a simulation has moved all [s]


class RunError(Exception):
    """A run that failed: what, where, when."""


class Prepared(NamedTuple):
    """A system made ready to run."""

    system: System
    plan: Plan
    text: str  # the plan in words
    parameters: Mapping[str, str] = {}  # more for /parameters of the file
    first: int = 0  # number of its first body in the scene, where it is a part of one
    is_copied: bool = False  # whether each of several ranks moves all bodies
    accuracy: str = ""  # what its text says of that
    hash_of_scene: str = ""  # of the share of a rank: what decides the motion of all bodies,
    remedy: str = ""  # and what helps if their energy is lost

    @property
    def is_part(self) -> bool:
        """Whether it has some of the bodies of a scene only."""
        return self.system.n_bodies < self.system.n_of_scene


class Run:
    """A prepared system on its way; where ranks share a scene, the part of this one."""

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # found in frames
    def __init__(self, prepared: Prepared, ranks: Ranks = ALONE) -> None:
        self.system, plan, self.ranks = prepared.system, prepared.plan, ranks
        self.number_of_first = prepared.first
        self.adding = ALONE if prepared.is_copied else ranks  # that have bodies of their own
        self.moving = merged(self.system)  # with bodies that move as one
        self.gravity = self.system.acceleration
        initial = as_frame(self.moving.bodies, self.moving.state)
        self.last = initial.last
        self.single: Frames | None = None  # of `pose_at`
        self.room = initial  # used again and again: fresh memory costs more than what fills it
        self.checks = StateChecks(self.moving, plan)
        asks = self.system.joint and asked_of_joints(self.system)
        self.setup = joints_of(self.system) if asks else None
        ranks.together(lambda: self.start(plan, self.moving.state, {}))
        self.balance = EnergyBalance(self.totals_of(initial, self.initial_energies(initial)))
        self.external_at_restart = np.zeros(7)  # until the last restart,
        self.gross_work_at_restart: Floats | float = 0.0  # and gross work of contacts [J]

        self.joints: joint_values.JointValues | None = None  # of the last frames, if asked for
        self.is_by_hand, self.passed = False, 0.0  # whether a simulation moves it, until when [s]
        self.kept_of_restart: Saved = {}  # of the last one, for checkpoints
        self.broken: dict[int, float] = {}  # joints that broke before a restart, and when [s]
        self.tallies: dict[int, Floats] = {}  # what was counted of impulses, in these rows
        self.told_of_tension = ""  # before a restart
        self.n_frames = 0  # that lie behind
        self.probes: list[Probe] = []

    def start(self, plan: Plan, state: State, motions: Mapping[bytes, Motion]) -> None:
        """Start by a plan, from a state of all bodies, after motions of the same bodies."""
        self.groups, self.superblocks = plan.groups, list[list[GroupRun]]()
        self.firsts: list[int] = []  # body of each; -1: of groups that are one
        for first, groups in in_superblocks(plan.groups, self.system.n_bodies):
            begun = list[GroupRun]()
            try:
                for group in groups:
                    before = motions.get(group.members.tobytes()) if motions else None
                    started = taken(state, group.members, group.is_closed), before
                    begun.append(GroupRun(group, *started))
            except Exception as failure:
                raise self.told(failure, groups) from None
            self.superblocks.append(begun)
            self.firsts.append(first)
        self.group_runs = [run for runs in self.superblocks for run in runs]
        is_cut = min(self.firsts) >= 0 or self.system.n_worlds > 1
        all_sum = [all(run.sums_itself for run in runs) for runs in self.superblocks]
        self.sums_itself = [is_cut and one for one in all_sum]
        self.counted = counted(plan.groups, self.moving.bodies)
        reads_loads = self.setup is not None and self.moving.merging is not None
        self.loads = joint_values.LoadReader(self.moving) if reads_loads else None

    def initial_energies(self, frame: Frames) -> Energies:
        """Energies of a first frame beside those of the bodies themselves."""
        return self.energies([initial_energies(runs, frame) for runs in self.superblocks])

    def energies(self, parts: Sequence[Energies]) -> Energies:
        """The sum over superblocks of all ranks of energies."""
        if len(parts) == 1 and self.adding is ALONE:
            return parts[0]
        potential, kinetic = zip(*parts, strict=True)
        return Energies(self.over_ranks(potential), self.over_ranks(kinetic))

    def over_ranks(self, parts: Sequence[Floats]) -> Floats:
        """Sum over superblocks of all ranks of what their motions return.

        What bodies that touch return is of all ranks.
        """
        if len(parts) == 1 and self.adding is ALONE:
            return parts[0]
        n_shared = int(any(group.shared for group in self.groups))  # a motion is that of all ranks
        own = [part for each in self.adding.gathered(parts[n_shared:]) for part in each]
        return summed([*parts[:n_shared], *own])

    def totals_of(self, frames: Frames, beside: Energies, sums: _Sums = ()) -> Floats:
        """Totals of frames, with the energies beside the bodies' own."""
        n_worlds, ranks = self.system.n_worlds, self.adding
        return totals(frames, self.counted, self.gravity, *beside, n_worlds, ranks, sums)

    def finish(self, time: float) -> State:
        """State of all bodies at the time of the last frame [s]; the run ends, or restarts."""
        all_states = State(*(values.copy() for values in self.moving.state))
        for group_run in self.group_runs:
            state, external = group_run.finish(time)
            self.broken |= group_run.broken_until(time)
            self.external_at_restart += external
            for values, group_values in zip(all_states, state, strict=True):
                values[:, group_run.plan.members] = group_values
        self.gross_work_at_restart += sum(t.gross_work() for t in self.group_runs)
        return all_states if self.moving.merging is None else self.moving.merging.apart(all_states)

    def restart(self, system: System, plan: Plan, state: State, last: Entries) -> None:
        """Go on from a state, where the run was finished, by another plan.

        What changes the energy and the momenta is external: `last` are the entries before it.
        Contacts keep what they kept where their group stays the same.
        """
        motions = {t.plan.members.tobytes(): t.motion for t in self.group_runs}
        state = self.begin_again(system, plan, state, motions)
        for run in self.group_runs:
            for before in () if run.plan.members.tobytes() in motions else motions.values():
                run.motion.continue_joints(before)
        frame = as_frame(self.moving.bodies, state)
        now = self.totals_of(frame, self.initial_energies(frame))
        self.external_at_restart[0] += (now[..., 0] + now[..., 1] - last.energy)[-1]
        self.external_at_restart[1:4] += (now[..., 2:5] - last.linear_momentum)[-1]
        self.external_at_restart[4:] += (now[..., 5:8] - last.angular_momentum)[-1]

    def begin_again(
        self, system: System, plan: Plan, state: State, motions: Mapping[bytes, Motion]
    ) -> State:
        """Start by another plan, after motions of the same bodies; the state of those that move."""
        self.told_of_tension = told_of_tension(self.moving, self.group_runs) or self.told_of_tension
        self.system, self.gravity, self.moving = system, system.acceleration, merged(system)
        self.single = None
        if self.moving.merging is not None:
            state = self.moving.merging.together(state)
        self.checks = StateChecks(self.moving, plan)
        self.start(plan, state, motions)
        for run in self.group_runs:
            run.broken = dict(self.broken)
        return state

    @property
    def keyed_runs(self) -> list[tuple[int, str, GroupRun]]:
        """Runs of groups, with the number of the first body of their superblock, and a key."""
        found = []
        for first, runs in zip(self.firsts, self.superblocks, strict=True):
            number = self.number_of_first + max(first, 0)
            for k, run in enumerate(runs):
                key = f"group.{number}.{k}" if first >= 0 else f"group.{k}"
                found.append((-1, SHARED, run) if run.plan.shared else (number, key, run))
        return found

    def checkpoints(self) -> Callable[[Range], Saved]:
        """What `checkpoint_of` returns; ranks that share a motion send what others save."""
        for run in self.group_runs:
            if isinstance(run.motion, SharedMotion):
                run.motion.collect()
        return self.checkpoint_of

    def checkpoint(self) -> Saved:
        """All that a run that goes on from here has to know, beside its system."""
        first = self.number_of_first
        return self.checkpoints()(Range(first, first + self.system.n_bodies))

    def checkpoint_of(self, of: Range) -> Saved:
        """The same of a range of bodies of the scene: of whole superblocks."""
        first = self.number_of_first
        rows = slice(of.first - first, of.stop - first)
        saved = {"last": self.last[rows].copy()} | under("ledger", self.balance.checkpoint())
        saved |= {BY_HAND: np.array(self.passed)} if self.is_by_hand or self.passed else {}
        if self.kept_of_restart:
            kept = {"booked": self.external_at_restart.copy(), "gross": self.gross_work_at_restart}
            kept |= {"broken": np.array([*self.broken.items()])} if self.broken else {}
            saved |= under("restart", self.kept_of_restart | kept)
        for number, key, group_run in self.keyed_runs:
            if number < 0 or of.first <= number < of.stop:
                saved |= under(key, group_run.checkpoint(of))
        return saved | saved_probes(self.probes, rows)

    def restore(self, n_frames: int, saved: Saved) -> None:
        """Go on behind so many frames from what was saved then."""
        self.n_frames = n_frames
        restart, self.passed = within("restart", saved), float(saved.get(BY_HAND, 0.0))
        if restart:
            self.kept_of_restart = restart
            self.external_at_restart = restart["booked"]
            self.gross_work_at_restart = float(restart["gross"])
            self.broken = {int(j): float(t) for j, t in restart.get("broken", ())}
            self.begin_again(*restart_from(self.system, restart), {})
        self.last[:] = saved["last"]
        self.balance.restore(within("ledger", saved))
        names = sorted(saved)  # which puts those of a group side by side: "/" comes after "."
        for _, key, group_run in self.keyed_runs:
            own = names[bisect_left(names, f"{key}.") : bisect_left(names, f"{key}/")]
            group_run.restore(within(key, {name: saved[name] for name in own}))
        self.probes = restored_probes(saved, self.last)

    def flown(self) -> float | None:
        """Share of body-steps of touching bodies that were saved by closed forms."""
        saved, steps = np.sum([one.motion.flown for one in self.group_runs], axis=0)
        return float(saved / steps) if steps else None

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # scales may overflow
    def drift(self) -> ConservationError:
        """Largest errors of energy and momenta until now, over their scales."""
        of = self.counted, self.moving.state.com, self.system.run.t_end, self.adding
        return self.balance.drift(*of, float(np.linalg.norm(self.gravity)))

    def contact_turn(self) -> float:
        """Largest ω dt of bodies that oscillate on their contacts that was seen [rad]."""
        motions = [one.motion for one in self.group_runs]
        return max((motion.contact_frequency * motion.dt for motion in motions), default=0.0)

    def tension(self) -> str:
        """What is to be said of steps that were too long for what joints carry; empty: nothing."""
        own = told_of_tension(self.moving, self.group_runs) or self.told_of_tension
        return next(filter(None, self.ranks.gathered(own)), "")

    def tree_error(self) -> TreeError | None:
        """What the tree of the attraction has erred at frames; None where none was asked for."""
        runs = [run for run in self.group_runs if run.angle]
        fitted = [TreeError(r.angle, r.tree_error, r.terms.tree_accuracy) for r in runs]
        return fitted[0] if fitted else None  # bodies that attract each other are one group

    def frames_at(self, times: Floats, is_frame: Bools) -> tuple[Frames, Entries, RunError | None]:
        """States at ascending times, not before those asked for earlier, and their energy balance.

        Where a state is not finite, or a torque has turned a rod about its own axis, they end
        before it, and the error says so. The next call writes over the frames.
        """
        if self.is_by_hand:
            self.passed = float(times[-1])
        if times.size > len(self.room.position):
            self.room = self.new_room(times.size)
        is_whole = times.size == len(self.room.position)
        frames = self.room if is_whole else self.room.rows(slice(times.size))
        frames.is_frame[:] = is_frame
        if self.setup is not None:
            self.joints = joint_values.room_for_values(self.setup, times.size)
        external_parts, beside, sums = self.ranks.together(lambda: self.record(times, frames))
        external = self.over_ranks(external_parts)
        energies = self.energies(beside)
        self.tallies = {}
        for one in reversed(self.group_runs):
            self.tallies = one.tallies or self.tallies
        external += self.external_at_restart
        now = self.totals_of(frames, energies, sums)
        is_finite = math.isfinite(np.add.reduce(now, axis=None))
        verdict = self.checks.sound_frames(times, frames, is_finite, self.group_runs)
        verdicts = self.ranks.gathered(verdict)
        rank = min(range(len(verdicts)), key=lambda k: verdicts[k][0])
        sound, problem = verdicts[rank]
        error = RunError(self.ranks.named(rank, problem)) if problem else None
        if not (is_finite and math.isfinite(np.add.reduce(external, axis=None))):
            values = np.concatenate([now, external], axis=-1).reshape(times.size, -1)
            are_finite = np.isfinite(values[:sound]).all(axis=1)
            if not are_finite.all():
                sound = int(np.argmin(are_finite))
                error = RunError(
                    f"energy, momentum or work is not finite at t = {float(times[sound])!r} s: a"
                    " number is too large for float64, or a potential is not a number there"
                )
        if sound < times.size:
            frames, now = frames.rows(slice(sound)), now[:sound]
        gross_work = self.gross_work_at_restart + sum(t.gross_work() for t in self.group_runs)
        entries = self.balance.enter(now, external[:sound], gross_work)
        if self.moving.merging is not None:
            frames = self.moving.merging.shown(frames)
        if self.loads is not None and self.joints is not None:
            self.loads.read(times[:sound], frames, self.joints)
        if self.setup is not None and self.joints is not None:
            self.joints = joint_values.of_all_ranks(self.joints, self.setup, self.adding)
        return frames, entries, error

    def new_room(self, n_frames: int) -> Frames:
        """Room for frames, with nothing of bodies that others carry."""
        room = room_for(n_frames, len(self.system.kind), self.last)
        if self.moving.merging is not None:
            self.moving.merging.clear(room)
        return room

    def record(
        self, times: Floats, frames: Frames
    ) -> tuple[list[Floats], list[Energies], list[Floats | None]]:
        """Write rows of the frames; of each superblock what `record_all` returns, and its sums."""
        worlds = () if self.system.n_worlds == 1 else (self.system.n_worlds,)
        external, energies, block_sums = [], [], []
        for runs, sums_itself in zip(self.superblocks, self.sums_itself, strict=True):
            sums = np.zeros((times.size, *worlds, N_TOTALS)) if sums_itself else None
            try:
                group_external, group_energies = record_all(runs, times, frames, self.joints, sums)
            except Exception as failure:
                raise self.told(failure, [run.plan for run in runs]) from None
            external.append(group_external)
            energies.append(group_energies)
            block_sums.append(sums)
        return external, energies, block_sums

    def told(self, failure: Exception, groups: Sequence[GroupPlan]) -> Exception:
        """What has failed in groups: a motion, or a force that a user wrote; else itself."""
        if isinstance(failure, MotionError | FloatingPointError):
            return RunError(self.named(str(failure), any(group.shared for group in groups)))
        words = own_failure(failure, self.groups)
        return RunError(words) if words else failure

    def named(self, text: str, is_of_scene: bool) -> str:
        """Text with bodies, here or of the scene, and walls by their names, not their numbers."""
        bodies = self.system.names.scene if is_of_scene else self.system.names
        names = {"body": bodies, "wall": [wall.name for wall in self.system.wall]}
        return re.sub(r"\b(body|wall) (\d+)\b", lambda m: f"{m[1]} {names[m[1]][int(m[2])]}", text)

    def pose_at(self, time: float) -> tuple[Frames, RunError | None]:
        """States at a time [s], not before those asked for earlier, alone: no work is summed.

        Where one is not finite, or a torque has turned a rod about its own axis, the error says so.
        The next call writes over the frame.
        """
        if self.single is None:
            self.single = self.new_room(1)
        frames = self.single
        try:
            for group_run in self.group_runs:
                group_run.pose_at(time, frames)
        except Exception as failure:
            raise self.told(failure, self.groups) from None
        is_finite = math.isfinite(np.add.reduce(np.asarray(frames.position.base)))  # the whole room
        problem = ""
        if not is_finite or self.checks.rods.size:
            times = np.array([time])
            _, problem = self.checks.sound_frames(times, frames, is_finite, self.group_runs)
        if self.moving.merging is not None:
            frames = self.moving.merging.shown(frames)
        return frames, RunError(problem) if problem else None

    def to_record(self, times: Floats, frames: Frames, rows: Ints, entries: Entries) -> NewFrames:
        """What is recorded of rows of the last frames, which are at these times [s]."""
        fields = joint_values.recorded_values(self.joints, self.system.output.fields, rows)
        fields |= impulse_fields(self.tallies, rows.tolist())
        asked = next((t.contacts for t in self.group_runs if t.contacts), {})
        contacts = [asked[row] for row in rows.tolist()] if asked else []
        return NewFrames(times[rows], frames, rows, entries, contacts, fields)


def counted(groups: Sequence[GroupPlan], bodies: Bodies) -> Bodies:
    """Bodies as the energy balance counts them: those that are held have no mass."""
    each = [group.bodies for group in groups if group.bodies is not bodies]
    if not any(map(has_held, [bodies, *each])):
        return bodies
    mass, inv_mass = bodies.mass.copy(), bodies.inv_mass.copy()
    for group in groups:
        mass[group.members], inv_mass[group.members] = group.bodies.mass, group.bodies.inv_mass
    inv_inertia = bodies.inv_inertia * (mass > 0)
    return bodies._replace(mass=mass, inv_mass=inv_mass, inv_inertia=inv_inertia)
