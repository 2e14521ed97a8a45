"""Bodies that act on each other: orders, momenta, groups, frames, segments, threads, accuracy.

Two sets of forces serve most of these tests, so that few kernels are compiled: SMOOTH, which every
method accepts, and DAMPED, with dashpots and drag. What a test does not want of them is too small
to change a bit.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from particlerb.case.to_system import to_system
from particlerb.forces.registry import MANY
from particlerb.integrators import METHODS
from particlerb.model.block import STRIDE
from particlerb.simulation.run import prepare
from particlerb.stepping import pair_forces
from particlerb.stepping.pair_forces import PairForces
from particlerb.stepping.stepped_bodies import SteppedBodies
from particlerb.studies.chart import chart

T_END = 1.6
SMOOTH_METHODS = ("strang", "rkn6")
DAMPED_METHODS = ("strang", "rk4", "semi_implicit_euler", "explicit_euler", "momentum_euler")
NOTHING = 1e-300
SOFT = 0.5  # m: particles may come near each other
UP = np.array([0.0, 0.0, 1.0])


def with_centre(position, mass):
    """Particles moved so that their centre of mass is the origin, (n, 3) and (n,)."""
    position, mass = np.array(position, dtype=float), np.array(mass, dtype=float)
    return position - mass @ position / mass.sum(), mass


r = 0.3
KINDS = {  # one of each rotor class; the axes of the stone are not its principal ones
    "stone": with_centre(
        [[0.4, 0.1, 0.0], [-0.3, 0.2, 0.1], [0.0, -0.4, 0.2], [0.1, 0.1, -0.5], [0, 0.3, 0.3]],
        [0.5, 0.4, 0.3, 0.2, 0.4],
    ),
    "disc": with_centre(
        [[r, 0, 0], [-r, 0, 0], [0, r, 0], [0, -r, 0], [0, 0, 0.1], [0, 0, -0.1]], [0.25] * 6
    ),
    "ball": with_centre(
        [[r, 0, 0], [-r, 0, 0], [0, r, 0], [0, -r, 0], [0, 0, r], [0, 0, -r]], [0.2] * 6
    ),
    "rod": with_centre([[0, 0, 0.4], [0, 0, -0.4]], [0.5, 0.5]),
    "point": with_centre([[0, 0, 0]], [0.8]),
}
PLACES = {
    "stone": [0.0, 0.0, 0.0],
    "disc": [1.6, 0.2, 0.1],
    "ball": [0.1, 1.5, -0.3],
    "rod": [-1.3, 0.4, 0.5],
    "point": [0.3, -0.4, 1.4],
}


def blocks(kinds=tuple(KINDS), seed=7, names=None, away=(0.0, 0.0, 0.0)):
    """One body of each of these kinds, at its place and on its way."""
    found = []
    for i, kind in enumerate(kinds):
        rng = np.random.default_rng([seed, list(KINDS).index(kind)])
        position, mass = KINDS[kind]
        q = rng.standard_normal(4)
        q /= np.linalg.norm(q)
        v, w = 0.3 * rng.standard_normal(3), 1.0 * rng.standard_normal(3)
        if kind == "rod":
            axis = Rotation.from_quat(q, scalar_first=True).apply(UP)
            w -= (w @ axis) * axis
        if kind == "point":
            w *= 0
        found.append(
            {
                "name": names[i] if names else kind,
                "shape": {"type": "points", "position": position.tolist(), "mass": mass.tolist()},
                "position": (np.array(PLACES[kind]) + away).tolist(),
                "orientation": q.tolist(),
                "velocity": v.tolist(),
                "angular_velocity": w.tolist(),
            }
        )
    return found


def ties(make, damping=0.0, stiffness=1.0):
    """Springs between the bodies of the cluster, off their centres where they can be."""
    at = {"stone": [0.2, -0.1, 0.3], "disc": [0.25, 0.1, 0.05], "ball": [0.0, 0.2, -0.2]}
    at |= {"rod": [0.0, 0.0, 0.4], "point": [0.0, 0.0, 0.0]}
    ends = [("stone", "disc"), ("rod", "point"), ("ball", "stone"), ("point", "stone")]
    ends += [("rod", "ball"), ("disc", "ball")]
    found = []
    for k, (one, other) in enumerate(ends):
        keys = {"at": at[one], "to_at": at[other], "rest_length": 0.7 + 0.1 * k}
        keys |= {"damping": damping * (1 + k)} if damping else {}
        found.append(make.tie(other, stiffness * (2.0 + k), one, **keys))
    return found


def outside(make, size=1.0):
    """What the world does to some of the bodies: a push and a spring."""
    return [
        make.push([0.3 * size, -0.2 * size, 0.4 * size], [0.2, 0.1, -0.3], "stone"),
        make.spring([0.5, 2.5, 0.0], 1.5 * size, 0.4, [0.1, 0.0, 0.2], "ball"),
    ]


def losses(make, size=1.0):
    """Drag on one body, and a dashpot to the world on another."""
    damper = make.spring([-2.0, 0.0, 1.0], 0.8 * size, 0.5, [0, 0, -0.4], "rod")
    return [make.drag(0.3 * size, 0.05 * size, "disc"), damper | {"damping": 0.4 * size}]


def smooth(make, size=1.0):
    """Case keys: attraction, springs, gravity, a push and a spring to the world."""
    force = [*ties(make), *outside(make, size)]
    return {"force": force, **fields(size)}


def damped(make, size=1.0):
    """The same with dashpots, drag, and a damped spring to the world."""
    force = [*ties(make, damping=0.1 * size), *outside(make, size), *losses(make, size)]
    return {"force": force, **fields(size)}


def fields(size=1.0):
    gravity = [0.1 * size, -0.2 * size, -0.5 * size]
    return {"gravity": {"acceleration": gravity}, "attraction": {"G": 0.3, "softening": SOFT}}


# An independent integrator ------------------------------------------------------------------------


class Together:
    """Newton's and Euler's equations for bodies that act on each other, written anew.

    The state has rows x, v, q, ω (body frame) for each body. `case` is a case of this file.
    """

    def __init__(self, make, case):
        self.make, self.bodies = make, case["body"]
        self.n = len(self.bodies)
        number = {body["name"]: b for b, body in enumerate(self.bodies)}
        shapes = [body["shape"] for body in self.bodies]
        self.r = [np.array(shape["position"]) for shape in shapes]
        self.m = [np.array(shape["mass"]) for shape in shapes]
        self.mass = np.array([m.sum() for m in self.m])
        self.tensor = np.array(
            [(m * (r * r).sum(1)).sum() * np.eye(3) - (m[:, None] * r).T @ r
             for m, r in zip(self.m, self.r, strict=True)]
        )  # fmt: skip
        self.inverse = np.array([np.linalg.pinv(t, rcond=1e-12) for t in self.tensor])
        self.owner = np.repeat(np.arange(self.n), [len(m) for m in self.m])
        self.flat, self.heavy = np.concatenate(self.r), np.concatenate(self.m)
        self.G = case.get("attraction", {}).get("G", 0.0)
        self.soft = case.get("attraction", {}).get("softening", 0.0)
        self.g = np.array(case.get("gravity", {"acceleration": [0, 0, 0]})["acceleration"])
        self.links, self.single = [], []
        for force in case["force"]:
            one = number[force["body"]]
            if "to" in force or force.get("damping"):
                other = number[force["to"]] if "to" in force else None
                end = force.get("to_at", [0, 0, 0]) if "to" in force else force["anchor"]
                at = np.array(force.get("at", [0, 0, 0]))
                numbers = force["stiffness"], force["rest_length"], force.get("damping", 0.0)
                self.links.append((one, at, other, np.array(end), *numbers))
            else:
                self.single.append((one, force))

    def start(self):
        rows = []
        for body in self.bodies:
            q = np.array(body["orientation"])
            w = self.make.rotation(q).inv().apply(body["angular_velocity"])
            rows.append(np.concatenate([body["position"], body["velocity"], q, w]))
        return np.array(rows)

    def loads(self, x, v, R, w):
        """Forces and torques about the centres of mass, world frame, (n, 3) each."""
        F, tau = self.mass[:, None] * self.g, np.zeros((self.n, 3))
        F = F.copy()
        if self.G:
            arm = np.einsum("pij,pj->pi", R[self.owner], self.flat)
            place = x[self.owner] + arm
            d = place[None] - place[:, None]
            distance = np.sqrt((d * d).sum(axis=2) + self.soft**2)
            own = self.owner[:, None] == self.owner[None]
            weight = np.where(
                own, 0.0, self.heavy[:, None] * self.heavy / np.where(own, 1, distance) ** 3
            )
            pull = self.G * (weight[:, :, None] * d).sum(axis=1)
            np.add.at(F, self.owner, pull)
            np.add.at(tau, self.owner, np.cross(arm, pull))
        spin = np.einsum("bij,bj->bi", R, w)
        for a, at, b, to, k, rest, c in self.links:
            one = R[a] @ at
            other = to if b is None else R[b] @ to
            d = other - x[a] - one + (0.0 if b is None else x[b])
            n = d / np.linalg.norm(d)
            speed = -n @ (v[a] + np.cross(spin[a], one))
            if b is not None:
                speed += n @ (v[b] + np.cross(spin[b], other))
            force = (k * (np.linalg.norm(d) - rest) + c * speed) * n
            F[a] += force
            tau[a] += np.cross(one, force)
            if b is not None:
                F[b] -= force
                tau[b] -= np.cross(other, force)
        for b, force in self.single:
            own = self.make.pulled(x[b], R[b], self.tensor[b], self.mass[b], v[b], spin[b], force)
            F[b] += own[0]
            tau[b] += own[1]
        return F, tau

    def slope(self, t, y):
        x, v, q, w = np.split(y.reshape(self.n, 13), [3, 6, 10], axis=1)
        R = self.make.rotation(q).as_matrix()
        F, tau = self.loads(x, v, R, w)
        dq = 0.5 * np.concatenate(
            [-(q[:, 1:] * w).sum(1, keepdims=True), q[:, :1] * w + np.cross(q[:, 1:], w)], axis=1
        )
        L = np.einsum("bij,bj->bi", self.tensor, w)
        torque = np.einsum("bji,bj->bi", R, tau) - np.cross(w, L)
        dw = np.einsum("bij,bj->bi", self.inverse, torque)
        return np.concatenate([v, F / self.mass[:, None], dq, dw], axis=1).ravel()

    def run(self, t_end, tolerance=1e-13):
        keys = {"method": "DOP853", "rtol": tolerance, "atol": 0.1 * tolerance}
        done = solve_ivp(self.slope, (0.0, t_end), self.start().ravel(), **keys)
        x, v, q, w = np.split(done.y[:, -1].reshape(self.n, 13), [3, 6, 10], axis=1)
        L = np.einsum("bij,bjk,bk->bi", self.make.rotation(q).as_matrix(), self.tensor, w)
        return SimpleNamespace(particles=self.particles(x, q), p=self.mass[:, None] * v, L=L)

    def particles(self, x, q):
        """Places of all particles, for which the turn of a rod about its axis does not matter."""
        R = self.make.rotation(q).as_matrix()
        return x[self.owner] + np.einsum("pij,pj->pi", R[self.owner], self.flat)


def errors(anew, found, true):
    """Root mean squares at the end: of the particles' places [m], of p and of L."""
    places = anew.particles(found.position[-1], found.orientation[-1])
    apart = (
        places - true.particles,
        found.linear_momentum[-1] - true.p,
        found.angular_momentum[-1] - true.L,
    )
    return np.array([np.sqrt((one * one).sum(axis=1).mean()) for one in apart])


def order(steps, errors):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


# Orders -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def truth(make):
    """The two scenes at T_END, from the integrator above."""
    found = {}
    for name, keys in (("smooth", smooth(make)), ("damped", damped(make))):
        case = make.case(*blocks(), t_end=T_END, every=T_END, **keys)
        anew = Together(make, case)
        found[name] = case, anew, anew.run(T_END)
    return found


STEPS = {
    "strang": 0.04 / 2.0 ** np.arange(4),
    "rkn6": T_END / np.array([56, 64, 72, 80, 96]),
    "rk4": 0.04 / 2.0 ** np.arange(4),
    "semi_implicit_euler": 2e-3 / 2.0 ** np.arange(3),
    "explicit_euler": 1e-3 / 2.0 ** np.arange(3),
    "momentum_euler": 1e-3 / 2.0 ** np.arange(3),
}
SCENES = [("smooth", one) for one in SMOOTH_METHODS] + [("damped", one) for one in DAMPED_METHODS]


@pytest.mark.compiled
@pytest.mark.parametrize(("scene", "method"), SCENES)
def test_order_with_attraction_springs_and_forces_on_some(make, truth, scene, method):
    """All rotor classes in one cluster; strang keeps its order with a chain of dashpots."""
    case, anew, true = truth[scene]
    keys = f"run.method={method}"
    found = np.array(
        [errors(anew, make.arrays(case, keys, f"run.dt={dt}"), true) for dt in STEPS[method]]
    )
    assert found[-1].min() > 1e-11  # the fit does not live on rounding
    for kind in found.T:
        assert order(STEPS[method], kind) == pytest.approx(METHODS[method].order, abs=0.15)


@pytest.mark.compiled
@pytest.mark.parametrize("tolerance", [1e-7, 1e-13])
def test_dop853_agrees_with_the_independent_integrator(make, truth, tolerance):
    case, anew, true = truth["damped"]
    found = make.arrays(case, "run.method=dop853", f"run.tolerance={tolerance}")
    assert errors(anew, found, true).max() < 20 * tolerance


@pytest.mark.compiled
def test_the_ledger_closes_at_order_two_where_dashpots_and_drag_take_energy(make):
    case = make.case(*blocks(), t_end=T_END, every=T_END / 8, **damped(make))
    steps = 0.04 / 2.0 ** np.arange(4)
    ledgers = [make.arrays(case, "run.method=strang", f"run.dt={dt}").ledger for dt in steps]
    error = [np.abs(one.energy_error).max() for one in ledgers]
    assert order(steps, error) == pytest.approx(2, abs=0.1)
    assert error[-1] < 1e-3 * np.abs(ledgers[-1].work).max()
    for one in ledgers:  # impulses of the world are counted as they are given, at any step
        assert np.abs(one.linear_momentum_error).max() < 1e-13
        assert np.abs(one.angular_momentum_error).max() < 1e-13


# Momenta ------------------------------------------------------------------------------------------


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("forces", "method"), [(smooth, "strang"), (smooth, "rkn6"), (damped, "strang")]
)
def test_total_momenta_stay_without_a_force_from_outside(make, forces, method):
    """Also with dashpots between the bodies, off the origin and on the way."""
    bodies = blocks(away=(3.0, -2.0, 1.0))
    for body in bodies:
        body["velocity"] = np.add(body["velocity"], [0.5, 0.2, -0.1]).tolist()
    keys = forces(make, NOTHING)
    if forces is damped:
        keys["force"] = [*ties(make, damping=0.1), *keys["force"][len(ties(make)) :]]
    keys |= {"t_end": 20.0, "every": 1.0, "method": method, "dt": 0.05}
    found = make.arrays(make.case(*bodies, **keys))
    p, L = found.linear_momentum, found.angular_momentum
    total = p.sum(axis=1)
    spin = (np.cross(found.position, p) + L).sum(axis=1)
    assert np.abs(total - total[0]).max() < 1e-12 * np.linalg.norm(p[0], axis=1).sum()
    orbits = np.linalg.norm(np.cross(found.position[0], p[0]), axis=1).sum()
    assert np.abs(spin - spin[0]).max() < 1e-12 * (orbits + np.linalg.norm(L[0], axis=1).sum())
    assert np.ptp(L, axis=0).max() > 0.1  # while they do exchange it


# Groups -------------------------------------------------------------------------------------------


def two_of(make, names, **keys):
    """Bodies with these names, each of the kind that its name starts with, and ties in a row."""
    bodies = blocks([name.rstrip("0123456789") for name in names], names=names)
    ends = {"stone": [0.2, -0.1, 0.3], "disc": [0.1, 0.2, 0.05], "rod": [0, 0, 0.4]}
    at = [ends.get(name.rstrip("0123456789"), [0, 0, 0]) for name in names]
    row = range(len(names) - 1)
    force = [
        make.tie(names[k + 1], 3.0, names[k], at=at[k], to_at=at[k + 1], rest_length=1.0)
        for k in row
    ]
    return bodies, force


KEYS = {"t_end": 2.0, "every": 0.1, "dt": 0.02}


def bits(found, which=slice(None)):
    """What was recorded of these bodies; quaternions as ±, as their sign goes on between frames."""
    q = found.orientation[:, which]
    largest = np.take_along_axis(q, np.abs(q).argmax(axis=2)[:, :, None], axis=2)
    names = ("position", "linear_momentum", "angular_momentum")
    return [q * np.sign(largest), *(getattr(found, name)[:, which] for name in names)]


def same(a, b):
    return all(np.array_equal(one, other) for one, other in zip(a, b, strict=True))


@pytest.mark.compiled
def test_clusters_that_do_not_touch_and_free_bodies_move_as_alone(make):
    one, springs = two_of(make, ["stone1", "disc1", "point1"])
    other, more = two_of(make, ["rod2", "ball2"])
    free = blocks(["stone"], names=["free"])
    together = make.arrays(make.case(*one, *free, *other, force=springs + more, **KEYS))
    for bodies, force, which in ((one, springs, [0, 1, 2]), (other, more, [4, 5]), (free, [], [3])):
        alone = make.arrays(make.case(*bodies, force=force, **KEYS))
        assert same(bits(together, which), bits(alone))
    lines = together.plan.splitlines()
    assert sum("coupled by" in line for line in lines) == 2
    assert sum("free, closed form" in line for line in lines) == 1


@pytest.mark.compiled
def test_copies_of_a_cluster_share_a_group_and_move_alike(make):
    bodies, force = two_of(make, ["stone", "disc"])
    alone = make.arrays(make.case(*bodies, force=force, **KEYS))
    many = [body | {"count": 3, "position": [body["position"]] * 3} for body in bodies]
    found = make.arrays(make.case(*many, force=force, **KEYS))
    for k in range(3):
        for one, other in zip(bits(alone), bits(found, [k, 3 + k]), strict=True):
            assert other == pytest.approx(one, abs=1e-13)
    assert found.plan.count("coupled by 3 springs") == 1
    # half of them elsewhere, and turned there as they were
    away = [np.add(body["position"], [[0, 0, 0], [5, 1, 2]]).tolist() for body in bodies]
    pairs = [b | {"count": 2, "position": rows} for b, rows in zip(bodies, away, strict=True)]
    found = make.arrays(make.case(*pairs, force=force, **KEYS))
    apart = found.position[:, [1, 3]] - found.position[:, [0, 2]]
    assert apart == pytest.approx(np.tile([5.0, 1.0, 2.0], (21, 2, 1)), abs=1e-13)


@pytest.mark.plain
def test_only_the_bodies_of_attraction_attract_each_other(make):
    """A body that is tied to one of them, but not named with them, neither pulls nor is pulled."""
    bodies, force = two_of(make, ["rod", "ball", "point"])
    force = [force[1] | {"stiffness": NOTHING}]  # ball to point
    keys = KEYS | {"attraction": {"G": 1.0, "body": ["rod", "ball"]}}
    found = make.arrays(make.case(*bodies, force=force, **keys))
    pair = make.arrays(make.case(*bodies[:2], **keys))
    assert found.position[:, :2] == pytest.approx(pair.position, abs=1e-13)
    assert np.abs(pair.linear_momentum[-1] - pair.linear_momentum[0]).max() > 0.1
    assert found.linear_momentum[:, 2] == pytest.approx(
        np.tile(found.linear_momentum[0, 2], (21, 1)), abs=1e-14
    )


@pytest.mark.compiled
def test_the_numbers_of_bodies_and_springs_change_nothing_beyond_rounding(make):
    case = make.case(*blocks(), **smooth(make), t_end=T_END, every=T_END / 4, dt=0.02)
    for method in SMOOTH_METHODS:
        one = make.arrays(case, f"run.method={method}")
        turned = case | {"body": case["body"][::-1], "force": case["force"][::-1]}
        other = make.arrays(turned, f"run.method={method}")
        for a, b in zip(bits(one), bits(other, slice(None, None, -1)), strict=True):
            assert b == pytest.approx(a, abs=1e-13)


# Frames and segments ------------------------------------------------------------------------------


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("forces", "method"),
    [(smooth, "strang"), (smooth, "rkn6"), (damped, "strang"), (damped, "rk4")],
)
def test_frames_and_the_end_never_change_the_motion(make, forces, method):
    """To the bit: the partial step to a frame is made from a copy."""
    case = make.case(*blocks(), **forces(make), t_end=1.11, every=0.1, dt=0.013, method=method)
    often = make.arrays(case, "run.every=0.037")
    seldom = make.arrays(case, "run.every=1.11")
    longer = make.arrays(case, "run.t_end=1.48", "run.every=0.37")
    for a, b, c in zip(*(bits(one) for one in (often, seldom, longer)), strict=True):
        assert np.array_equal(a[-1], b[-1])
        assert np.array_equal(a[30], c[3])
        assert np.array_equal(a[10], c[1])


@pytest.mark.compiled
@pytest.mark.parametrize("method", SMOOTH_METHODS)
def test_springs_that_come_and_go_count_the_energy_that_they_are_connected_with(make, method):
    """Momenta stay; energy changes by what whoever connects a stretched spring gives."""
    bodies, force = two_of(make, ["stone1", "disc1"])
    force = [force[0], force[0] | {"stiffness": 5.0, "rest_length": 0.3, "during": [0.33, 1.27]}]
    keys = {"t_end": 2.0, "every": 0.05, "method": method}
    found = [make.arrays(make.case(*bodies, force=force, dt=dt, **keys)) for dt in (0.04, 0.02)]
    drift = [np.abs(one.ledger.energy_error).max() for one in found]
    assert drift[0] / drift[1] == pytest.approx(2.0 ** METHODS[method].order, rel=0.3)
    given = found[1].ledger.work
    during = (found[1].time > 0.33) & (found[1].time < 1.27)
    before, after = found[1].time < 0.33, found[1].time > 1.27
    assert not given[before].any()
    assert np.ptp(given[during]) == 0.0
    assert np.ptp(given[after]) == 0.0
    assert given[during][0] > 0.1
    # the spring of 5 N/m, by hand, where the whole energy jumps
    ends = [
        found[1].position[:, b] + make.rotation(found[1].orientation[:, b]).apply(force[1][key])
        for b, key in ((0, "at"), (1, "to_at"))
    ]
    stored = 2.5 * (np.linalg.norm(ends[1] - ends[0], axis=1) - 0.3) ** 2
    near = np.flatnonzero(before)[-1]
    assert given[during][0] == pytest.approx(stored[near : near + 2].mean(), rel=0.05)
    assert np.abs(found[1].ledger.angular_momentum_error).max() < 1e-13


@pytest.mark.compiled
def test_an_impulse_on_one_of_a_cluster_is_counted_and_felt_by_the_others(make):
    bodies, force = two_of(make, ["stone1", "disc1", "point1"])
    hit = make.impulse([0.7, -0.2, 0.4], [0.3, 0.1, 0.2], 0.5, "disc1")
    keys = {"t_end": 1.0, "every": 0.25, "dt": 0.01}
    plain = make.arrays(make.case(*bodies, force=force, **keys))
    found = make.arrays(make.case(*bodies, force=[*force, hit], **keys))
    assert np.array_equal(found.position[:2], plain.position[:2])
    jump = found.linear_momentum[2] - plain.linear_momentum[2]
    assert jump == pytest.approx(np.array([[0, 0, 0], [0.7, -0.2, 0.4], [0, 0, 0]]), abs=1e-14)
    arm = make.rotation(plain.orientation[2, 1]).apply([0.3, 0.1, 0.2])
    turned = found.angular_momentum[2] - plain.angular_momentum[2]
    assert turned[1] == pytest.approx(np.cross(arm, [0.7, -0.2, 0.4]), abs=1e-14)
    assert not turned[[0, 2]].any()
    assert np.abs(found.position[4] - plain.position[4]).max(axis=1).min() > 1e-3
    assert np.abs(found.ledger.linear_momentum_error).max() < 1e-14
    assert np.abs(found.ledger.angular_momentum_error).max() < 1e-14
    assert np.abs(found.ledger.energy_error).max() < 1e-3


# Threads ------------------------------------------------------------------------------------------


def spread(monkeypatch):
    """Take the path of large scenes, from Python and over threads."""
    monkeypatch.setattr(pair_forces, "WORTH_THREADS", 0.0)


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("forces", "method"),
    [(smooth, "strang"), (smooth, "rkn6"), (damped, "strang"), (damped, "dop853")],
)
def test_the_loop_from_python_gives_the_bits_of_the_compiled_one(make, monkeypatch, forces, method):
    keys = {"t_end": 0.5, "every": 0.11, "dt": 0.02, "method": method}
    case = make.case(*blocks(), **forces(make), **keys)
    whole = make.arrays(case)
    spread(monkeypatch)
    assert same(bits(whole), bits(make.arrays(case)))


@pytest.mark.compiled
@pytest.mark.parametrize("method", ["strang", "rkn6"])
def test_a_large_scene_has_the_same_bits_with_one_thread_as_with_two(make, method):
    rock = {"type": "cloud", "n": 25, "radius": 0.3}
    body = {"name": "rock", "shape": rock, "mass": 1.0, "count": 64, "orientation": "random"}
    body |= {"place": {"type": "grid", "spacing": 1.5}, "angular_velocity": {"random": 0.5}}
    keys = {"t_end": 0.3, "every": 0.1, "dt": 0.1, "method": method, "attraction": {"G": 0.1}}
    case = make.case(body, **keys)
    one, two = (make.arrays(case, f"run.threads={n}") for n in (1, 2))
    assert same(bits(one), bits(two))
    group = prepare(to_system(case)).plan.groups[0]
    assert PairForces(group.segments[0].terms, 64, False).is_large


# More than one block ------------------------------------------------------------------------------


def chain(make, n):
    """A chain of stones and discs in turn, with springs between their ends, and its case."""
    rng = np.random.default_rng(3)
    bodies, force = [], []
    for k in range(n):
        kind = ("stone", "disc")[k % 2]
        position, mass = KINDS[kind]
        shape = {"type": "points", "position": position.tolist(), "mass": mass.tolist()}
        q = rng.standard_normal(4)
        body = {"name": f"b{k}", "shape": shape, "orientation": (q / np.linalg.norm(q)).tolist()}
        body |= {"position": [1.2 * k, 0.3 * np.sin(k), 0.2 * np.cos(2 * k)]}
        body |= {"velocity": (0.2 * rng.standard_normal(3)).tolist()}
        bodies.append(body | {"angular_velocity": (0.5 * rng.standard_normal(3)).tolist()})
        if k:
            keys = {"at": [0.3, 0, 0], "to_at": [-0.2, 0.1, 0], "rest_length": 0.6}
            force.append(make.tie(f"b{k}", 4.0, f"b{k - 1}", **keys))
    return make.case(*bodies, force=force, t_end=0.5, every=0.5)


@pytest.mark.compiled
@pytest.mark.parametrize(("method", "dt"), [("strang", 2e-3), ("rkn6", 0.05)])
def test_a_chain_of_more_than_a_block_moves_as_the_equations_say(make, method, dt):
    """300 asymmetric bodies and 300 with an axis: five blocks with rkn6, which keeps them apart."""
    case = chain(make, 600)
    found = make.arrays(case, f"run.method={method}", f"run.dt={dt}")
    anew = Together(make, case)
    wrong = errors(anew, found, anew.run(0.5, 1e-9))
    assert wrong.max() < {"strang": 1e-5, "rkn6": 1e-8}[method]
    p = found.linear_momentum
    assert np.abs(np.diff(p.sum(axis=1), axis=0)).max() < 1e-12 * np.abs(p[0]).sum()


# Studies ------------------------------------------------------------------------------------------

RATE = 0.574890307983316  # [rad/s] of the dumbbells of cases/dumbbell_pair.toml, as one rigid body
SHAPE = {"type": "points", "position": [[-0.4, 0, 0], [0.4, 0, 0]], "mass": [0.5, 0.5]}
DUMBBELLS = [
    {
        "name": name,
        "shape": SHAPE,
        "position": [x, 0, 0],
        "velocity": [0, RATE * x, 0],
        "angular_velocity": [0, 0, RATE],
    }
    for name, x in (("left", -1.0), ("right", 1.0))
]
PAIR = {"attraction": {"G": 1.0}, "t_end": 20.0, "every": 20.0}
TURNED = np.array([np.cos(20 * RATE), np.sin(20 * RATE), 0.0])  # the x axis at t_end


@pytest.mark.compiled
@pytest.mark.parametrize("wanted", [1e-4, 1e-9])
def test_accuracy_is_met_by_bodies_that_attract_each_other(make, wanted):
    found = make.arrays(make.case(*DUMBBELLS, **PAIR, accuracy=wanted))
    assert np.abs(found.position[-1, 1] - TURNED).max() < wanted
    axis = make.rotation(found.orientation[-1, 1]).apply([1, 0, 0])
    assert np.abs(axis - TURNED).max() < wanted


@pytest.mark.compiled
def test_a_chart_of_bodies_that_attract_each_other_says_what_runs_by_hand_give(make):
    case = make.case(*DUMBBELLS, **PAIR)
    drawn = chart(to_system(case), ("strang", "rkn6"), budget=1.0)
    points = [p for p in drawn.points if p.step and not p.failure]
    assert {p.method for p in points} == {"strang", "rkn6"}
    for p in points[::4]:
        by_hand = make.arrays(case, f"run.method={p.method}", f"run.dt={p.step!r}")
        axes = make.rotation(by_hand.orientation[-1]).apply([1, 0, 0])
        error = np.linalg.norm(axes - TURNED, axis=1).max()
        assert p.error.worst == pytest.approx(error, rel=0.01, abs=1e-11)


@pytest.mark.compiled
@pytest.mark.parametrize("wanted", [1e-4, 1e-8])
def test_accuracy_is_met_by_bodies_on_springs(make, wanted):
    bodies, force = two_of(make, ["stone1", "disc1", "point1"])
    case = make.case(*bodies, force=force, t_end=5.0, every=5.0, accuracy=wanted)
    anew = Together(make, case)
    found = make.arrays(case)
    assert errors(anew, found, anew.run(5.0))[0] < wanted


@pytest.mark.plain
@pytest.mark.parametrize("scene", ["springs", "contact"])
def test_blocks_have_no_rows_that_nobody_uses(scene):
    """A body takes 1.2 kB: pages of memory are large, and rows between others are theirs too."""
    body = {"name": "a", "count": 2, "shape": {"type": "ball", "radius": 0.1}, "mass": 1.0}
    body["place"] = {"type": "grid", "spacing": 1.0, "n": [2, 1, 1]}
    case = {"run": {"t_end": 1.0, "every": 1.0, "dt": 0.01, "method": "strang"}, "body": [body]}
    ends = {"body": "a[0]", "to": "a[1]", "stiffness": 1.0, "rest_length": 1.0}
    contact = {"stiffness": 1e3, "restitution": 0.5, "friction": 0.5}
    case |= {"contact": contact} if scene == "contact" else {"force": [{"type": "spring", **ends}]}
    prepared = prepare(to_system(case))
    (group,) = prepared.plan.groups
    segment = group.segments[0]
    at = group.group(segment), prepared.system.state, 0.0, segment.dt
    bodies = SteppedBodies(METHODS["strang"], *at, None)
    rows = bodies.blocks.shape[1] // STRIDE
    assert MANY <= rows < 160
