"""Rows, A = G M⁻¹ Gᵀ and its sparse factor beside dense matrices in NumPy."""

import numpy as np
import pytest
from scenes import SCENES, X, Z, bar, body, case, four_bar, hinge_chain, joint
from scipy.spatial.transform import Rotation

from particlerb.case.to_system import to_system
from particlerb.joints.block_cholesky import solve
from particlerb.joints.iterations import remember, warm_start
from particlerb.joints.records import HOLDS, P, Q, joint_data_at
from particlerb.joints.records import X as AT
from particlerb.joints.rows import rates, residual, residuals
from particlerb.joints.solver import factorise_cluster
from particlerb.simulation.run import prepare

pytestmark = pytest.mark.plain
FORESEEN = {0: 0, 1: 1, 4: 85, 5: 156, 8: 585, 9: 820}  # of 1 + n + n² + n³, by those known


def wheel():
    """A hub with five arms, tied to each other at their ends by rods: loops, and a full block."""
    angles = 2 * np.pi * np.arange(5) / 5
    ends = np.stack([np.cos(angles), np.sin(angles), 0.1 * angles], axis=1)
    bodies = [body("hub", 3.0, [0.3, 0.4, 0.5], [0, 0, 0], q=(0.5, 0.5, 0.5, 0.5))]
    bodies += [bar(f"arm{k}", 0.2 * end, end, 1.0 + k) for k, end in enumerate(ends)]
    joints = [joint("ball", f"arm{k}", "hub", 0.2 * end) for k, end in enumerate(ends)]
    joints += [
        joint("distance", f"arm{k}", f"arm{(k + 1) % 5}", end)
        | {"at_to": ends[(k + 1) % 5].tolist()}
        for k, end in enumerate(ends)
    ]
    return case(bodies, joints)


def acting():
    """Joints with seven rows and with six, whose springs and dampers hold nothing."""
    drive = {"speed": 0.0}
    keys = {"spring": {"stiffness": 2.0}, "damper": 0.3}
    bodies = [bar("a", [0, 0, 0], [1, 0, 0]), bar("b", [1, 0, 0], [1, 1, 0], 2.0)]
    bodies.append(body("c", 0.5, [0.1, 0.2, 0.25], [1, 1, 0.2], q=(0.6, 0, 0.8, 0)))
    joints = [joint("hinge", "a", None, [0, 0, 0], Z, drive=drive, **keys)]
    joints.append(joint("ball", "b", "a", [1, 0, 0], **keys))
    universal = {"axis_to": Z, "along": "angle about axis"} | keys
    joints.append(joint("universal", "c", "b", [1, 1, 0], X, **universal))
    return case(bodies, joints)


def at_start(scene):
    """Joints of a scene, and their data."""
    prepared = prepare(to_system({"run": {"t_end": 1.0, "every": 0.1}, **scene}))
    (group,) = [own for own in prepared.plan.groups if own.segments[0].terms.joints is not None]
    joints = group.segments[0].terms.joints
    state = type(prepared.system.state)(*(v[:, group.members] for v in prepared.system.state))
    return joints, joint_data_at(joints, state)


def turned(y, b, path, angle):
    """States with body b shifted, and turned in world axes."""
    moved = y.copy()
    moved[b, AT : AT + 3] += path
    q = Rotation.from_rotvec(angle) * Rotation.from_quat(y[b, Q : Q + 4], scalar_first=True)
    moved[b, Q : Q + 4] = q.as_quat(scalar_first=True)
    return moved


def dense_gradient(joints, y):
    """∂g/∂(x, θ) of all rows that hold, by central differences, (m, 6 n)."""
    n, m, h = len(y) - 1, joints.rows.kind.size, 1e-5
    found = np.zeros((m, n, 6))
    for b in range(n):
        for i in range(6):
            step = np.zeros(6)
            step[i] = h
            ends = [turned(y, b, *np.split(sign * step, 2)) for sign in (1, -1)]
            for r in np.flatnonzero(joints.rows.action == HOLDS):
                up, down = (residual(joints.rows, joints.drives, end, r, 0.0) for end in ends)
                found[r, b, i] = (up - down) / (2 * h)
    return found.reshape(m, -1)


def dense_inverse_mass(joints, y):
    """M⁻¹ of all bodies, world axes."""
    n = len(y) - 1
    found = np.zeros((n, 6, n, 6))
    for b in range(n):
        R = Rotation.from_quat(y[b, Q : Q + 4], scalar_first=True).as_matrix()
        found[b, :3, b, :3] = joints.inv_mass[b] * np.eye(3)
        found[b, 3:, b, 3:] = R @ np.diag(joints.inv_inertia[b]) @ R.T
    return found.reshape(6 * n, 6 * n)


@pytest.mark.parametrize("name", ["mixed_chain", "slider_crank", "bricard", "wheel", "acting"])
def test_the_factor_solves_what_dense_matrices_say(name):
    scene = {"wheel": wheel, "acting": acting}.get(name) or SCENES[name]
    joints, data = at_start(scene())
    G, inverse = dense_gradient(joints, data.y), dense_inverse_mass(joints, data.y)
    A = G @ inverse @ G.T
    b = A @ np.random.default_rng(7).normal(size=len(A))
    data.z[:] = b
    assert joints.clusters.body.size == 2
    factorise_cluster(joints, data, 0, 0.0, 0.0)
    solve(joints.program, joints.clusters, data.factor, data.z, 0)
    assert A @ data.z == pytest.approx(b, abs=1e-7 * np.abs(b).max())
    assert (data.z[joints.rows.action != HOLDS] == 0.0).all()


def test_branches_of_a_tree_take_turns_and_loops_close_where_they_did():
    chain, _ = at_start(hinge_chain(6))
    assert chain.program.order.tolist() == [0, 5, 1, 4, 2, 3]
    linkage, _ = at_start(four_bar(1.0))
    assert linkage.program.order.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("coupler", [1e-10, 1e-8, 1e-6, 1.0, 1e6, 1e8, 1e10])
def test_which_rows_are_redundant_does_not_depend_on_masses(coupler):
    joints, data = at_start(four_bar(coupler))
    factorise_cluster(joints, data, 0, 0.0, 0.0)
    left_out = data.factor[:, range(5), range(5)][:4] == 0.0
    assert np.argwhere(left_out).tolist() == [[3, 2], [3, 3], [3, 4]]


def test_a_row_that_is_no_number_is_not_hidden_by_those_behind_it():
    joints, data = at_start(wheel())
    factorise_cluster(joints, data, 0, 0.0, 0.0)
    rows, y = joints.rows, data.y.copy()
    for b in range(len(y) - 1):
        data.y[b] = np.nan
        assert np.isnan(rates(joints, data, 0, rows.kind.size))
        worst, r = residuals(joints, data, 0, rows.kind.size, 0.0)
        assert np.isnan(worst)
        assert b in (rows.a[r], rows.b[r])
        data.y[b] = y[b]


def test_a_step_begins_with_the_impulses_that_a_cubic_foresees():
    """Of two hinges of a door five rows depend on others, and have none."""
    door = body("door", 2.0, [0.1, 0.2, 0.3], [0.4, 0, 0])
    places = {"lower": [0, 0, -0.5], "upper": [0, 0, 0.5]}
    joints, data = at_start(
        case([door], [joint("hinge", "door", None, at, Z, name=n) for n, at in places.items()])
    )
    factorise_cluster(joints, data, 0, 0.0, 0.0)
    row = np.arange(1.0, 11.0)
    own = data.factor[:, range(5), range(5)][:2].ravel() != 0.0
    assert own.sum() == 5
    for known in range(10):
        before = data.y.copy()
        data.impulse[:] = 0.0
        warm_start(joints, data, 0, 0.25)
        if known in FORESEEN:
            assert data.impulse == pytest.approx(np.where(own, 0.25 * FORESEEN[known] * row, 0.0))
        given = data.y[0, P : P + 3] - before[0, P : P + 3]
        assert given == pytest.approx(data.impulse @ data.gradient[:, :3], abs=1e-12)
        data.impulse[:] = 0.5 * row * (1 + known + known**2 + known**3)
        remember(data, 0, 10, 0.5, False)
