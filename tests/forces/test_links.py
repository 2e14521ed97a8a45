"""Springs and dashpots between points of bodies: loads, flows, bounds, closed forms of motions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import particlerb
from particlerb.case.problems import CaseError
from particlerb.cli import main
from particlerb.forces.links import WORLD, Links, damp_links, link_energy, link_loads, link_rates
from particlerb.model.load import FORCE, LOAD_ROWS, OUTSIDE, POWER, TORQUE

N = 4
FIRST, SECOND = np.array([0, 1, 2, 3, 0, 2]), np.array([1, 2, 3, WORLD, 2, WORLD])
seeds = st.integers(0, 2**32 - 1)


def turned(q, r):
    """Vectors (3, s) turned by quaternions (4, s) with the scalar first."""
    return Rotation.from_quat(q.T, scalar_first=True).apply(r.T).T


def scene(seed, damping=True, rest=None):
    """Four bodies, four links among them and two to the world; the state y (13, 4)."""
    rng = np.random.default_rng(seed)
    y = rng.standard_normal((13, N))
    y[:3] *= 2.0
    y[3:7] /= np.linalg.norm(y[3:7], axis=0)
    at, to = 0.4 * rng.standard_normal((2, 3, FIRST.size))
    to[:, SECOND == WORLD] += 3.0
    values = rng.uniform(0.5, 2.0, (3, FIRST.size))
    inv_mass, inv_inertia = rng.uniform(0.5, 2.0, N), rng.uniform(0.5, 4.0, (3, N))
    inv_inertia[2, 0], inv_inertia[:, 1] = 0.0, 0.0  # a rod, and a point
    at[:2, FIRST == 0], to[:2, SECOND == 0] = 0.0, 0.0
    at[:, FIRST == 1], to[:, SECOND == 1] = 0.0, 0.0
    y[10:, 1] = 0.0
    dashpots = values[2] if damping else None
    links = Links(FIRST, SECOND, at, to, values[0], values[1], dashpots, inv_mass, inv_inertia)
    return (links if rest is None else links._replace(rest_length=rest(links, y))), y


def ends(links, y):
    """Both points of each link and their velocities, (3, s) each, and the arms."""
    found = []
    for body, at in ((links.body_a, links.at_a), (links.body_b, links.at_b)):
        q, L = y[3:7, body], y[10:, body]
        inverse = np.array([1.0, -1.0, -1.0, -1.0])[:, None] * q
        w = turned(q, links.inv_inertia[:, body] * turned(inverse, L))
        arm = turned(q, at)
        velocity = links.inv_mass[body] * y[7:10, body] + np.cross(w.T, arm.T).T
        inside = body != WORLD
        point = np.where(inside, y[:3, body] + arm, at)
        found.append((point, np.where(inside, velocity, 0.0), np.where(inside, arm, 0.0)))
    return found


def lengths_of(links, y):
    """Length of each link [m], its direction, and the rate of its length [m/s]."""
    (a, va, _), (b, vb, _) = ends(links, y)
    length = np.linalg.norm(b - a, axis=0)
    n = (b - a) / length
    return length, n, (n * (vb - va)).sum(axis=0)


def energy_of(links, y):
    length, _, _ = lengths_of(links, y)
    return float((0.5 * links.stiffness * (length - links.rest_length) ** 2).sum())


def kinetic(links, y):
    q = y[3:7] * np.array([1.0, -1.0, -1.0, -1.0])[:, None]
    m = turned(q, y[10:])
    return (
        0.5
        * (
            links.inv_mass * (y[7:10] ** 2).sum(axis=0) + (links.inv_inertia * m * m).sum(axis=0)
        ).sum()
    )


def momenta(y):
    """Total momentum, and angular momentum about the origin."""
    return y[7:10].sum(axis=1), (np.cross(y[:3].T, y[7:10].T).T + y[10:]).sum(axis=1)


def loads(links, y, with_dashpots=True):
    load = np.zeros((LOAD_ROWS, N))
    link_loads(links, y, load, with_dashpots)
    return load


# Loads


@given(seeds)
def test_spring_loads_are_the_derivative_of_their_potential(seed):
    links, y = scene(seed, damping=False)
    assert link_energy(links, y[:3], y[3:7]) == pytest.approx(energy_of(links, y), rel=1e-13)
    load, step = loads(links, y), 1e-5
    found = np.zeros((6, N))
    for b in range(N):
        for c in range(3):
            u = np.zeros(3)
            u[c] = step
            pair = []
            for sign in (1, -1):
                moved = y.copy()
                moved[c, b] += sign * step
                turn = y.copy()
                own = Rotation.from_rotvec(sign * u) * Rotation.from_quat(
                    y[3:7, b], scalar_first=True
                )
                turn[3:7, b] = own.as_quat(scalar_first=True)
                pair.append((energy_of(links, moved), energy_of(links, turn)))
            found[c, b] = -(pair[0][0] - pair[1][0]) / (2 * step)
            found[3 + c, b] = -(pair[0][1] - pair[1][1]) / (2 * step)
    assert load[:6] == pytest.approx(found, abs=2e-8)
    assert not load[POWER].any()


@given(seeds)
def test_forces_between_bodies_are_opposite_and_in_one_line(seed):
    """What is left of forces and torques about the origin is what the world gives."""
    links, y = scene(seed)
    load = loads(links, y)
    F, tau = load[FORCE : FORCE + 3], load[TORQUE : TORQUE + 3]
    turning = np.cross(y[:3].T, F.T).T + tau
    scale = np.abs(load).sum()
    assert F.sum(axis=1) == pytest.approx(
        load[OUTSIDE : OUTSIDE + 3].sum(axis=1), abs=1e-14 * scale
    )
    outside = load[OUTSIDE + 3 : OUTSIDE + 6].sum(axis=1)
    assert turning.sum(axis=1) == pytest.approx(outside, abs=2e-14 * scale)


@given(seeds)
def test_a_dashpot_pulls_with_c_times_the_rate_of_its_length(seed):
    links, y = scene(seed)
    load = loads(links, y) - loads(links, y, with_dashpots=False)
    _, n, rate = lengths_of(links, y)
    expected = np.zeros((3, N))
    for s in range(FIRST.size):
        force = links.damping[s] * rate[s] * n[:, s]
        expected[:, FIRST[s]] += force
        if SECOND[s] != WORLD:
            expected[:, SECOND[s]] -= force
    assert load[:3] == pytest.approx(expected, abs=1e-12)
    assert load[POWER].sum() == pytest.approx(-(links.damping * rate**2).sum(), rel=1e-12)


def test_a_link_without_length_pulls_nothing():
    links, y = scene(3)
    at, to = links.at_a.copy(), links.at_b.copy()
    at[:, 3], to[:, 3] = 0.0, y[:3, 3]  # link 3 goes to the world
    stiffness = np.where(np.arange(6) == 3, 1.0, 1e-300)
    links = links._replace(at_a=at, at_b=to, stiffness=stiffness)
    load = loads(links._replace(damping=None), y)
    assert np.isfinite(load).all()
    assert np.abs(load).max() < 1e-15
    damp_links(links, y, np.zeros((LOAD_ROWS, N)), 0.5, False)
    assert np.isfinite(y).all()


# The flow of dashpots


@given(seeds, st.floats(1e-3, 10.0))
def test_the_flow_of_one_dashpot_lets_its_rate_decay_exactly(seed, dt):
    """v(h) = v e^{-c w h}, w = Σ 1/M + (r × n)·I⁻¹(r × n), here from what an impulse does to v."""
    links, y = scene(seed)
    for s in range(FIRST.size):
        damping = np.where(np.arange(FIRST.size) == s, links.damping, 0.0)
        one, now = links._replace(damping=damping), y.copy()
        external = np.zeros((LOAD_ROWS, N))
        _, n, before = lengths_of(links, y)
        hit = y.copy()
        arms = [end[2][:, s] for end in ends(links, y)]
        for b, sign, arm in ((FIRST[s], 1, arms[0]), (SECOND[s], -1, arms[1])):
            if b != WORLD:
                hit[7:10, b] += sign * n[:, s]
                hit[10:, b] += sign * np.cross(arm, n[:, s])
        w = before[s] - lengths_of(links, hit)[2][s]
        damp_links(one, now, external, dt, False)
        after = lengths_of(links, now)[2]
        assert after[s] == pytest.approx(before[s] * np.exp(-damping[s] * w * dt), abs=1e-12)
        work = kinetic(links, now) - kinetic(links, y)
        assert external[POWER].sum() == pytest.approx(work, abs=1e-12)
        given = [external[OUTSIDE + k : OUTSIDE + k + 3].sum(axis=1) for k in (0, 3)]
        for was, gave, has in zip(momenta(y), given, momenta(now), strict=True):
            assert was + gave == pytest.approx(has, abs=1e-12)


@given(seeds)
def test_dashpots_forwards_and_back_in_time_backwards_give_back_the_state(seed):
    links, y = scene(seed)
    now, external = y.copy(), np.zeros((LOAD_ROWS, N))
    damp_links(links, now, external, 0.1, False)
    assert np.abs(now - y).max() > 1e-3
    assert external[POWER].sum() < 0
    damp_links(links, now, external, -0.1, True)
    assert now == pytest.approx(y, abs=1e-12)
    assert external[POWER].sum() == pytest.approx(0, abs=1e-12)


# The bound of rates


@given(seeds)
def test_the_bound_of_rates_is_above_every_normal_mode_of_springs_at_rest(seed):
    links, y = scene(seed, damping=False, rest=lambda links, y: lengths_of(links, y)[0])
    _, n, _ = lengths_of(links, y)
    (_, _, first), (_, _, second) = ends(links, y)
    ways = np.zeros((FIRST.size, 6 * N))
    for s in range(FIRST.size):
        for b, sign, arm in ((FIRST[s], -1, first[:, s]), (SECOND[s], 1, second[:, s])):
            if b != WORLD:
                ways[s, 6 * b : 6 * b + 3] = sign * n[:, s]
                ways[s, 6 * b + 3 : 6 * b + 6] = sign * np.cross(arm, n[:, s])
    inverse = np.zeros((6 * N, 6 * N))
    for b in range(N):
        R = Rotation.from_quat(y[3:7, b], scalar_first=True).as_matrix()
        at = 6 * b
        inverse[at : at + 3, at : at + 3] = links.inv_mass[b] * np.eye(3)
        inverse[at + 3 : at + 6, at + 3 : at + 6] = R @ np.diag(links.inv_inertia[:, b]) @ R.T
    root = np.sqrt(links.stiffness)[:, None]
    fastest = np.sqrt(np.linalg.eigvalsh(root * (ways @ inverse @ ways.T) * root.T)[-1])
    bound = link_rates(links).max()
    assert fastest <= bound * (1 + 1e-12)
    assert bound < 5 * fastest  # and no step is much too short for it


def test_rates_of_two_bodies_on_a_spring_are_those_of_their_oscillation(make):
    links, _ = scene(0, damping=False)
    one = Links(
        FIRST[:1], SECOND[:1], np.zeros((3, 1)), np.zeros((3, 1)), np.array([3.0]),
        np.array([1.0]), None, links.inv_mass, links.inv_inertia,
    )  # fmt: skip
    rate = np.sqrt(3.0 * (links.inv_mass[0] + links.inv_mass[1]))
    assert link_rates(one) == pytest.approx([rate, rate, 0.0, 0.0], rel=1e-14)
    damped = one._replace(damping=np.array([100.0]))
    strong = 100.0 * (links.inv_mass[0] + links.inv_mass[1])
    assert link_rates(damped) == pytest.approx([strong, strong, 0.0, 0.0], rel=1e-14)


# Motions in closed form


def fitted_rate(t, length, guess):
    """Rate and amplitude of a length a + b cos ωt + c sin ωt, by Gauss and Newton."""
    rate = guess
    for _ in range(8):
        c, s = np.cos(rate * t), np.sin(rate * t)
        (_, b, d), *_ = np.linalg.lstsq(np.stack([1 + 0 * t, c, s], 1), length, rcond=None)
        slopes = np.stack([1 + 0 * t, c, s, t * (d * c - b * s)], 1)
        (*_, change), *_ = np.linalg.lstsq(slopes, length, rcond=None)
        rate += change
    return rate, np.hypot(b, d)


PAIRS = {
    "two asymmetric bodies, far off their centres": (
        "stone",
        "stone",
        [0.3, -0.2, 0.4],
        [-0.1, 0.5, 0.2],
    ),
    "asymmetric and symmetric": ("stone", "disc", [0.3, 0.4, -0.2], [0.4, 0.0, 0.3]),
    "a rod at its end and a point": ("rod", "point", [0.0, 0.0, 0.7], [0.0, 0.0, 0.0]),
    "a sphere and the world": ("ball", None, [0.2, 0.5, -0.1], [1.5, 0.7, 0.3]),
}
INERTIA = {
    "stone": [1.0, 2.0, 2.5], "disc": [0.4, 0.4, 0.7], "rod": [0.9, 0.9, 0.0],
    "point": [0.0, 0.0, 0.0], "ball": [0.5, 0.5, 0.5],
}  # fmt: skip


@pytest.mark.compiled
@pytest.mark.parametrize("kind", PAIRS)
def test_bodies_on_a_spring_oscillate_at_k_over_their_effective_mass(make, kind):
    """ω² = k/m_eff, 1/m_eff = Σ 1/M + (r × n)·I⁻¹(r × n), of the pose at t = 0.

    Stretched by a share of 1e-7, the bodies swing about a pose that is off by as much. rkn6 with 15
    steps a period is off by some 1e-7 of the rate, strang with 4000 by (2π/4000)²/24 = 1e-7.
    """
    one, other, at, to_at = PAIRS[kind]
    rng = np.random.default_rng(5)
    q = rng.standard_normal((2, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    R = [Rotation.from_quat(own, scalar_first=True).as_matrix() for own in q]
    x = np.array([[0.0, 0.0, 0.0], [1.8, 0.5, -0.4]])
    bodies = [make.body("one", INERTIA[one], orientation=q[0].tolist())]
    if other is not None:
        keys = {"position": x[1].tolist(), "orientation": q[1].tolist()}
        bodies.append(make.body("other", INERTIA[other], **keys))
    arms = [R[0] @ at, R[1] @ to_at]
    end = x[1] + arms[1] if other else np.array(to_at)
    length = np.linalg.norm(end - arms[0])
    n = (end - arms[0]) / length
    w = 0.0
    for k in range(len(bodies)):
        turning = R[k].T @ np.cross(arms[k], n)
        moments = np.array(INERTIA[(one, other)[k]])
        inverse = np.divide(1.0, moments, out=np.zeros(3), where=moments > 0)
        w += 1 / 2.0 + turning @ (inverse * turning)
    k, rest = 7.0, length * (1 - 1e-7)
    keys = {"at": list(at), "rest_length": rest, "stiffness": k, "body": "one"}
    tie = make.tie("other", **keys, to_at=to_at) if other else make.tie(**keys, anchor=to_at)
    if other is None:  # an anchored spring is a spring of its own: as a link it needs a dashpot
        tie |= {"damping": 1e-300}
    expected = np.sqrt(k * w)
    period = 2 * np.pi / expected
    run = {"t_end": 40 * period, "every": period / 7.3}
    run |= {"method": "rkn6", "dt": period / 15} if other else {"dt": period / 4000}
    found = make.arrays(make.case(*bodies, force=[tie], **run))
    points = [
        found.position[:, b] + make.rotation(found.orientation[:, b]).apply((at, to_at)[b])
        for b in range(len(bodies))
    ]
    way = (points[1] if other else end) - points[0]
    rate, size = fitted_rate(found.time, np.linalg.norm(way, axis=1), expected)
    assert rate == pytest.approx(expected, rel=5e-7)
    assert size == pytest.approx(1e-7 * length, rel=1e-3)


def test_two_points_on_a_dashpot_alone_come_to_rest_relative_to_each_other_exactly(make):
    """v(t) = v₀ e^{-c t/m_eff} and m_eff = M/2: the flow is exact on a line, whatever the step."""
    bodies = [
        make.body("one", [0, 0, 0], velocity=[0, 0, 3.0]),
        make.body("other", [0, 0, 0], position=[0, 0, 2.0], velocity=[0, 0, 4.0]),
    ]
    tie = make.tie("other", 1e-300, "one", damping=0.8)
    for dt in (0.5, 0.1):
        found = make.arrays(make.case(*bodies, force=[tie], t_end=2.0, every=0.25, dt=dt))
        apart = found.velocity[:, 1, 2] - found.velocity[:, 0, 2]
        assert apart == pytest.approx(np.exp(-0.8 * found.time), abs=1e-14)
        assert found.velocity.sum(axis=1)[:, 2] == pytest.approx(np.full(9, 7.0), abs=1e-14)
        work = found.ledger.work
        assert work == pytest.approx(found.ledger.kinetic_energy - 25.0, abs=1e-13)
    # the way is the drift of the mean: it has the error of a trapezoid, (v c)² dt²/12
    way = found.position[-1, 1, 2] - found.position[-1, 0, 2]
    assert way == pytest.approx(2.0 + (1 - np.exp(-1.6)) / 0.8, abs=1e-3)


def test_an_overdamped_pair_does_not_care_how_strong_its_dashpot_is(make):
    """An exact flow is stable where a load would explode: c dt/m_eff = 1000."""
    bodies = [make.body("one", velocity=[0, 1.0, 0]), make.body("other", position=[0, 2.0, 0])]
    tie = make.tie("other", 1.0, "one", damping=1e4, rest_length=2.0)
    found = make.arrays(make.case(*bodies, force=[tie], dt=0.1))
    assert found.velocity[1:, :, 1] == pytest.approx(np.full((10, 2), 0.5), abs=1e-3)
    assert np.abs(found.ledger.energy_error).max() < 1e-3


# What is refused


@pytest.mark.parametrize("end", [{"to": "other"}, {"anchor": [0, 0, 1]}])
def test_rkn6_refuses_dashpots(make, end):
    bodies = [make.body("one"), make.body("other", position=[3.0, 0, 0])]
    tie = {"type": "spring", "body": "one", "stiffness": 1.0, "damping": 0.1, **end}
    with pytest.raises(CaseError, match=r"run\.method: rkn6 does not accept .*dashpots"):
        particlerb.run(make.case(*bodies, force=[tie], method="rkn6"))


def test_rkn6_with_dashpots_ends_the_command_with_exit_code_2(tmp_path, capsys):
    tie = '[[force]]\ntype = "spring"\nbody = "b[0]"\nto = "b[1]"\nstiffness = 1.0\ndamping = 1.0\n'
    shape = '{ type = "moments", inertia = [1, 2, 2.5] }'
    rows = "count = 2\nposition = [[0, 0, 0], [3, 0, 0]]\n"
    body = f'[[body]]\nname = "b"\nshape = {shape}\nmass = 1\n{rows}'
    case = tmp_path / "damped.toml"
    case.write_text(f'[run]\nt_end = 1\nevery = 1\nmethod = "rkn6"\n{body}{tie}')
    assert main([str(case), "-o", str(tmp_path / "run.h5")]) == 2
    words = capsys.readouterr().err
    assert "rkn6 does not accept what acts here: dashpots" in words
    assert "methods that do: strang, dop853" in words
