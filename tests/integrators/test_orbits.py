"""Kepler's orbits and pairs in closed form, against classical elements with 60 digits."""

import mpmath
import numpy as np
import pytest

import particlerb
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.plan.make_plan import make_plan
from particlerb.simulation.whole_run import RunError


@pytest.fixture(autouse=True)
def digits():
    """References have 60 digits, whatever other tests ask for."""
    with mpmath.workdps(60):
        yield


CENTRE = (1.0, -2.0, 0.5)

ORBITS = {  # μ, place and velocity relative to the centre, t
    "circle": (1.0, (1, 0, 0), (0, 1, 0), 30.0),
    "nearly a circle": (1.0, (0.6, 0.8, 0), (-0.8, 0.6, 1e-9), 1000.0),
    "ellipse": (1.0, (1, 0, 0), (0.1, 0.7, 0.3), 30.0),
    "just seen from its start": (1.0, (1, 0, 0), (0.0, 1.11, 0.0), 30.0),
    "from its far end, e = 0.98": (1.0, (1, 0, 0), (0, 0.14, 0), 30.0),
    "e = 1 - 1e-12": (1.0, (1e-6, 0, 0), (0, 1414.2135623723879, 0), 2.0),
    "parabola": (2.0, (1, 0, 0), (0, 2, 0), 50.0),
    "parabola, inwards": (2.0, (1, 0, 0), (-1.2, 1.6, 0), 50.0),
    "next to a parabola": (2.0, (1, 0, 0), (-1.2, 1.6000000001, 0), 50.0),
    "hyperbola": (1.0, (1, 2, 0), (0.5, 1.0, -1.0), 100.0),
    "hyperbola, from afar and back": (1.0, (1000, 1, 0), (-1, 0, 0.0), 2000.0),
    "hardly bent": (1.3e-10, (-1, 1, 0), (0.1, 0, 0), 3.0),
    "hardly bent, for long": (1.3e-10, (-1, 1, 0), (0.1, 0, 0), 1e3),
    "hardly bent, not far": (1.3e-10, (-1, 1, 0), (0.1, 0, 0), 0.3),
    "earth": (3.986004418e14, (7e6, 0, 0), (0, 7000.0, 3500.0), 1e6),
    "nearly a fall": (1.0, (1, 0, 0), (0, 1e-5, 0), 1.0),
}


def root(f, slope, low, high):
    """Root of a growing function, by Newton's steps within a bracket."""
    at = (low + high) / 2
    for _ in range(300):
        value = f(at)
        low, high = (low, at) if value > 0 else (at, high)
        new = at - value / slope(at)
        new = new if low < new < high else (low + high) / 2
        if abs(new - at) <= abs(at) * mpmath.mpf(10) ** -50:
            return new
        at = new
    raise ValueError("no root")


def reference(mu, x, v, t):
    """Place and velocity after t by classical elements: e, and E, H or Barker's equation."""
    mu, t, x, v = mpmath.mpf(mu), mpmath.mpf(t), mpmath.matrix(x), mpmath.matrix(v)

    def dot(a, b):
        return mpmath.fsum(p * q for p, q in zip(a, b, strict=True))

    def cross(a, b):
        turned = [(1, 2), (2, 0), (0, 1)]
        return mpmath.matrix([a[i] * b[j] - a[j] * b[i] for i, j in turned])

    r, h = mpmath.sqrt(dot(x, x)), cross(x, v)
    e_vector = cross(v, h) / mu - x / r
    e, p = mpmath.sqrt(dot(e_vector, e_vector)), dot(h, h) / mu
    first = e_vector / e if e > 1e-30 else x / r
    second = cross(h, first) / mpmath.sqrt(dot(h, h))
    a, energy = dot(x, first), dot(v, v) / 2 - mu / r
    b = dot(x, second)
    if abs(energy) < mpmath.mpf(10) ** -30:
        D0, rate = b / mpmath.sqrt(p), mpmath.sqrt(mu)
        due = rate * t + (p * D0 + D0**3 / 3) / 2
        most = mpmath.cbrt(6 * abs(due))
        D = root(lambda D: (p * D + D**3 / 3) / 2 - due, lambda D: (p + D * D) / 2, -most, most)
        place = (p - D * D) / 2, mpmath.sqrt(p) * D
        rr = (p + D * D) / 2
        speed = -rate * D / rr, rate * mpmath.sqrt(p) / rr
    elif energy < 0:
        A = -mu / (2 * energy)
        B, n = A * mpmath.sqrt(1 - e * e), mpmath.sqrt(mu / A**3)
        E0 = mpmath.atan2(b / B, a / A + e)
        M = E0 - e * mpmath.sin(E0) + n * t
        E = root(lambda E: E - e * mpmath.sin(E) - M, lambda E: 1 - e * mpmath.cos(E), M - 1, M + 1)
        place = A * (mpmath.cos(E) - e), B * mpmath.sin(E)
        rate = n / (1 - e * mpmath.cos(E))
        speed = -A * mpmath.sin(E) * rate, B * mpmath.cos(E) * rate
    else:
        A = mu / (2 * energy)
        B, n = A * mpmath.sqrt(e * e - 1), mpmath.sqrt(mu / A**3)
        H0 = mpmath.asinh(b / B)
        M = e * mpmath.sinh(H0) - H0 + n * t
        most = mpmath.cbrt(6 * abs(M)) if e < 1.5 else abs(M) / (e - 1)
        f, slope = (lambda H: e * mpmath.sinh(H) - H - M), (lambda H: e * mpmath.cosh(H) - 1)
        H = root(f, slope, -most, most)
        place = A * (e - mpmath.cosh(H)), B * mpmath.sinh(H)
        rate = n / (e * mpmath.cosh(H) - 1)
        speed = -A * mpmath.sinh(H) * rate, B * mpmath.cosh(H) * rate
    end = [first * c + second * d for c, d in (place, speed)]
    return np.array([[float(one) for one in part] for part in end])


def half_an_ulp(mu, x, v, t):
    """How far the end moves if one number of the start does by half an ulp."""
    found, moved = reference(mu, x, v, t), np.zeros(2)
    start = [mpmath.mpf(one) for one in (*x, *v)]
    for k in range(6):
        other = list(start)
        other[k] += mpmath.mpf(float(np.spacing(float(start[k]) or 1e-300))) / 2
        end = reference(mu, other[:3], other[3:], t)
        moved = np.maximum(moved, np.abs(end - found).max(axis=1))
    return moved


def orbit(mu, x, v, t, centre=(0, 0, 0), **keys):
    """A point about a centre."""
    body = {"name": "moon", "shape": {"type": "points", "position": [[0, 0, 0]], "mass": [2.0]}}
    place = [a + b for a, b in zip(x, centre, strict=True)]
    force = {"type": "central", "body": "moon", "mu": mu, "centre": list(centre)}
    body |= {"position": place, "velocity": list(v)}
    return {"run": {"t_end": t, "every": t, **keys}, "body": [body], "force": [force]}


@pytest.mark.parametrize("name", ORBITS)
def test_orbits_are_as_exact_as_their_start(name):
    mu, x, v, t = ORBITS[name]
    with particlerb.run(orbit(mu, x, v, t)) as found:
        assert "Kepler's orbits" in found.parameter("plan")
        end = np.array([found.position[-1, 0], found.linear_momentum[-1, 0] / 2.0])
    expected, moved = reference(mu, x, v, t), half_an_ulp(mu, x, v, t)
    size = np.array([np.linalg.norm(part) for part in expected])
    off = np.abs(end - expected).max(axis=1)
    assert (off <= np.maximum(1e-12 * size, 100.0 * moved)).all(), (off / size, off / moved)


@pytest.mark.parametrize("speed", [1e-3, 1.0, 100.0])
def test_who_is_thrown_straight_up_stays_on_the_line_however_fast(speed):
    """From the unit sphere, along its radius, ten radii; v² = v₀² - 2μ (1 - 1/r)."""
    mu, up = 6.67e-11, np.array([0.37, 0.481, 0.79])
    up /= np.linalg.norm(up)
    case = orbit(mu, up.tolist(), (speed * up).tolist(), 10.0 / speed)
    with particlerb.run(case) as found:
        x, v = found.position[-1, 0], found.linear_momentum[-1, 0] / 2.0
    for vector in (x, v):
        assert np.linalg.norm(np.cross(up, vector)) < 1e-14 * np.linalg.norm(vector)
    left = np.sqrt(speed**2 - 2.0 * mu * (1.0 - 1.0 / (x @ up)))
    assert v @ up == pytest.approx(left, rel=1e-14)


def test_a_centre_away_from_the_origin_counts_what_it_gives():
    """A spinning sphere: energy, and angular momentum about the world's origin, balance."""
    scene = orbit(1.0, (1, 0, 0), (0.1, 0.7, 0.3), 30.0, CENTRE)
    scene["run"]["every"] = 3.0
    scene["body"][0] |= {
        "shape": {"type": "moments", "inertia": [0.4, 0.4, 0.4]},
        "mass": 2.0,
        "angular_velocity": [0.3, 0.1, 2.0],
    }
    with particlerb.run(scene) as found:
        assert "Kepler's orbits" in found.parameter("plan")
        assert found.angular_velocity[-1, 0] == pytest.approx([0.3, 0.1, 2.0], abs=1e-15)
        assert abs(found.ledger.energy_error).max() < 1e-13
        assert abs(found.ledger.angular_momentum_error).max() < 1e-12
        assert found.position[-1, 0] - CENTRE == pytest.approx(
            reference(1.0, (1, 0, 0), (0.1, 0.7, 0.3), 30.0)[0], abs=1e-12
        )


def test_two_bodies_that_attract_each_other_go_round_each_other_as_they_fall():
    mass, G, t = np.array([3.0, 1.0]), 0.5, 40.0
    x, v = np.array([[0.1, 0.0, 0.2], [1.1, 0.3, 0.0]]), np.array([[0, 0, 0.1], [0.2, 1.1, 0.0]])
    body = [
        {
            "name": name,
            "shape": {"type": "points", "position": [[0, 0, 0]], "mass": [m]},
            "position": list(place),
            "velocity": list(velocity),
        }
        for name, m, place, velocity in zip("ab", mass, x, v, strict=True)
    ]
    scene = {
        "run": {"t_end": t, "every": 4.0},
        "gravity": {"acceleration": [0.0, 0.0, -0.1]},
        "body": body,
        "attraction": {"G": G},
    }
    with particlerb.run(scene) as found:
        assert "Kepler's orbits" in found.parameter("plan")
        place, momentum = found.position[-1], found.linear_momentum[-1]
        assert abs(found.ledger.energy_error).max() < 1e-12
        assert abs(found.ledger.angular_momentum_error).max() < 1e-12
    apart = reference(G * mass.sum(), x[0] - x[1], v[0] - v[1], t)
    middle, drift = mass @ x / mass.sum(), mass @ v / mass.sum()
    fall = np.array([0.0, 0.0, -0.1])
    share = np.array([0.25, -0.75])[:, None]
    expected = middle + drift * t + 0.5 * fall * t * t + share * apart[0]
    assert place == pytest.approx(expected, abs=2e-12)
    assert momentum / mass[:, None] == pytest.approx(drift + fall * t + share * apart[1], abs=2e-12)


def test_a_fall_into_the_centre_ends_with_the_time_of_it():
    """From rest at the distance r it takes π √(r³/8μ)."""
    scene = orbit(2.0, (0.0, 0.0, 1.5), (0, 0, 0), 2.0)
    when = np.pi * np.sqrt(1.5**3 / 16.0)
    with pytest.raises(RunError, match=f"falls into what attracts it at t = {when:.6g} s"):
        particlerb.run(scene)
    before = orbit(2.0, (0.0, 0.0, 1.5), (0, 0, 0), 1.42)
    with particlerb.run(before) as found:
        assert 0.0 < found.position[-1, 0, 2] < 0.2


@pytest.mark.plain
def test_who_falls_is_told_by_name_beside_bodies_that_are_one():
    scene = orbit(2.0, (0.0, 0.0, 1.5), (0, 0, 0), 2.0)
    block = {"shape": {"type": "moments", "inertia": [1.0, 2.0, 2.5]}, "mass": 1.0}
    left, right = (block | {"name": n, "position": [x, 0, 0]} for n, x in (("l", 5), ("r", 6)))
    scene["body"] = [left, right, *scene["body"]]
    scene["joint"] = [{"type": "fixed", "body": "l", "to": "r"}]
    with pytest.raises(RunError, match=f"body {scene['body'][2]['name']} falls into what"):
        particlerb.run(scene)


def test_bodies_that_a_gradient_turns_are_stepped():
    scene = orbit(1.0, (1, 0, 0), (0, 1, 0), 1.0)
    scene["body"][0] |= {"shape": {"type": "moments", "inertia": [0.4, 0.4, 0.1]}, "mass": 2.0}
    (group,) = make_plan(to_system(load(scene))).groups
    assert group.segments[0].method == "strang"
    two = orbit(1.0, (1, 0, 0), (0, 1, 0), 1.0)
    two["force"].append(two["force"][0] | {"centre": [3.0, 0.0, 0.0]})
    (group,) = make_plan(to_system(load(two))).groups
    assert group.segments[0].method == "strang"
