"""Springs without length in closed form, with drag, with damping on a line, between two bodies."""

import math

import mpmath
import numpy as np
import pytest

import particlerb
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.plan.make_plan import make_plan
from particlerb.stepping.damped_oscillators import oscillation


@pytest.fixture(autouse=True)
def digits():
    """References have 60 digits, whatever other tests ask for."""
    with mpmath.workdps(60):
        yield


def after(rate, squared, t):
    """S, V, ∫ S, ∫ e^{-2γt}, ∫ S², ∫ V² by exponentials of complex numbers."""
    gamma, squared, t = (mpmath.mpf(v) for v in (rate / 2, squared, t))
    kappa = mpmath.sqrt(mpmath.mpc(gamma * gamma - squared)) or mpmath.mpf(10) ** -25
    a, b = gamma - kappa, gamma + kappa
    fall = [mpmath.exp(-r * t) for r in (a, b)]

    def grown(r):
        return t if r == 0 else (1 - mpmath.exp(-r * t)) / r

    found = (
        (fall[0] - fall[1]) / (2 * kappa),
        (b * fall[1] - a * fall[0]) / (2 * kappa),
        (grown(a) - grown(b)) / (2 * kappa),
        grown(2 * gamma),
        (grown(2 * a) - 2 * grown(a + b) + grown(2 * b)) / (4 * kappa**2),
        (b * b * grown(2 * b) - 2 * a * b * grown(a + b) + a * a * grown(2 * a)) / (4 * kappa**2),
    )
    return [mpmath.re(v) for v in found]


@pytest.mark.plain
def test_what_follows_from_the_equation_of_motion_is_exact_on_both_sides_of_critical_damping():
    """Over decades of time, of stiffness, and of the distance from critical damping."""
    random, more = np.random.default_rng(3), 1 + mpmath.mpf(2) ** -53
    for _ in range(600):
        squared = 10.0 ** random.uniform(-6, 6)
        w = math.sqrt(squared)
        near = 1.0 + random.choice([-1, 1]) * 10.0 ** random.uniform(-16, -0.5)
        rate = 2.0 * w * random.choice([near, 10.0 ** random.uniform(-8, 5), 1.0, 0.0])
        t = 10.0 ** random.uniform(-5, 2.3) / w
        exact, found = after(rate, squared, t), oscillation(rate, squared, t)
        moved = after(rate * more, squared * more, t)
        size = [1 / w, 1.0, 1 / squared, t, t / squared, t]  # of what swings, where it is small
        decay = float(mpmath.exp(-min(rate / 2, w) * t))
        for k, (one, of, other) in enumerate(zip(found, exact, moved, strict=True)):
            scale = max(abs(of), size[k] * (decay if k < 2 else 0.0) * (rate < 2 * w))
            scale = max(scale, 1e-3 / squared) if k == 2 and w * t > 1.0 else scale
            assert abs(one - of) <= max(1e-13 * scale, 100 * abs(other - of)), (k, rate, squared, t)


DAMPED = {  # stiffness, damping, place along the line, velocity along it
    "light": (8.0, 0.3, 0.4, 1.0),
    "critical": (8.0, 8.0, 0.4, -3.0),
    "nearly critical": (8.0, 8.0 * (1 + 1e-9), 0.4, 1.0),
    "strong": (8.0, 5000.0, 0.4, 1.0),
    "hardly any": (8.0, 1e-9, 0.0, 1.0),
    "from rest": (8.0, 2.0, 0.0, 0.0),
}


def moved_on(k, c, mass, pull, x, v, t):
    """Place and velocity after t, 40 digits, by a matrix exponential; and c ∫ v² dt."""
    with mpmath.workdps(40):
        k, c, mass, pull = (mpmath.mpf(one) for one in (k, c, mass, pull))
        rates = mpmath.matrix([[0, 1, 0], [-k / mass, -c / mass, pull / mass], [0, 0, 0]])
        y = mpmath.expm(rates * mpmath.mpf(t), method="taylor") * mpmath.matrix([x, v, 1])
        first = mass * mpmath.mpf(v) ** 2 / 2 + k * mpmath.mpf(x) ** 2 / 2 - pull * x
        last = mass * y[1] ** 2 / 2 + k * y[0] ** 2 / 2 - pull * y[0]
        return y[0], y[1], first - last


@pytest.mark.plain
@pytest.mark.parametrize("name", DAMPED)
def test_a_damped_spring_on_a_line(make, name):
    """Through the anchor, on the diagonal of the x y plane, with a push along it."""
    k, c, x, v = DAMPED[name]
    spring = make.spring([1.0, 1.0, 2.0], k, damping=c)
    body = make.body(position=[1.0 + x, 1.0 + x, 2.0], velocity=[v, v, 0.0],
                     angular_velocity=[0.3, -0.4, 1.0])  # fmt: skip
    scene = make.case(body, force=[spring, make.push([3.0, 3.0, 0.0])], t_end=5.0, every=2.5)
    found = make.arrays(scene)
    assert "damped along the line of the motion" in found.plan
    place, speed, lost = moved_on(k, c, 2.0, 3.0, float(body["position"][0] - 1.0), v, 5.0)
    assert np.abs(found.position[-1, 0] - [1 + place, 1 + place, 2.0]).max() < 1e-12
    assert np.abs(found.velocity[-1, 0] - [speed, speed, 0.0]).max() < 1e-12
    pushed = 6.0 * (place - x)
    assert abs(found.ledger.work[-1] - (pushed - 2 * lost)) < 1e-12
    for error in ("energy_error", "linear_momentum_error", "angular_momentum_error"):
        assert np.abs(getattr(found.ledger, error)).max() < 2e-13


def method_of(scene):
    """Methods of the segments of each group."""
    groups = make_plan(to_system(load(scene))).groups
    return [[segment.method for segment in group.segments] for group in groups]


def test_damping_off_a_line_is_stepped(make):
    """By a velocity, a force or an anchor aside, a length, a point off the centre of mass."""

    def of(velocity=(0, 0, 1.0), force=(0, 0, 1.0), **keys):
        spring = make.spring([0.0, 0.0, 1.0], 5.0, damping=1.0) | keys
        body = make.body(velocity=list(velocity))
        return make.case(body, force=[spring, make.push(list(force))])

    assert method_of(of()) == [["exact"]]
    for other in ({"velocity": (1e-17, 0, 1)}, {"force": (0, 1e-17, 1)}, {"rest_length": 0.1},
                  {"anchor": [1e-17, 0.0, 1.0]}, {"at": [0.0, 0.0, 0.1]}):  # fmt: skip
        assert method_of(of(**other)) == [["strang"]]


def pair(
    make, c, ends=([0.1, 0.2, 0.3], [1.1, 0.2, 0.3]), v=([0.0, 0.5, 0.1], [0.7, 0.5, 0.1]), t=4.0
):
    """Two tumbling bodies on a spring, in gravity."""
    bodies = [
        make.body(name, inertia, position=list(x), velocity=list(u), mass=m,
                  angular_velocity=[0.3, -0.4, 1.0])
        for name, inertia, m, x, u in zip("ab", ((1.0, 1.2, 0.6), (1, 1, 1)), (3.0, 1.0), ends, v,
                                          strict=True)
    ]  # fmt: skip
    spring = make.tie("b", 6.0, "a") | ({"damping": c} if c else {})
    return make.case(*bodies, force=[spring], gravity={"acceleration": [0.1, 0.0, -9.8]}, t_end=t,
                     every=t / 4)  # fmt: skip


@pytest.mark.parametrize(
    "c", [0.4, *(pytest.param(c, marks=pytest.mark.plain) for c in (0.0, 2 * math.sqrt(4.5), 40.0))]
)
def test_two_bodies_on_a_spring_oscillate_about_a_parabola(make, c):
    scene = pair(make, c)
    found = make.arrays(scene)
    assert "pairs on springs without length" in found.plan
    mass, t = np.array([3.0, 1.0]), mpmath.mpf(4)
    x, v = (np.array([body[key] for body in scene["body"]]) for key in ("position", "velocity"))
    apart, speed = x[0] - x[1], v[0] - v[1]
    for i, g in enumerate((0.1, 0.0, -9.8)):
        y, u, _ = moved_on(6.0, c, 0.75, 0.0, apart[i], speed[i], 4.0)
        middle = mpmath.fdot(mass, x[:, i]) / 4 + mpmath.fdot(mass, v[:, i]) / 4 * t
        middle += mpmath.mpf(g) * t * t / 2
        drift = mpmath.fdot(mass, v[:, i]) / 4 + mpmath.mpf(g) * t
        for b, share in enumerate((mpmath.mpf(1) / 4, -mpmath.mpf(3) / 4)):
            scale = max(1.0, abs(float(middle)))
            assert abs(found.position[-1, b, i] - (middle + share * y)) < 1e-12 * scale
            assert abs(found.velocity[-1, b, i] - (drift + share * u)) < 1e-12 * scale
    _, _, lost = moved_on(6.0, c, 0.75, 0.0, apart[0], speed[0], 4.0)
    assert abs(found.ledger.work[-1] + lost) < 1e-13
    for error in ("energy_error", "linear_momentum_error", "angular_momentum_error"):
        assert np.abs(getattr(found.ledger, error)).max() < 2e-12


@pytest.mark.plain
def test_many_pairs_are_each_as_if_alone(make):
    """A spring from each of some bodies to one of others; a push on one of them, and all step."""
    random = np.random.default_rng(2)
    n = 150
    blocks = [
        make.body(name, (1.0, 1.2, 0.6), count=n, mass=m) | {
            "position": random.normal(size=(n, 3)).tolist(),
            "velocity": random.normal(size=(n, 3)).tolist(),
        }
        for name, m in (("a", 3.0), ("b", 1.0))
    ]  # fmt: skip
    scene = make.case(*blocks, force=[make.tie("b", 6.0, "a")], t_end=2.0, every=1.0)
    assert method_of(scene) == [["exact"]]
    found = make.arrays(scene)
    for b in (0, 77, 149):
        ends, v = ([block[key][b] for block in blocks] for key in ("position", "velocity"))
        alone = pair(make, 0.0, ends, v, 2.0)
        alone.pop("gravity")
        with particlerb.run(alone) as one:
            assert found.position[-1, [b, n + b]] == pytest.approx(one.position[-1], abs=1e-13)
    assert np.abs(found.ledger.energy_error).max() < 1e-13 * found.ledger.kinetic_energy.max()
    pushed = scene | {"force": [*scene["force"], make.push([0, 0, 1.0], body="a[3]")]}
    assert {method for own in method_of(pushed) for method in own} == {"exact", "strang"}


def test_a_pair_off_its_line_is_stepped_where_it_is_damped(make):
    askew = [0.7, 0.5 + 1e-15, 0.1]
    assert method_of(pair(make, 0.4)) == [["exact"]]
    assert method_of(pair(make, 0.4, v=([0.0, 0.5, 0.1], askew))) == [["strang"]]
    assert method_of(pair(make, 0.0, v=([0.0, 0.5, 0.1], askew))) == [["exact"]]
    three = pair(make, 0.0)
    three["body"].append(make.body("c", position=[3, 0, 0]))
    three["force"].append(make.tie("c", 1.0, "a"))
    assert method_of(three) == [["strang"]]


@pytest.mark.plain
def test_bodies_that_other_springs_have_moved_off_their_line_are_stepped(make):
    """First they are a pair, then each is on a damped spring of its own."""
    a = make.body("a", position=[1.0, 0.0, 0.0], velocity=[0.5, 0.0, 0.0])
    b = make.body("b", position=[0.0, 1.0, 0.0], velocity=[0.0, -0.3, 0.0])
    tie = make.tie("b", 6.0, "a", during=[0.0, 1.0])
    end = {"damping": 1.5, "during": [1.0, 3.0], "anchor": [0.0, 0.0, 0.0]}
    own = [make.tie(None, 5.0, name, **end) for name in "ab"]
    scene = make.case(a, b, force=[tie, *own], t_end=3.0, every=0.5)
    found = make.arrays(scene)
    scene["run"] |= {"method": "dop853", "tolerance": 1e-12}
    assert np.abs(found.position - make.arrays(scene).position).max() < 5e-3


@pytest.mark.plain
def test_what_soft_springs_book_is_no_difference_of_large_numbers(make):
    """The place of balance is 2e7 m away."""
    body = make.body(position=[0.5, -0.3, 0.2], velocity=[1.0, 2.0, -0.5])
    force = [make.tie(None, 1e-6, anchor=[0.0, 0.0, 0.0])]
    scene = make.case(body, force=force, gravity={"acceleration": [3.0, 1.0, -9.0]}, t_end=2.0)
    found = make.arrays(scene)
    assert "an oscillator" in found.plan
    assert np.abs(found.ledger.angular_momentum_error).max() < 1e-12
