"""Motion with contact: published impacts, friction, walls that move, momenta, energy, same bits."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from collision import restitution
from short_names import short_names

import particlerb
from particlerb.contact.restitution import damping_ratio
from particlerb.stepping import contact_motion
from particlerb.stepping.pair_forces import PairForces

G = 9.81
NOTHING = {"gravity": {"acceleration": [0.0, 0.0, 0.0]}}  # the compiled code is that of a weight
WEIGHT = {"gravity": {"acceleration": [0.0, 0.0, -G]}}

# Chung and Ooi, Granular Matter 13, 643 (2011), tests 1, 2 and 4, from their closed forms
GLASS = {"young": 4.8e10, "poisson": 0.2}
GLASS_BALLS = {"radius": 0.01, "mass": 0.011728612573401897}
GLASS_MEETS = (0.00027411270208928186, 10696.888983989631, 4.0339455688378695e-05)
ALLOY = {"young": 7e10, "poisson": 0.3}
ALLOY_BALL = {"radius": 0.1, "mass": 11.30554476271847}
ALLOY_MEETS = (4.9717175241740354e-05, 11369.858311285168, 0.0007316566406186849)
RIGID = {"young": 1e20, "poisson": 0.3}
OXIDE = {"young": 3.8e11, "poisson": 0.23}
SLIDING = [  # angle [°], tangential velocity after over before, spin after [rad/s]
    (35, 0.7398485590918564, 581.9452719119627),
    (50, 0.8471496111847467, 456.65174482394997),
    (70, 0.9336991821260685, 242.9793183019949),
    (85, 0.9840630650521177, 61.91753138576228),
]


def ran(case: dict) -> SimpleNamespace:
    """Arrays of a run, (T, n, 3), and its ledger."""
    with particlerb.run(case) as t:
        return short_names(t)


def same(one, other, row=-1):
    """Whether the last state of a run and one of another are the same bits; q is as good as -q."""
    for name in ("x", "p", "L"):
        assert np.array_equal(getattr(one, name)[-1], getattr(other, name)[row])
    assert np.array_equal(np.abs(one.q[-1]), np.abs(other.q[row]))


def hertz(restitution=1.0, friction=0.35):
    return {"law": "hertz", "restitution": restitution, "friction": friction}


def ball_on(make, contact, speed, steps, duration, ball=None, phase=0.3, **keys):
    """A ball that meets a plane at z = 0 within the third step, without gravity."""
    dt = duration / steps
    ball = {"mass": 1.0, "radius": 0.1} | (ball or {})
    height = ball["radius"] + (2.0 + phase) * dt * speed
    made = make.sphere(position=[0, 0, height], velocity=[0, 0, -speed]) | ball
    if "radius" in ball:
        made["shape"] = {"type": "sphere", "radius": made.pop("radius")}
    return {
        "run": {"t_end": 1.5 * duration, "every": 1.5 * duration, "dt": dt},
        "body": [made],
        "wall": [make.plane()],
        "contact": contact,
    } | (NOTHING | keys)


def collision(t, overlap, momentum):
    """Largest overlap, largest force and duration of a collision, from many frames."""
    force = np.diff(momentum) / np.diff(t)
    inside = np.flatnonzero(overlap > 0)
    first, last = inside[0], inside[-1]

    def crossing(i):
        return t[i] - overlap[i] * (t[i + 1] - t[i]) / (overlap[i + 1] - overlap[i])

    return overlap.max(), np.abs(force).max(), crossing(last) - crossing(first - 1)


# One collision -----------------------------------------------------------------------------------


def test_a_ball_leaves_the_floor_as_fast_as_it_came(make):
    """k = 1e4 N/m, m = 1 kg: half a period of π √(m/k), in 40 steps."""
    duration = math.pi * 1e-2
    run = ran(ball_on(make, make.hooke(1e4, 1.0, 0.0), 1.0, 40, duration))
    assert run.v[-1, 0] == pytest.approx([0, 0, 1.0], abs=1e-3)
    assert not run.w.any()
    assert np.abs(run.ledger.linear_momentum_error).max() < 1e-15


def test_two_balls_share_their_momentum_by_the_restitution(make):
    """v₁ = (m₁ - e m₂) u/(m₁ + m₂), v₂ = (1 + e) m₁ u/(m₁ + m₂); radii differ too."""
    e, k, mass = 0.7, 1e4, (1.0, 3.0)
    duration = math.pi * math.sqrt(0.75 / k)
    balls = [
        make.sphere("a", 0.1, position=[0, 0, 0], velocity=[1, 0, 0]) | {"mass": mass[0]},
        make.sphere("b", 0.05, position=[0.151, 0, 0]) | {"mass": mass[1]},
    ]
    t_end = 1.5 * duration + 0.001
    case = make.case(
        *balls, contact=make.hooke(k, e, 0.3), t_end=t_end, every=t_end, dt=duration / 80, **NOTHING
    )
    run = ran(case)
    assert run.v[-1, :, 0] == pytest.approx([(1 - 3 * e) / 4, (1 + e) / 4], abs=1e-3)
    assert np.abs(run.ledger.linear_momentum_error).max() < 1e-15
    assert np.abs(run.v[:, :, 1:]).max() == 0.0


@pytest.mark.compiled
def test_chung_and_ooi_1_two_glass_balls(make):
    """Peak force and overlap to 0.1 %, duration to 0.5 %; measured: 4e-5 and 5e-5."""
    depth, force, duration = GLASS_MEETS
    dt, R, m = duration / 100, GLASS_BALLS["radius"], GLASS_BALLS["mass"]
    balls = [
        make.sphere(name, R, position=[s * (R + 23.0 * dt), 0, 0], velocity=[-10.0 * s, 0, 0])
        | {"mass": m}
        for name, s in (("a", -1), ("b", 1))
    ]
    material = [{"name": "glass"} | GLASS]
    run = ran(
        make.case(
            *balls, contact=hertz(), material=material, t_end=1.3 * duration, every=duration / 500,
            dt=dt, **NOTHING,
        )
    )  # fmt: skip
    overlap = 2 * R - (run.x[:, 1, 0] - run.x[:, 0, 0])
    found = collision(run.t, overlap, run.p[:, 1, 0])
    assert found[:2] == pytest.approx((depth, force), rel=1e-4)
    assert found[2] == pytest.approx(duration, rel=1e-4)
    assert run.v[-1, :, 0] == pytest.approx([-10, 10], rel=2e-5)
    assert np.abs(run.ledger.linear_momentum_error).max() < 1e-15


@pytest.mark.compiled
def test_chung_and_ooi_2_an_alloy_ball_on_a_rigid_wall(make):
    depth, force, duration = ALLOY_MEETS
    material = [{"name": "alloy"} | ALLOY, {"name": "rigid"} | RIGID]
    case = ball_on(make, hertz(), 0.2, 100, duration, ALLOY_BALL, material=material)
    case["run"]["every"] = duration / 500
    case["body"][0]["material"], case["wall"][0]["material"] = "alloy", "rigid"
    run = ran(case)
    found = collision(run.t, 0.1 - run.x[:, 0, 2], run.p[:, 0, 2])
    assert found == pytest.approx((depth, force, duration), rel=1e-4)


@pytest.mark.compiled
@pytest.mark.parametrize(("angle", "e_t", "spin"), SLIDING)
def test_chung_and_ooi_4_an_oxide_ball_that_slides_through_the_impact(make, angle, e_t, spin):
    """vt' = vt - μ (1 + e) vn and R ω' = (5/2) μ (1 + e) vn, where it slides until the end."""
    R, speed = 0.0025, 3.9
    m = 4000.0 * 4.0 / 3.0 * math.pi * R**3
    vn, vt = speed * math.cos(math.radians(angle)), speed * math.sin(math.radians(angle))
    K = 4.0 / 3.0 * 3.8e11 / (1 - 0.23**2) * math.sqrt(R)
    duration = 2.94 * (1.25 * m / K) ** 0.4 * vn**-0.2
    material = [{"name": "oxide"} | OXIDE, {"name": "rigid"} | RIGID]
    ball = {"radius": R, "mass": m}
    case = ball_on(make, hertz(0.98, 0.092), vn, 200, duration, ball, material=material)
    case["body"][0] |= {"material": "oxide", "velocity": [vt, 0, -vn]}
    case["wall"][0]["material"] = "rigid"
    run = ran(case)
    assert run.v[-1, 0, 0] / vt == pytest.approx(e_t, abs=1e-5)
    assert run.v[-1, 0, 2] / vn == pytest.approx(0.98, abs=1e-4)
    assert run.w[-1, 0, 1] == pytest.approx(spin, rel=2e-3)  # its lever is R - δ/2


@pytest.mark.compiled
@pytest.mark.parametrize("law", ["hooke", "hooke that attracts", "hertz"])
@pytest.mark.parametrize("e", [0.9, 0.5, 0.2])
def test_a_ball_bounces_with_the_restitution_asked_for(make, law, e):
    """To 1e-4, with 100 steps in a contact."""
    if law == "hertz":
        contact, keys = hertz(e), {"material": [{"name": "rubber", "young": 2e6, "poisson": 0.3}]}
        K = 4.0 / 3.0 * 2e6 / (2 * (1 - 0.09)) * math.sqrt(0.1)
        duration = 2.94 * (1.25 / K) ** 0.4
    else:
        contact, keys = make.hooke(1e4, e, 0.3, attract="attracts" in law), {}
        duration = math.pi * 1e-2
    runs = [
        ran(ball_on(make, contact, 1.0, 100.3, duration, phase=phase, **keys))
        for phase in (0.1, 0.5, 0.9)
    ]
    assert np.abs([run.v[-1, 0, 2] - e for run in runs]).max() < 1e-4
    assert np.abs([run.ledger.energy_error[-1] for run in runs]).max() < 1e-7 * 0.5


@pytest.mark.compiled
@pytest.mark.parametrize(("e", "within"), [(1.0, 1e-7), (0.5, 3e-6), (0.2, 6e-6)])
@pytest.mark.parametrize("law", ["hooke", "hertz"])
def test_energy_closes_in_every_frame_of_a_contact_of_100_steps(make, law, e, within):
    """Frames between the steps, in units of the energy that the ball brings."""
    contact, keys, duration = make.hooke(1e4, e, 0.3), {}, math.pi * 1e-2
    if law == "hertz":
        contact, keys = hertz(e), {"material": [{"name": "rubber", "young": 2e6, "poisson": 0.3}]}
        duration = 2.94 * (1.25 / (4.0 / 3.0 * 2e6 / (2 * (1 - 0.09)) * math.sqrt(0.1))) ** 0.4
    case = ball_on(make, contact, 1.0, 100.3, duration, **keys)
    case["run"]["every"] = 0.37 * duration / 100.3
    off = np.abs(ran(case).ledger.energy_error) / 0.5
    assert off.max() < within
    assert off[-1] < 1e-7


@pytest.mark.compiled
@pytest.mark.parametrize("e", [0.9, 0.2])
def test_a_rod_hit_at_its_tip_gives_the_restitution_asked_for(make, e):
    """Of the points that touch: the damping is that of 1/m_eff with the rotation of the rod."""
    k, side = 1e6, math.sqrt(0.5)
    dt = math.pi * math.sqrt(0.2 / k) / 100
    tip = {"shape": {"type": "sphere", "radius": 0.01}, "mass": 0, "position": [0, 0, 0.5]}
    matter = {"shape": {"type": "rod", "length": 1.0, "arrangement": "exact"}, "mass": 2.0}
    rod = {"name": "rod", "orientation": [side, 0, side, 0], "part": [matter, tip]}
    ball = make.sphere("ball", 0.01, position=[0.5, 0, 0.02 + 2.3 * dt], velocity=[0, 0, -1])
    contact = make.hooke(k, e, 0.0)
    case = make.case(
        rod, ball | {"mass": 1.0}, contact=contact, t_end=200 * dt, every=200 * dt, dt=dt, **NOTHING
    )
    run = ran(case)
    apart = run.v[-1, 1, 2] - (run.v[-1, 0, 2] - 0.5 * run.w[-1, 0, 1])
    assert apart == pytest.approx(e, abs=5e-5)
    assert abs(run.ledger.energy_error[-1]) < 1e-8


@pytest.mark.parametrize("e", [0.9, 0.3])
def test_a_box_that_falls_flat_is_damped_by_each_of_its_contacts_as_if_alone(make, e):
    """Four springs and dashpots on M, each with c = 2ζ√(m_eff k): ζ√(4 m_eff/M) in all."""
    k, r, m = 1e6, 0.1, 1.0
    corners = [[x, y, z] for x in (-r, r) for y in (-r, r) for z in (-r, r)]
    shape = {"type": "points", "mass": m / 8.0, "radius": r, "position": corners}
    box = {"name": "box", "shape": shape, "position": [0, 0, 2 * r], "velocity": [0, 0, -1]}
    dt = math.pi * math.sqrt(m / (4.0 * k)) / 100
    run = ran(make.case(box, contact=make.hooke(k, e, 0.0), wall=[make.plane()], t_end=300 * dt,
                        every=300 * dt, dt=dt, **NOTHING))  # fmt: skip
    inertia = m * (2.0 * r**2 + 0.4 * r**2)
    m_eff = 1.0 / (1.0 / m + 2.0 * r**2 / inertia)
    together = damping_ratio(e) * math.sqrt(4.0 * m_eff / m)
    assert run.v[-1, 0, 2] == pytest.approx(restitution(together), abs=2e-4)
    assert abs(run.w[-1]).max() < 1e-12


@pytest.mark.compiled
def test_a_rod_hit_at_its_tip_turns_as_a_rigid_one_as_the_stiffness_grows(make):
    """m = 1 at 1 m/s on the end of M = 2, L = 1: ball and rod 1/3 m/s, rod 2 rad/s.

    The softer the contact, the further the rod turns in it.
    """
    off, side = [], math.sqrt(0.5)
    for k in (5e3, 2e4, 1e5):
        dt = math.pi * math.sqrt(0.4 / k) / 100
        tip = {"shape": {"type": "sphere", "radius": 0.01}, "mass": 0, "position": [0, 0, 0.5]}
        matter = {"shape": {"type": "rod", "length": 1.0, "arrangement": "exact"}, "mass": 2.0}
        rod = {"name": "rod", "orientation": [side, 0, side, 0], "part": [matter, tip]}
        ball = make.sphere("ball", 0.01, position=[0.5, 0, 0.02 + 2.3 * dt], velocity=[0, 0, -1])
        run = ran(
            make.case(
                rod, ball | {"mass": 1.0}, contact=make.hooke(k, 1.0, 0.0), t_end=200 * dt,
                every=200 * dt, dt=dt, **NOTHING,
            )
        )  # fmt: skip
        wrong = [run.v[-1, 0, 2] + 1 / 3, run.v[-1, 1, 2] + 1 / 3, run.w[-1, 0, 1] - 2.0]
        off.append(np.abs(wrong).max())
    assert off[0] > off[1] > off[2]
    assert off[2] < 1e-4


@pytest.mark.compiled
def test_a_superball_throws_back_its_slide_too(make):
    """Garwin, Am. J. Phys. 37, 88 (1969): v' = (3v - 4C)/7, C' = (-10v - 3C)/7 with C = R ω.

    With k_t = 2/7 k the tangential spring swings half a period while the normal one does.
    """
    v, C, k = 0.7, 0.4, 1e8
    case = ball_on(make, make.hooke(k, 1.0, 100.0), 1.0, 100.3, math.pi / math.sqrt(k))
    case["body"][0] |= {"velocity": [v, 0, -1.0], "angular_velocity": [0, -C / 0.1, 0]}
    run = ran(case)
    assert run.v[-1, 0, 0] == pytest.approx((3 * v - 4 * C) / 7, abs=5e-4)
    assert -0.1 * run.w[-1, 0, 1] == pytest.approx((-10 * v - 3 * C) / 7, abs=5e-4)
    assert run.v[-1, 0, 2] == pytest.approx(1.0, abs=1e-4)


@pytest.mark.compiled
def test_bounces_fall_as_even_powers_of_the_restitution(make):
    """Heights e^(2k) h; the weight, up to 1e-3 of the force of a bounce, takes as much of each."""
    e = 0.8
    ball = make.sphere(position=[0, 0, 1.1])
    run = ran(
        make.case(
            ball, contact=make.hooke(1e8, e, 0.2), wall=[make.plane()], t_end=2.6, every=0.002,
            dt=2e-6, **WEIGHT,
        )
    )  # fmt: skip
    z, vz = run.x[:, 0, 2] - 0.1, run.v[:, 0, 2]
    top = z + vz * vz / (2 * G)  # height that it will reach, in flight
    falls = np.flatnonzero((vz[:-1] < 0) & (vz[1:] > 0))
    heights = [top[i + 5] for i in falls]
    assert heights == pytest.approx([e ** (2 * k) for k in range(1, len(heights) + 1)], rel=3e-3)
    assert len(heights) == 5


# Friction ----------------------------------------------------------------------------------------


@pytest.mark.compiled
def test_a_ball_that_leaves_a_smooth_dome_does_so_at_cos_two_thirds(make):
    """From rest at θ₀ it leaves where cos θ = (2/3) cos θ₀; the dome is a fixed body."""
    start, k, a, R = 0.1, 1e6, 0.5, 0.1
    D = a + R - G * math.cos(start) / k
    place = [D * math.sin(start), 0, D * math.cos(start)]
    bodies = [make.sphere("dome", a, fixed=True), make.sphere("ball", R, position=place)]
    bodies[1]["mass"] = 1.0
    run = ran(
        make.case(
            *bodies, contact=make.hooke(k, 1.0, 0.0, overlap=1e-3), t_end=0.9, every=1e-3, dt=1e-4,
            **WEIGHT,
        )
    )  # fmt: skip
    distance = np.linalg.norm(run.x[:, 1], axis=1)
    off = np.flatnonzero(distance > a + R)[0]
    cosine = run.x[off - 1 : off + 1, 1, 2] / distance[off - 1 : off + 1]
    assert cosine[1] < 2 / 3 * math.cos(start) < cosine[0] + 1e-3
    assert np.array_equal(run.x[:, 0], 0 * run.x[:, 0])
    assert np.abs(run.ledger.linear_momentum_error).max() < 1e-14
    assert np.abs(run.ledger.energy_error).max() < 1e-5


@pytest.mark.compiled
def test_a_ball_rolls_in_circles_on_a_turntable(make):
    """Without slip it goes round with 2/7 of the turntable's rate, about a point of its own."""
    rate, R, m, k, place, v = 5.0, 0.1, 0.1, 1e5, 0.5, 0.3
    orbit = 2 / 7 * rate
    radius, period = v / orbit, 2 * math.pi / orbit
    ball = make.sphere(
        "ball",
        R,
        position=[place, 0, R - m * G / k],
        velocity=[0, v, 0],
        angular_velocity=[(rate * place - v) / R, 0, 0],
    )
    table = make.plane(motion={"angular_velocity": [0, 0, rate]})
    run = ran(
        make.case(
            ball | {"mass": m}, contact=make.hooke(k, 0.5, 0.5, overlap=1e-5), wall=[table],
            t_end=period, every=period / 100, dt=2e-4, **WEIGHT,
        )
    )  # fmt: skip
    from_centre = run.x[:, 0] - [place - radius, 0, 0]
    assert np.hypot(*from_centre.T[:2]) == pytest.approx(radius, rel=2e-4)
    assert run.x[-1, 0] == pytest.approx(run.x[0, 0], abs=2e-4)
    assert np.ptp(run.ledger.work) > 0.08  # the table gives and takes
    assert np.abs(run.ledger.energy_error).max() < 1e-10
    assert np.abs(run.ledger.linear_momentum_error).max() < 1e-14
    assert np.abs(run.ledger.angular_momentum_error).max() < 1e-14


@pytest.mark.compiled
def test_a_belt_drags_a_raft_along_and_its_work_is_counted(make):
    """v = μ g t until the raft goes with the belt: half of the belt's work is friction's."""
    k, speed = 1e5, 1.0
    shape = {"type": "points", "mass": 0.5, "radius": 0.05}
    shape["position"] = [[a, b, 0.0] for a in (-0.3, 0.3) for b in (-0.3, 0.3)]
    raft = {"name": "raft", "shape": shape, "position": [0, 0, 0.05 - 0.5 * G / k]}
    run = ran(
        make.case(
            raft, contact=make.hooke(k, 0.5, 0.2, overlap=1e-4), t_end=0.8, every=0.1, dt=4e-4,
            wall=[make.plane(motion={"velocity": [speed, 0, 0]})], **WEIGHT,
        )
    )  # fmt: skip
    assert run.v[3, 0, 0] == pytest.approx(0.2 * G * 0.3, rel=1e-12)
    assert run.v[-1, 0] == pytest.approx([speed, 0, 0], abs=1e-10)
    assert run.ledger.work[-1] == pytest.approx(0.5 * 2.0 * speed**2, rel=1e-6)
    assert np.abs(run.ledger.energy_error).max() < 1e-8
    assert np.abs(run.ledger.linear_momentum_error).max() < 1e-14


@pytest.mark.compiled
def test_rolling_friction_slows_a_ball_by_five_sevenths_of_it(make):
    """(7/5) m R² α = -μ_r R m g."""
    k, ball = 1e6, make.sphere(velocity=[1, 0, 0], angular_velocity=[0, 10, 0])
    ball["position"] = [0, 0, 0.1 - 2.0 * G / k]
    run = ran(
        make.case(
            ball, contact=make.hooke(k, 0.5, 0.5, overlap=1e-4, rolling_friction=0.02),
            wall=[make.plane()], t_end=1.0, every=0.1, dt=2e-4, **WEIGHT,
        )
    )  # fmt: skip
    slowed = np.diff(run.v[1:, 0, 0]) / 0.1
    assert slowed == pytest.approx(-5 / 7 * 0.02 * G, rel=2e-4)
    assert np.abs(run.ledger.energy_error).max() < 1e-10


# Walls that move ---------------------------------------------------------------------------------


@pytest.mark.compiled
def test_a_ball_on_a_shaking_floor_swings_as_a_driven_spring_and_the_ledger_closes(make):
    """y = A/(1 - r²) (sin Ωt - r sin ωt), r = Ω/ω, while it stays on the floor; order 2."""
    m, k, A, f = 2.0, 1e4, 3e-3, 3.0
    rate, drive = math.sqrt(k / m), 2 * math.pi * f
    ratio = drive / rate
    floor = make.plane(motion={"oscillation": {"amplitude": [0, 0, A], "frequency": f}})
    off, error = [], []
    for dt in (2e-3, 1e-3):
        run = ran(
            make.case(
                make.sphere(position=[0, 0, 0.1 - m * G / k]), wall=[floor], t_end=1.0, every=0.01,
                contact=make.hooke(k, 1.0, 0.3, overlap=1e-2), dt=dt, **WEIGHT,
            )
        )  # fmt: skip
        y = run.x[:, 0, 2] - run.x[0, 0, 2]
        swing = np.sin(drive * run.t) - ratio * np.sin(rate * run.t)
        off.append(np.abs(y - A / (1 - ratio**2) * swing).max() / A)
        error.append(np.abs(run.ledger.energy_error).max())
        assert np.abs(run.ledger.work).max() > 0.06
        assert np.abs(run.ledger.linear_momentum_error).max() < 1e-15
    assert off[1] < 5e-3
    assert off[0] / off[1] == pytest.approx(4.0, rel=0.05)
    assert error[0] / error[1] == pytest.approx(4.0, rel=0.05)


@pytest.mark.compiled
def test_a_wall_that_comes_and_one_that_stands_throw_a_ball_alike(make):
    """Galilei: as seen from the wall nothing differs, but for rounding."""
    duration = math.pi * 1e-2
    still = ball_on(make, make.hooke(1e4, 0.6, 0.3), 1.0, 50, duration)
    still["body"][0] |= {"velocity": [0.5, 0, -1.0]}
    moves = ball_on(make, make.hooke(1e4, 0.6, 0.3), 1.0, 50, duration)
    moves["body"][0] |= {"velocity": [0.0, 0, 0.5]}
    moves["wall"][0]["motion"] = {"velocity": [-0.5, 0, 1.5]}
    one, other = ran(still), ran(moves)
    assert other.v[-1, 0] - [-0.5, 0, 1.5] == pytest.approx(one.v[-1, 0], abs=1e-12)
    assert other.w[-1, 0] == pytest.approx(one.w[-1, 0], abs=1e-10)
    assert np.abs(other.ledger.energy_error).max() < 3e-3


@pytest.mark.compiled
def test_a_raft_that_friction_holds_in_a_box_that_turns_stays_where_it_is(make):
    """Its weight pulls it to and fro by m g/(4 k_t), where the springs turn with the wall.

    Once round in a second, ω² r is 3.8 g; pairs are looked for anew every few steps.
    """
    k, turn = 1e5, 2 * math.pi
    far = 0.95 + 2.0 * turn**2 * 0.95 / (4 * k)
    shape = {"type": "points", "mass": 0.5, "radius": 0.05}
    shape["position"] = [[0.0, a, b] for a in (-0.3, 0.3) for b in (-0.3, 0.3)]
    raft = {"name": "raft", "shape": shape, "position": [far, 0, 0]}
    raft |= {"velocity": [0, 0, -turn * far], "angular_velocity": [0, turn, 0]}
    box = {"type": "box", "name": "box", "lower": [-1, -1, -1], "upper": [1, 1, 1]}
    run = ran(
        make.case(
            raft, contact=make.hooke(k, 0.5, 0.8, overlap=1e-3, skin=0.01), t_end=2.0, every=0.01,
            wall=[box | {"motion": {"angular_velocity": [0, turn, 0]}}], dt=2e-4, **WEIGHT,
        )
    )  # fmt: skip
    angle = turn * run.t
    along = run.x[:, 0, 0] * np.sin(angle) + run.x[:, 0, 2] * np.cos(angle)
    away = run.x[:, 0, 0] * np.cos(angle) - run.x[:, 0, 2] * np.sin(angle)
    give = 2.0 * G / (4 * 2 / 7 * k)
    assert 0.9 * give < np.abs(along).max() < 1.3 * give
    assert away == pytest.approx(far, abs=5e-4)
    assert np.abs(run.ledger.linear_momentum_error).max() < 1e-12


@pytest.mark.compiled
def test_frames_between_all_steps_do_not_change_low_bounces_with_spin(make):
    """A contact that a frame sees end between two steps is forgotten like any other."""
    ball = make.sphere(position=[0, 0, 0.1001], velocity=[0.3, 0, 0], angular_velocity=[0, 50, 9])

    def run(every):
        contact = make.hooke(1e5, 1.0, 0.3)
        return ran(
            make.case(
                ball,
                contact=contact,
                wall=[make.plane()],
                t_end=1.0,
                every=every,
                dt=2e-4,
                **WEIGHT,
            )
        )

    same(run(1.0), run(0.37 * 2e-4))


# Many bodies -------------------------------------------------------------------------------------


def crowd(make, dt=4e-4, restitution=0.6, friction=0.4, t_end=0.5, every=0.5, **keys):
    """27 bodies of all classes but point that fly into each other; the rods' material is smooth."""
    rng = np.random.default_rng(3)
    rod = {"shape": {"type": "rod", "length": 0.2, "arrangement": "exact"}, "mass": 1.0}
    beads = {"type": "points", "mass": 0.0, "radius": 0.06}
    beads["position"] = [[0, 0, z] for z in (-0.1, 0.0, 0.1)]
    corners = [[0.05 * a, 0.05 * b, 0.05 * c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]
    bent = [[0, 0, 0], [0.1, 0, 0], [0, 0.08, 0]]
    points = {"type": "points"}
    kinds = [
        {"part": [rod, {"shape": beads}]},
        {"shape": points | {"mass": 1.0, "radius": 0.06, "position": beads["position"]}},
        {"shape": points | {"mass": [1, 0.7, 0.5], "radius": [0.1, 0.07, 0.05], "position": bent}},
        {"shape": points | {"mass": 0.2, "radius": 0.06, "position": corners}},
        {"shape": {"type": "sphere", "radius": 0.09}, "mass": 1.0},
        {"shape": {"type": "sphere", "radius": 0.05}, "mass": 0.3},
    ]
    cells = np.array([[x, y, z] for x in range(3) for y in range(3) for z in range(3)])
    bodies = []
    for k, own in enumerate(np.array_split(rng.permutation(27), len(kinds))):
        place = 0.4 * (cells[own] - 1.0)
        spin = 3.0 * rng.normal(size=place.shape)
        body = {"name": f"kind {k}", "count": len(own), "position": place, **kinds[k]}
        body["velocity"] = rng.normal(size=place.shape) * 0.3 - 2.0 * place
        body["angular_velocity"] = spin * [1, 1, 0] if k == 0 else spin
        body |= {"material": "smooth"} if k == 0 else {"material": "rough", "orientation": "random"}
        bodies.append(body)
    smooth = {"friction": 0.0, "stiffness": 3e4, "restitution": restitution**0.5}
    pairs = [{"materials": ["smooth", other]} | smooth for other in ("smooth", "rough")]
    return make.case(
        *bodies,
        contact=make.hooke(2e4, restitution, friction, pair=pairs),
        material=[{"name": "rough"}, {"name": "smooth"}],
        dt=dt,
        t_end=t_end,
        every=every,
        **(NOTHING | keys),
    )


@pytest.fixture(scope="module")
def once(make):
    return ran(crowd(make))


@pytest.fixture(scope="module")
def shaken(make):
    """The crowd over a floor that shakes."""
    return ran(crowd(make, wall=[shaking(make)]))


def shaking(make):
    swing = {"amplitude": [0.01, 0, 0.02], "frequency": 5.0}
    return make.plane(point=[0, 0, -0.75], material="rough", motion={"oscillation": swing})


@pytest.mark.compiled
def test_bodies_of_all_classes_that_collide_keep_both_momenta(once):
    size = np.linalg.norm(once.p[0], axis=1).sum()
    assert len(set(once.bodies.rotor_class.tolist())) == 4
    assert np.abs(once.p[-1] - once.p[0]).max() > 0.5  # they do collide
    assert np.abs(once.ledger.linear_momentum_error).max() < 1e-12 * size
    assert np.abs(once.ledger.angular_momentum_error).max() < 1e-12


@pytest.mark.compiled
def test_what_a_floor_that_shakes_gives_a_crowd_is_counted(shaken):
    assert np.abs(shaken.p[-1] - shaken.p[0]).sum(axis=0)[2] > 1.0
    assert np.abs(shaken.ledger.linear_momentum_error).max() < 1e-12
    assert np.abs(shaken.ledger.angular_momentum_error).max() < 1e-12
    assert np.abs(shaken.ledger.energy_error).max() < 3e-3 * 38.1


@pytest.mark.compiled
def test_the_ledger_closes_at_order_two_with_damping_and_friction(make):
    """27.4 J are lost; what the ledger misses of them falls by four."""
    found = [ran(crowd(make, dt, t_end=1.0)).ledger for dt in (2e-4, 1e-4, 5e-5)]
    error = [np.abs(ledger.energy_error[-1]) for ledger in found]
    assert found[-1].work[-1] == pytest.approx(-27.4, abs=0.1)
    assert error[0] / error[1] == pytest.approx(4.0, rel=0.3)
    assert error[1] / error[2] == pytest.approx(4.0, rel=0.3)
    assert error[2] < 3e-5 * abs(found[-1].work[-1])


@pytest.mark.compiled
def test_elastic_bodies_without_friction_keep_their_energy_to_order_two(make):
    """Root mean square over the frames: the error of a single collision depends on its instant."""
    found = [
        ran(crowd(make, dt, 1.0, 0.0, t_end=0.4, every=0.01)).ledger.energy_error
        for dt in (4e-4, 1e-4)
    ]
    coarse, fine = (math.sqrt(np.mean(error**2)) for error in found)
    assert coarse / fine > 10.0
    assert np.abs(found[1]).max() < 1e-3 * 39.3


@pytest.mark.compiled
def test_frames_do_not_change_the_motion_and_a_prolonged_run_is_a_longer_one(make, shaken):
    once, wall = shaken, [shaking(make)]
    often = ran(crowd(make, every=0.00313, wall=wall))
    longer = ran(crowd(make, t_end=0.7, every=0.1, wall=wall))
    row = int(np.abs(longer.t - 0.5).argmin())
    same(once, often)
    same(once, longer, row)
    assert often.ledger.work[-1] == once.ledger.work[-1] == longer.ledger.work[row]


@pytest.mark.compiled
@pytest.mark.parametrize("threads", [1, 2, 3])
def test_threads_give_the_same_bits(make, shaken, monkeypatch, threads):
    monkeypatch.setattr(contact_motion, "WORTH_THREADS", 0.0)
    case = crowd(make, every=0.0313, wall=[shaking(make)])
    case["run"]["threads"] = threads
    same(shaken, ran(case))


@pytest.mark.plain
def test_the_loop_in_python_that_spreads_attraction_gives_the_same_bits(make, monkeypatch):
    case = crowd(make, t_end=0.01, every=0.0031, dt=1e-3, wall=[shaking(make)])
    case["attraction"] = {"G": 0.1}
    compiled = ran(case)
    monkeypatch.setattr(PairForces, "is_large", True)
    case["run"]["threads"] = 2
    same(compiled, ran(case))


def two_on_a_dashpot(make, contact):
    """Two balls at a distance on a damped spring, with contact or without."""
    balls = [
        make.sphere("a", position=[0.0, 0.0, 0.0]),
        make.sphere("b", position=[1.0, 0.0, 0.0], velocity=[0.5, 0.2, 0.0]),
    ]
    spring = {"type": "spring", "body": "a", "to": "b", "stiffness": 3.0, "damping": 2.0}
    run = {"t_end": 0.1, "every": 0.033, "dt": 2e-3, "method": "strang"}
    keys = {"contact": make.hooke(1e4, 0.5, 0.5)} if contact else {}
    return make.case(*balls, force=[spring | {"rest_length": 1.0}], **keys) | {"run": run}


@pytest.mark.plain
def test_dashpots_between_bodies_act_beside_contact(make, monkeypatch):
    free, beside = (ran(two_on_a_dashpot(make, contact)) for contact in (False, True))
    assert np.abs(free.v[-1] - free.v[0]).max() > 0.02
    assert beside.v == pytest.approx(free.v, rel=1e-12, abs=1e-15)
    assert beside.ledger.work == pytest.approx(free.ledger.work, rel=1e-12, abs=1e-15)
    monkeypatch.setattr(PairForces, "is_large", True)
    same(beside, ran(two_on_a_dashpot(make, True)))


@pytest.mark.compiled
@pytest.mark.parametrize("method", ["strang", "rk4"])
def test_three_threads_with_blocks_of_their_own_give_the_bits_of_one(make, method):
    """700 balls of unequal size fall into a heap; there are three blocks, lists are made often."""
    cells = np.stack(np.meshgrid(*[np.arange(k) for k in (7, 10, 10)]), axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(1)
    place = 0.22 * cells + rng.uniform(-0.005, 0.005, cells.shape) + [0, 0, 0.15]
    shape = {"type": "points", "mass": 1.0, "radius": 0.1, "position": [[0, 0, 0]]}
    balls = {"name": "ball", "shape": shape, "count": 700, "position": place}
    walls = [{"name": "bin", "type": "box", "lower": [-0.2, -0.2, 0], "upper": [1.6, 2.2, 4]}]
    fall = balls | {"velocity": rng.normal(size=place.shape) - [0, 0, 3.0]}
    run = {"t_end": 0.1, "every": 0.0173, "dt": 2e-4, "method": method}
    case = make.case(fall, contact=make.hooke(1e5, 0.5, 0.5), wall=walls, **WEIGHT)
    case["run"] |= run
    ends = [ran(case | {"run": case["run"] | {"threads": k}}) for k in (1, 2, 3)]
    assert np.abs(ends[0].v[-1]).max() < 20.0
    for other in ends[1:]:
        same(ends[0], other)
        assert (other.ledger.work == ends[0].ledger.work).all()


def test_a_short_crowd_keeps_its_momenta_in_plain_python_too(make):
    run = ran(crowd(make, t_end=0.02, every=0.02, dt=1e-3))
    assert np.abs(run.ledger.linear_momentum_error).max() < 1e-13
    assert np.abs(run.ledger.angular_momentum_error).max() < 1e-13
    assert np.isfinite(run.x).all()


def test_no_contact_is_passed_over_as_too_far(make):
    """Lists of other skins put the pairs into other shells, and sums into another order."""
    corners = 0.1 * (2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0)
    shape = {"type": "points", "mass": 1.0, "radius": 0.1, "position": corners.tolist()}
    place = 0.56 * np.array(list(np.ndindex(2, 2, 1))) + [0.3, 0.3, 0.28]
    fall = {"name": "clump", "shape": shape, "count": 4, "position": place.tolist()}
    fall |= {"orientation": "random", "velocity": [1.0, 0.5, -3.0]}
    wall = {"name": "bin", "type": "box", "lower": [0.0, 0.0, 0.0], "upper": [1.16, 1.16, 2.0]}
    run = {"t_end": 0.06, "every": 0.02, "dt": 1e-3, "method": "strang"}
    ends = []
    for skin in (0.004, 0.03, 0.25):
        case = make.case(fall, contact=make.hooke(1e4, 0.5, 0.5, skin=skin), wall=[wall], **WEIGHT)
        case["run"] |= run
        ends.append(ran(case))
    assert np.abs(np.diff(ends[0].v, axis=0)).max() > 1.0
    for other in ends[1:]:
        assert np.abs(ends[0].x - other.x).max() < 1e-12
        assert np.abs(ends[0].v - other.v).max() < 1e-10
