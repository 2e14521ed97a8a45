"""Impulses beside springs on one chart: where bodies end, against impulses with shorter steps.

Impulses get ever shorter steps, the penalty law ever stiffer springs with the steps of its default
rule: both come to rigid bodies. For scenes that are not chaotic; heaps have no such error.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from particlerb.compiled.threads import THREADS
from particlerb.model.state import lengths
from particlerb.model.system import System
from particlerb.plan.make_plan import make_plan
from particlerb.plan.segments import Plan
from particlerb.studies.points import Point, Reference
from particlerb.studies.text import PENALTY, nice_steps
from particlerb.studies.work_precision import REPEATS, Study

_MAX_STEP_RATIO: Final = 4.0  # of the longest that is tried, over the default step
_SOFTEST_DEPTH: Final = 0.1  # share of the smallest radius that the softest springs give way, about
_STIFFNESS_RATIO: Final = 10.0  # from spring to spring


class LawStudy(Study):
    """A system with contact by impulses, ready to be measured with both laws."""

    def plan(self, method: str, step: float | None = None) -> Plan:
        """Plan with a step of impulses, or with springs of a stiffness [N/m]."""
        if method != PENALTY:
            return super().plan(method, step)
        springs = with_springs(self.system, self.softest() if step is None else step)
        return make_plan(springs.with_run(method="auto", accuracy=None, dt=None))

    def softest(self) -> float:
        """Stiffness [N/m] of springs that give way by a tenth of the smallest radius."""
        system, radius = self.system, self.system.particles.radius
        least, mass = float(radius[radius > 0.0].min()), float(system.bodies.mass.sum())
        speed = float(lengths(system.state.p * system.bodies.inv_mass).max())
        pull = float(np.linalg.norm(system.acceleration))
        energy = mass * (speed * speed + pull * least)
        return float(f"{max(energy, mass) / (_SOFTEST_DEPTH * least) ** 2:.0e}")

    def first_step(self) -> float:
        """Longest step of impulses that is worth a trial [s]."""
        segments = [s for group in self.plan("auto").groups for s in group.segments]
        return min(_MAX_STEP_RATIO * min(s.dt for s in segments if s.dt > 0.0), 0.5 * self.t_end)

    def unit(self) -> float:
        """Unit of the steps of other engines [s]."""
        return self.first_step()

    def find_reference(self, budget: float) -> Reference:
        """Impulses with ever shorter steps; their last change is the limit."""
        step, floor = self.first_step(), np.inf
        before = self.states("moreau", step)  # compile
        start = THREADS.local.clock()
        while floor == np.inf or (THREADS.local.clock() - start < budget and floor > 1e-12):
            step *= 0.5
            after = self.states("moreau", step)
            before, floor = after, self.difference(before, after)
        return Reference(before, f"impulses with a step of {step:.3g} s", floor)

    def ladder(self, method: str) -> Iterator[float]:
        """Ever shorter steps [s], or stiffer springs [N/m]."""
        if method != PENALTY:
            return nice_steps(self.first_step())
        return (self.softest() * _STIFFNESS_RATIO**k for k in range(16))

    def measured(self, method: str, step: float | None, repeats: int = REPEATS) -> Point:
        """One point; springs are told by their default step."""
        point = super().measured(method, step, repeats)
        if method != PENALTY or step is None:
            return point
        groups = self.plan(method, step).groups
        dt = min(s.dt for group in groups for s in group.segments if s.dt > 0.0)
        return point._replace(method=f"{method}, {step:g} N/m", step=dt)


def with_springs(system: System, stiffness: float) -> System:
    """The same system with springs [N/m] in the place of impulses."""
    assert system.contact is not None
    pairs = system.contact.pair
    sticks = any(table.restitution == 0.0 for table in (system.contact, *pairs))
    changed = {"law": "hooke", "stiffness": stiffness, "attract": sticks}
    return system._replace(contact=system.contact.model_copy(update=changed))
