"""The [check] table: each expectation beside the figure that the run gave."""

import math
from typing import NamedTuple

import numpy as np

from particlerb.case.output import Check, CheckValue, SweepValue
from particlerb.case.placement import unit_vectors
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.balance import ConservationError
from particlerb.model.bodies import taken
from particlerb.model.comparison import angles
from particlerb.model.state import (
    Frames,
    inertia_in_body,
    kinetic_energy,
    omega_world,
    rotate_back,
    rotation_matrix,
    state_in,
)
from particlerb.model.system import System
from particlerb.plan.joints import SystemJoints, joints_of
from particlerb.ranks import ALONE, Ranks
from particlerb.simulation.impulse_values import impulse_quantity
from particlerb.simulation.outcome import Outcome, Probe


class Result(NamedTuple):
    """One check and how it went."""

    name: str
    expected: str
    found: str
    error: float
    tolerance: float

    @property
    def holds(self) -> bool:
        """Whether the error is within the tolerance; never with NaN."""
        return self.error <= self.tolerance


def limits(check: Check, drift: ConservationError) -> list[Result]:
    """Limits of drift."""
    return [
        Result(f"{name}_drift", "0", f"{value:.3g}", float(value), limit)
        for name, value in drift._asdict().items()
        if (limit := getattr(check, f"{name}_drift")) is not None
    ]


def results(system: System, outcome: Outcome, ranks: Ranks = ALONE) -> list[Result]:
    """All checks of a system, limits of drift first; of all bodies of all ranks.

    Of times that a simulation had passed before this run nothing is known.
    """
    probes = {probe.time: probe for probe in outcome.probes}
    setup = joints_of(system) if any(check.joint for check in system.check.value) else None
    values: list[list[Result]] = []
    for check in system.check.value:
        time = system.run.t_end if check.time is None else check.time
        if time <= outcome.passed and time not in probes:
            continue
        if check.body is not None:
            index = system.names.find(check.body)
            rows = quantities(check, system, index, probes[time].frame)
            owners = zip(rows, index[:, None], strict=True)
            values.append([_result(check, time, value, system, b) for value, b in owners])
        elif ranks.number:  # the first has what there is once
            values.append([])
        else:
            number = bodiless_quantity(check, system, setup, probes[time])[0]
            values.append([_result(check, time, number, system)])
    of_checks = zip(*ranks.gathered(values), strict=True)
    value_results = [result for of_ranks in of_checks for of_rank in of_ranks for result in of_rank]
    return limits(system.check, outcome.drift) + value_results


def _result(
    check: CheckValue, time: float, value: Floats, system: System, body: Ints | None = None
) -> Result:
    """One expected value of one body, (1,), of a joint, or of all contacts by impulses."""
    expected = np.array(check.value, dtype=np.float64)
    if check.quantity == "inertia" and expected.ndim == 1:
        expected = np.diag(expected)
    expected = expected.reshape(value.shape)
    error = float(np.abs(value - expected).max())
    owner = check.joint or "all contacts"
    if body is not None:
        owner = system.names[int(body[0])]
    if body is not None and check.quantity == "orientation":
        expected = unit_vectors(expected)
        error = float(angles(taken(system.bodies, body), expected[None], value[None])[0])
        value = value if value @ expected >= 0 else -value
    frame = f", {check.frame} frame" if check.frame == "body" else ""
    when = "" if check.quantity == "inertia" else f" at {time:.9g} s"
    name = f"{check.quantity} of {owner}{when}{frame}"
    return Result(name, numbers(expected), numbers(value), error, check.tolerance)


def quantities(check: SweepValue, system: System, index: Ints, frames: Frames) -> Floats:
    """Value of a quantity of some bodies, (n, ...)."""
    bodies = taken(system.bodies, index)
    orientation, state = frames.orientation[0, index], state_in(frames, 0, index, bodies)
    if check.quantity == "kinetic_energy":
        return kinetic_energy(bodies, state)
    if check.quantity == "inertia":
        tensors = [inertia_in_body(system.bodies, b) for b in index.tolist()]
        if check.frame == "world":
            axes = map(rotation_matrix, orientation)
            tensors = [R @ tensor @ R.T for R, tensor in zip(axes, tensors, strict=True)]
        return np.array(tensors)
    if check.quantity == "orientation":
        return np.asarray(orientation)
    vectors = {
        "position": state.com,
        "velocity": state.p * bodies.inv_mass,
        "angular_velocity": omega_world(bodies, state),
        "linear_momentum": state.p,
        "angular_momentum": state.L,
    }
    vector = vectors[check.quantity]
    if check.frame == "body":
        vector = rotate_back(orientation.T, vector)
    return vector.T


def bodiless_quantity(
    asked: SweepValue, system: System, setup: SystemJoints | None, probe: Probe
) -> Floats:
    """Numbers of a quantity of a joint, or of all contacts by impulses, a row for each world."""
    if asked.joint is None:
        return impulse_quantity(asked, probe.tally)[None]
    first = setup if system.n_worlds == 1 else joints_of(system.scene(0))
    assert setup is not None
    assert first is not None
    j = first.names.index(str(asked.joint))
    record = first.record[j]
    place = j - int(np.searchsorted(first.record, record))
    columns = np.flatnonzero(setup.record == record).reshape(system.n_worlds, -1)[:, place]
    if asked.quantity == "joint_coordinate":
        columns = np.flatnonzero(np.isin(setup.coordinates.joint, columns))
    values: Floats = getattr(probe.joints, asked.quantity)[0, columns]
    return values.reshape(system.n_worlds, -1)


def numbers(values: Floats) -> str:
    """Numbers with all their digits, a 3 x 3 tensor by rows."""
    return str(np.asarray(values).tolist())


def table(checks: list[Result], most: int) -> str:
    """Text of checks, a line each: those missed first, then those nearest to their limits.

    Where there are more than fit, the last line counts the others.
    """
    ordered = sorted(checks, key=lambda check: (check.holds, -_share(check)))
    shown = ordered if len(ordered) <= most else ordered[: most - 1]
    lines = []
    for check in shown:
        text = f"{check.name}: error {check.error:.3g}, allowed {check.tolerance:.3g}"
        if not check.holds and not check.name.endswith("drift"):
            text += f"; expected {check.expected}, found {check.found}"
        lines.append(f"  {'ok  ' if check.holds else 'MISS'} {text}")
    others = ordered[len(shown) :]
    if others:
        n = sum(not check.holds for check in others)
        verdict = f"{n} of them missed" if n else "all ok"
        lines.append(f"  and {len(others)} more, {verdict}: --json lists them")
    return "\n".join(lines)


def _share(check: Result) -> float:
    """Share of the tolerance that the error takes; 0 where there is none to take."""
    share = check.error / check.tolerance if check.tolerance > 0.0 else 0.0
    return math.inf if math.isnan(share) else share
