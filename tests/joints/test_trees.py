"""Accelerations of trees by elimination of their leaves, beside those by multipliers."""

import numpy as np
import pytest
from scenes import SCENES, X, Y, Z, bar, body, case, joint

import particlerb
from particlerb.integrators import dop853_stages
from particlerb.integrators.joint_slopes import add_reactions, bring_back
from particlerb.stepping import adaptive

pytestmark = pytest.mark.plain


def every_type(is_tied):
    """All types of joints in one tree, with the outer body first or second, and a spring."""
    moments = [0.01, 0.02, 0.025]
    bodies = [
        bar("b0", [0, 0, 0], [0.6, 0, 0], 1.0, 0.08),
        body("b1", 2.0, [0.02, 0.03, 0.04], [0.75, 0.05, 0]),
        bar("b2", [0.9, 0.1, 0], [0.9, 0.1, 0.5], 0.5, 0.06),
        body("b3", 0.7, moments, [1.0, 0.1, 0.6]),
        bar("b4", [1.0, 0.3, 0.6], [1.0, 0.3, 1.1], 0.4, 0.05),
        body("b5", 0.3, moments, [0.2, 0.4, 0.1]),
        body("b6", 0.3, moments, [0.2, -0.4, 0.1]),
        body("b7", 0.3, moments, [0.3, -0.4, 0.1]),
    ]
    joints = [
        joint("universal", "b0", None, [0, 0, 0], Z, axis_to=Y),
        joint("hinge", "b1", "b0", [0.6, 0, 0], [0, 1, 0.5], spring={"stiffness": 3.0}),
        joint("ball", "b1", "b2", [0.9, 0.1, 0]),
        joint("slider", "b3", "b2", [0.9, 0.1, 0.5], [1, 0, 1]),
        joint("cylindrical", "b4", "b3", [1.0, 0.2, 0.6], Y),
        joint("planar", "b5", "b0", [0.2, 0.3, 0.1], [0, 1, 1]),
        joint("cylindrical", "b0", "b6", [0.2, -0.3, 0.1], X),
        joint("fixed", "b7", "b6", [0.25, -0.4, 0.1], merge=False),
    ]
    push = [{"type": "push", "body": "b4", "at": [0, 0.1, 0.2], "force": [1, 5, 0]}]
    push += [{"type": "push", "body": "b5", "at": [0, 0.1, 0.2], "force": [1, 0, 2]}]
    return case(bodies, joints[0 if is_tied else 1 :], force=push)


def motion_at(scene, t, monkeypatch):
    """The motion of a scene that was moved by DOP853 until t."""
    kept = []
    record = adaptive.AdaptiveMotion.record

    def and_keep(self, *arguments):
        kept.append(self)
        return record(self, *arguments)

    monkeypatch.setattr(adaptive.AdaptiveMotion, "record", and_keep)
    times = {"t_end": t, "every": t, "method": "dop853", "tolerance": 1e-8}
    particlerb.run({"run": times, **scene}).close()
    return kept[-1]


def rods():
    """Two bodies without a moment about their axes."""
    bodies = [bar("a", [0, 0, 0], [1, 0, 0], side=0.0), bar("b", [1, 0, 0], [1, 1, 0], side=0.0)]
    return case(bodies, [joint("ball", "a"), joint("ball", "b", "a", [1, 0, 0])])


TREES = {
    "all types": every_type(True),
    "in space": every_type(False),
    "six hinges": SCENES["chain6"](),
    "rods": rods(),
}


@pytest.mark.parametrize("name", TREES)
def test_trees_accelerate_as_by_multipliers(name, monkeypatch):
    motion = motion_at(TREES[name], 0.2, monkeypatch)
    bring_back(motion.jointed, motion.vectors.y, motion.vectors.width, 0.2)
    found = []
    assert motion.jointed.tree is not None
    assert motion.equations.acting.pair is None  # no loads are gathered where there are none
    for tree in (motion.jointed.tree, None):
        slope = np.zeros_like(motion.vectors.y)
        at = motion.vectors.width, 0.2, motion.vectors.y, slope
        dop853_stages.slopes_of_blocks(motion.equations, motion.blocks, motion.layout, *at)
        own = motion.jointed._replace(tree=tree)
        sums_external = motion.equations.sums_external
        add_reactions(sums_external, own, motion.vectors.y, slope, motion.vectors.width, 0.2)
        found.append(slope)
    assert np.abs(found[1]).max() > 5.0
    assert found[0] == pytest.approx(found[1], abs=1e-11)


def alone(kind, **keys):
    """A bar on one joint."""
    return case([bar("a", [0, 0, 0], [1, 0, 0])], [joint(kind, "a", None, [0, 0, 0], X, **keys)])


WITH_ROWS = {
    "a loop": SCENES["bricard"](),
    "a distance": SCENES["mixed_chain"](),
    "a screw": alone("screw", lead=0.1),
    "a drive": alone("hinge", drive={"speed": 0.0}),
}


@pytest.mark.parametrize("name", WITH_ROWS)
def test_what_is_no_tree_keeps_its_rows(name, monkeypatch):
    assert motion_at(WITH_ROWS[name], 0.01, monkeypatch).jointed.tree is None
