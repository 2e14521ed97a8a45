"""What acts along coordinates of joints, and dashpots among jointed bodies, as rows."""

import numpy as np

from particlerb.case.joints import JointLoad, JointTable
from particlerb.forces.links import WORLD, Links
from particlerb.joints.records import AT_REST, STRETCH, Actions, Breaks, ConstraintRows
from particlerb.joints.setup import action, both_actions
from particlerb.maths.vec3 import Ints
from particlerb.model.system import System


def action_of(table: JointTable) -> Actions:
    """What acts along the coordinate of a joint."""
    spring, limit = table.spring, table.limit
    return action(
        *((spring.stiffness, spring.rest) if spring else (0.0, 0.0)),
        table.damper,
        *((*limit.range, limit.stiffness, limit.damping) if limit else (-np.inf, np.inf, 0.0, 0.0)),
        table.motor,
    )


def breaks_of(system: System, record: Ints) -> Breaks:
    """Loads at which joints break, of these records."""
    loads = [table.breaks_at or JointLoad.model_construct() for table in system.joint]
    each = [(load.force or np.inf, load.torque or np.inf) for load in loads]
    return Breaks(*np.ascontiguousarray(np.array(each)[record].T))


def with_dashpots(
    rows: ConstraintRows, actions: Actions, links: Links, n: int
) -> tuple[ConstraintRows, Actions]:
    """Rows and actions of joints of n bodies, with the dashpots among them."""
    assert links.damping is not None
    m = links.first.size
    own = ConstraintRows(
        np.full(m, STRETCH),
        links.first,
        np.where(links.second == WORLD, n, links.second),
        np.ascontiguousarray(links.first_at.T),
        np.ascontiguousarray(links.second_at.T),
        np.zeros((m, 3)),
        np.ones(m),
        np.ones(m),
        actions.motor.size + np.arange(m),
        np.full(m, AT_REST),
    )
    none = np.zeros((8, m))
    damping = Actions(*none)._replace(
        damping=links.damping, lower=none[3] - np.inf, upper=none[4] + np.inf
    )
    both = ConstraintRows(*(np.concatenate(pair) for pair in zip(rows, own, strict=True)))
    return both, both_actions(actions, damping)
