"""The force-gradient method beside one written from its definition, and what it keeps and refuses.

Here the bent kicks are those of the potential b V - κh² (F²/M + τ·I⁻¹τ), whose slopes are found by
differences along the axes of the world, and bodies drift by a Taylor series.
"""

import numpy as np
import pytest
from formulas import product

import particlerb
from particlerb.case.problems import CaseError
from particlerb.integrators.force_gradient import CLOSING_KICK, DRIFTS, GRADIENT, KICKS

MASS = 2.0
CLASSES = {
    "point": (0.0, 0.0, 0.0),
    "rod": (1.3, 1.3, 0.0),
    "sphere": (1.7, 1.7, 1.7),
    "symmetric": (2.0, 2.0, 0.5),
    "asymmetric": (1.0, 2.0, 2.5),
}


def forces(make, name):
    """All kinds of force that the method accepts, on a body of a rotor class."""
    at = {"point": [0, 0, 0], "rod": [0, 0, 0.4]}.get(name, [0.1, 0.2, 0.3])
    pushed = {"point": [0, 0, 0], "rod": [0, 0, -0.5]}.get(name, [0.4, -0.3, 0.2])
    return [
        make.push([1.0, 2.0, -1.5], pushed),
        make.field([0.3, -0.5, 0.8], charge=0.7, dipole=pushed),
        make.spring([0, 0, 4.0], 1.5, 0.5, at),
        make.spring([1, 1, 1.0], 2.0, 0.0, at),
        make.central(3.0, [5.0, 0, 0]),
    ]


def start(name):
    """How a body of a rotor class begins."""
    spin = {"point": [0, 0, 0], "rod": [0.9, -0.4, 0]}.get(name, [0.8, 0.4, -0.7])
    return {
        "position": [1.0, 0.2, 0.3],
        "velocity": [0.3, 0.1, -0.2],
        "orientation": np.array([0.8, 0.1, 0.5, -0.3]) / np.sqrt(0.99),
        "angular_velocity": {"body": spin},
    }


def drifted(q, m, inverse, t, terms=22):
    """Free rotation over t by the Taylor series of q̇ = ½ q (0, ω), ṁ = m × ω."""
    ms, qs = [m], [q]
    for k in range(terms):
        spins = [np.array([0.0, *(inverse * one)]) for one in ms]
        dm = sum(np.cross(ms[i], spins[k - i][1:]) for i in range(k + 1))
        dq = sum(product(qs[i], spins[k - i]) for i in range(k + 1))
        ms.append(dm / (k + 1))
        qs.append(0.5 * dq / (k + 1))
    return sum(one * t**k for k, one in enumerate(qs))


def turned(R, w):
    """R after a turn by w, world axes."""
    size = np.linalg.norm(w)
    K = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    return (np.eye(3) + np.sin(size) / size * K + 2 * np.sin(size / 2) ** 2 / size**2 * K @ K) @ R


def stepped(make, inertia, first, force, dt, steps):
    """x, q, p and L after so many steps."""
    tensor = np.diag(inertia)
    inverse = np.divide(1.0, inertia, out=np.zeros(3), where=np.array(inertia) > 0)
    x, q = np.array(first["position"]), np.array(first["orientation"])
    R = make.rotation(q).as_matrix()
    p = MASS * np.array(first["velocity"])
    L = R @ (inertia * np.array(first["angular_velocity"]["body"]))

    def loads(x, R):
        each = [make.pulled(x, R, tensor, MASS, np.zeros(3), np.zeros(3), one) for one in force]
        return np.sum([F for F, _ in each], axis=0), np.sum([tau for _, tau in each], axis=0)

    def work(x, R):
        F, tau = loads(x, R)
        own = R.T @ tau
        return F @ F / MASS + own @ (inverse * own)

    def slope(x, R, e=2e-3):
        def moved(k, s):
            return (x + s * np.eye(3)[k], R) if k < 3 else (x, turned(R, s * np.eye(3)[k - 3]))

        found = []
        for k in range(6):
            near, far = (work(*moved(k, n * e)) - work(*moved(k, -n * e)) for n in (1, 2))
            found.append((8 * near - far) / (12 * e))
        return np.array(found[:3]), np.array(found[3:])

    for _ in range(steps):
        for k, kick in enumerate((*KICKS, CLOSING_KICK)):
            F, tau = loads(x, R)
            p, L = p + kick * dt * F, L + kick * dt * tau
            if 0 < k < len(DRIFTS):
                dx, turn = slope(x, R)
                p, L = p + 0.5 * GRADIENT * dt**3 * dx, L + 0.5 * GRADIENT * dt**3 * turn
            if k < len(DRIFTS):
                x = x + DRIFTS[k] * dt * p / MASS
                q = drifted(q, R.T @ L, inverse, DRIFTS[k] * dt)
                R = make.rotation(q).as_matrix()
    return x, q / np.linalg.norm(q), p, L


@pytest.mark.parametrize("name", CLASSES)
def test_steps_are_those_of_the_definition(make, name):
    """A hundred of an asymmetric body, and some of all others."""
    inertia, force, first, dt = CLASSES[name], forces(make, name), start(name), 0.05
    steps = 100 if name == "asymmetric" else 20
    x, q, p, L = stepped(make, inertia, first, force, dt, steps)
    body = make.body(inertia=inertia, **first)
    run = {"t_end": steps * dt, "every": steps * dt, "method": "force_gradient", "dt": dt}
    found = make.arrays(make.case(body, force=force, **run))
    assert found.position[-1, 0] == pytest.approx(x, abs=1e-12)
    assert found.linear_momentum[-1, 0] == pytest.approx(p, abs=2e-12)
    assert found.angular_momentum[-1, 0] == pytest.approx(L, abs=2e-12)
    if name != "point":
        assert make.angle(found.orientation[-1, 0], q) < 1e-12


def test_kicks_and_drifts_are_symmetric_and_sum_to_one():
    """And are of order 4: Σ b (t - t²) = 1/6, and gradients make up for Σ b b |t - t|."""
    kicks, drifts = np.array([*KICKS, CLOSING_KICK]), np.array(DRIFTS)
    assert (drifts == drifts[::-1]).all()
    assert kicks.sum() == pytest.approx(1, abs=1e-15)
    assert drifts.sum() == pytest.approx(1, abs=1e-15)
    assert (drifts > 0).all()
    t = np.array([0, *np.cumsum(drifts)])
    assert (kicks * (t - t * t)).sum() == pytest.approx(1 / 6, abs=1e-15)
    apart = np.abs(t[:, None] - t[None, :])
    assert kicks @ apart @ kicks + 4 * GRADIENT == pytest.approx(1 / 3, abs=1e-15)


@pytest.mark.compiled
def test_the_energy_of_a_tumbling_top_does_not_drift(make):
    """2e4 turns with 12 steps in each: it swings, and swings no wider at the end."""
    top = make.body(inertia=(1.0, 1.2, 0.6), angular_velocity={"body": [0.4, -0.3, 1.5]})
    force = [make.push([0, 0, -1.0], [0, 0, 0.3]), make.push([0, 0, 1.0])]
    run = {"method": "force_gradient", "dt": 0.3, "t_end": 7.5e4, "every": 1.5}
    found = make.arrays(make.case(top, force=force, **run))
    error = np.abs(found.ledger.energy_error).reshape(-1)[1:].reshape(50, 1000).max(axis=1)
    assert 1e-9 < error[0] < 1e-4
    assert error[-5:].max() < 1.5 * error[:5].max()


def cluster(make):
    """An asymmetric body, a disc, a rod and a point on springs between them and to the world."""
    spins = {"stone": [0.5, -0.4, 0.3], "disc": [0.2, 0.4, -0.6], "rod": [0.6, 0.2, 0.0]}
    inertia = {"stone": (1.0, 2.0, 2.5), "disc": (0.7, 0.7, 1.2), "rod": (0.8, 0.8, 0.0)}
    at = {"stone": [0.3, 0.2, -0.1], "disc": [-0.2, 0.1, 0.3], "rod": [0, 0, 0.4]}
    bodies = [
        make.body(name, inertia[name], position=[1.5 * k, 0.4 * k * k, -0.3 * k])
        | {"angular_velocity": {"body": spins[name]}}
        for k, name in enumerate(spins)
    ]
    bodies.append(make.body("point", (0, 0, 0), position=[0.5, -1.5, 1.0]))
    ends = [("stone", "disc"), ("disc", "rod"), ("rod", "stone"), ("stone", "point")]
    ties = [
        make.tie(
            other, 2.0 + k, one, at=at[one], to_at=at.get(other, [0, 0, 0]), rest_length=0.5 * k
        )
        for k, (one, other) in enumerate(ends)
    ]
    held = [make.spring([0, 0, 3.0], 1.5, 0.7, at["stone"], "stone")]
    held += [make.push([0.2, 0.5, -0.3], [0, 0, 0.3], "rod"), make.central(2.0, [4, 4, 4], "disc")]
    return bodies, ties, held


@pytest.mark.compiled
def test_bodies_on_springs_are_met_with_order_four_and_their_momenta_are_kept(make):
    bodies, ties, held = cluster(make)
    run = {"t_end": 2.0, "every": 2.0, "force": ties + held}
    true = make.arrays(make.case(*bodies, **run, method="dop853", tolerance=1e-14))
    steps, errors = 0.05 / 2.0 ** np.arange(4), []
    for dt in steps:
        found = make.arrays(make.case(*bodies, **run, method="force_gradient", dt=dt))
        apart = make.angle(found.orientation[-1, :3], true.orientation[-1, :3]).max()
        errors.append(max(apart, np.abs(found.position[-1] - true.position[-1]).max()))
        assert np.abs(found.ledger.linear_momentum_error).max() < 1e-13
        assert np.abs(found.ledger.angular_momentum_error).max() < 3e-13
    assert errors[0] < 1e-6
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(4, abs=0.1)


REFUSED = {
    "drag": (lambda make: make.drag(1.0, 0.0), "drag (it depends on velocities)"),
    "field": (
        lambda make: make.field([1.0, 0, 0], 1.0, angular_velocity=[0, 0, 1.0]),
        "rotating field (its gradient is not known)",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_known_gradient_is_refused_with_the_reason(make, name):
    force, words = REFUSED[name]
    scene = make.case(make.body(), force=[force(make)], method="force_gradient", dt=0.1)
    with pytest.raises(CaseError) as caught:
        particlerb.run(scene)
    assert f"force_gradient does not accept what acts here: {words}" in str(caught.value)


def test_a_torque_beside_springs_between_bodies_is_refused(make):
    """Its work would be of order 2."""
    bodies = [make.body("a"), make.body("b", position=[3.0, 0, 0])]
    force = [make.tie("a", 2.0, "b"), make.torque([0, 0, 1.0], "a")]
    scene = make.case(*bodies, force=force, method="force_gradient", dt=0.1)
    with pytest.raises(CaseError, match=r"torque \(its gradient is not known\)"):
        particlerb.run(scene)


def timed(values):
    """Knots at the ends of a run of 1 s, and one within it."""
    return {"times": [0.0, 0.37, 1.0], "values": values}


WITHOUT_POTENTIAL = {
    "torque": lambda make: [make.torque([1.0, 2.0, -1.0])],
    "follower": lambda make: [make.push([1.0, -2.0, 3.0], [0.4, -0.3, 0.2], frame="body")],
    "tables": lambda make: [
        make.push([0, 0, 0], [0.4, -0.3, 0.2])
        | {"force": timed([[3, -4, 6], [-2, 1, 0.5], [1, 3, -8]])},
        make.torque([0, 0, 0])
        | {"torque": timed([[1, 0, 2], [-2, 1, 0.5], [1, 3, 0]]), "frame": "body"},
    ],
}


@pytest.mark.plain
@pytest.mark.parametrize("name", WITHOUT_POTENTIAL)
def test_loads_without_potential_are_met_with_order_four_beside_those_that_have_one(make, name):
    """And so is their work, to which both kinds of loads together add a term of their own."""
    held = [make.push([2.0, 1.0, 3.0], [0.4, -0.3, 0.2]), make.spring([0, 0, 2.0], 8.0, 0.7)]
    held[1]["at"] = [0.2, 0.1, 0.3]
    case = make.case(make.body(**start("asymmetric")), force=held + WITHOUT_POTENTIAL[name](make))
    case["run"] |= {"t_end": 1.0, "every": 1.0}
    case["gravity"] = {"acceleration": [0.5, -1.0, -3.0]}
    true = make.arrays(case, "run.method=dop853", "run.tolerance=1e-14")
    steps, errors, balance = 0.05 / 2.0 ** np.arange(3), [], []
    for dt in steps:
        found = make.arrays(case, "run.method=force_gradient", f"run.dt={dt}")
        apart = make.angle(found.orientation[-1, 0], true.orientation[-1, 0])
        errors.append(max(apart, np.abs(found.position[-1] - true.position[-1]).max()))
        balance.append(abs(found.ledger.energy_error[-1]))
    assert errors[0] < 1e-6
    assert balance[0] < 1e-6
    for found in (errors, balance):
        assert np.polyfit(np.log(steps), np.log(found), 1)[0] == pytest.approx(4, abs=0.3)


def test_bodies_that_attract_each_other_are_refused(make):
    bodies = [make.body("a"), make.body("b", position=[3.0, 0, 0])]
    scene = make.case(*bodies, attraction={"G": 1.0}, method="force_gradient", dt=0.1)
    with pytest.raises(CaseError, match=r"attraction \(its gradient is not known\)"):
        particlerb.run(scene)
