"""Bodies that move as prescribed: where they are, what they do to others, what is counted."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import particlerb
from particlerb.case.problems import CaseError
from particlerb.case.reader import load
from particlerb.record.verify import verify
from particlerb.stepping import contact_motion

K = 1e4
NOTHING = {"acceleration": [0.0, 0.0, 0.0]}
SWING = {"amplitude": [0.0, 0.02, 0.01], "frequency": 3.0, "phase": 0.7}
MOTION = {"velocity": [0.3, 0, 0], "angular_velocity": [0.2, 4.0, -3.0], "oscillation": SWING}


def scene(make, *bodies, t_end=0.2, every=0.02, dt=1e-3, **keys):
    """Bodies without gravity, as the compiled code has it."""
    tables = {"contact": make.hooke(K, 1.0, 0.5), "gravity": NOTHING, "threads": 1} | keys
    return make.case(*bodies, t_end=t_end, every=every, dt=dt, **tables)


def paddle(name="paddle", **keys):
    """Clump of unlike spheres, whose principal axes are not its own."""
    shape = {"type": "points", "position": [[0, 0, 0], [0.1, 0, 0], [0.1, 0.07, 0.02]]}
    shape |= {"mass": [1.0, 0.5, 0.2], "radius": [0.05, 0.04, 0.03]}
    return {"name": name, "shape": shape, "position": [1, 2, 3]} | keys


@pytest.mark.parametrize("centre", [None, [1.5, 1.0, 3.0]])
def test_a_driven_body_goes_where_its_motion_says(make, centre):
    """c + v t + A sin(2πft + φ) + R(ωt)(x₀ - c), the same turn for its axes, and its momenta."""
    motion = MOTION | ({} if centre is None else {"centre": centre})
    body = paddle(motion=motion, orientation={"euler_deg": [10, 20, 30]})
    with particlerb.run(scene(make, make.sphere("away", position=[9, 9, 9]), body)) as t:
        time, own = t.time, np.array([1.0, 2.0, 3.0])
        c = own if centre is None else np.array(centre)
        w = np.array(motion["angular_velocity"])
        turn = Rotation.from_rotvec(np.outer(time, w))
        phase = 2.0 * math.pi * 3.0 * time + 0.7
        A = np.array(SWING["amplitude"])
        way = np.outer(time, [0.3, 0, 0]) + np.outer(np.sin(phase), A)
        arm = turn.apply(own - c)
        assert t.position[:, 1] == pytest.approx(c + way + arm, abs=1e-14)
        v = np.array([0.3, 0, 0]) + 6.0 * math.pi * np.outer(np.cos(phase), A) + np.cross(w, arm)
        assert t.velocity[:, 1] == pytest.approx(v, abs=1e-13)
        assert t.angular_velocity[:, 1] == pytest.approx(np.tile(w, (time.size, 1)), abs=1e-13)
        start = Rotation.from_euler("ZYX", [30, 20, 10], degrees=True)
        q = np.roll((turn * start).as_quat(), 1, axis=1)
        assert np.abs((q * t.orientation[:, 1]).sum(axis=1)) == pytest.approx(1.0, abs=1e-14)
        assert ((t.orientation[1:] * t.orientation[:-1]).sum(axis=2) > 0.0).all()  # signs go on
        assert not t.ledger.kinetic_energy.any()  # nobody counts it
        assert not t.ledger.linear_momentum.any()


def test_a_driven_body_has_its_momenta_whenever_lists_are_made(make, monkeypatch):
    """M v and I ω, not at frames alone: rows of a state mean the same at all times."""
    motion = {"velocity": [0.3, 0, 0], "angular_velocity": [0, 0, 2.0]}
    bat = make.sphere("bat", 0.2, position=[0, 0, 0], motion=motion, mass=77.0)
    momenta, list_pairs = [], contact_motion.ContactMotion.list_pairs

    def noting(self, *args):
        (b,) = self.contact.setup.model.prescribed.body
        momenta.append(self.bodies.values(7, 6)[:, b].copy())
        list_pairs(self, *args)

    monkeypatch.setattr(contact_motion.ContactMotion, "list_pairs", noting)
    case = scene(make, bat, make.sphere("ball", position=[0.6, 0, 0]), t_end=0.03, every=0.03)
    case["contact"] |= {"skin": 0.01}
    particlerb.run(case).close()
    assert len(momenta) > 2
    expected = [77.0 * 0.3, 0, 0, 0, 0, 0.4 * 77.0 * 0.2**2 * 2.0]
    assert np.array(momenta) == pytest.approx(np.tile(expected, (len(momenta), 1)), rel=1e-12)


@pytest.mark.parametrize("first", [True, False])
def test_a_bat_throws_a_ball_with_twice_its_speed_and_its_work_is_counted(make, first):
    """v' = (1 + e) u; what the driver gives, less what dashpots take, is m v'²/2."""
    u, e, m = 1.5, 0.7, 2.0
    duration = math.pi * math.sqrt(m / K)
    bat = make.sphere("bat", 0.2, position=[0, 0, 0], motion={"velocity": [u, 0, 0]}, mass=77.0)
    ball = make.sphere("ball", 0.1, position=[0.3 + 2.3 * u * duration / 100, 0, 0], mass=m)
    bodies = [bat, ball] if first else [ball, bat]
    t_end = 1.3 * duration
    case = scene(make, *bodies, t_end=t_end, every=t_end, dt=duration / 100)
    case["contact"] |= {"restitution": e}
    with particlerb.run(case) as t:
        own = 1 if first else 0
        assert t.velocity[-1, own] == pytest.approx([(1 + e) * u, 0, 0], abs=1e-3)
        assert t.velocity[-1, 1 - own] == pytest.approx([u, 0, 0], abs=1e-15)
        assert t.ledger.work[-1] == pytest.approx(0.5 * m * ((1 + e) * u) ** 2, rel=1e-3)
        assert abs(t.ledger.energy_error[-1]) < 1e-3
        assert np.abs(t.ledger.linear_momentum_error).max() < 1e-14
        assert np.abs(t.ledger.angular_momentum_error).max() < 1e-14


@pytest.mark.compiled
def test_a_ball_on_a_body_that_shakes_swings_as_a_driven_spring_to_order_two(make):
    """y = A/(1 - r²) (sin Ωt - r sin ωt), r = Ω/ω; the balance closes to the same order."""
    m, A, f, g = 2.0, 2e-3, 4.0, 9.81
    omega, drive = math.sqrt(K / m), 2.0 * math.pi * f
    r = drive / omega
    swing = {"amplitude": [0, 0, A], "frequency": f}
    anvil = make.sphere("anvil", 0.5, position=[0, 0, 0], motion={"oscillation": swing})
    ball = make.sphere(position=[0, 0, 0.6 - m * g / K], mass=m)
    off, error = [], []
    for dt in (1e-3, 5e-4):
        case = scene(make, anvil, ball, t_end=0.4, every=0.01, dt=dt)
        case |= {"gravity": {"acceleration": [0, 0, -g]}}
        case["contact"] |= {"friction": 0.0, "overlap": 0.01}
        with particlerb.run(case) as t:
            y = A / (1 - r * r) * (np.sin(drive * t.time) - r * np.sin(omega * t.time))
            off.append(np.abs(t.position[:, 1, 2] - t.position[0, 1, 2] - y).max())
            error.append(np.abs(t.ledger.energy_error).max())
            assert np.ptp(t.ledger.work) > 0.05
    assert off[0] < 2e-5
    assert np.log2([off[0] / off[1], error[0] / error[1]]) == pytest.approx(2.0, abs=0.2)


@pytest.mark.compiled
def test_a_wheel_that_spins_drags_a_ball_by_friction(make):
    """It pushes the ball with μ N while they slide; half of what it gives is lost."""
    mu, spin, R, m, g = 0.3, 20.0, 0.5, 2.0, 9.81
    wheel = make.sphere("wheel", R, position=[0, 0, 0], motion={"angular_velocity": [0, spin, 0]})
    ball = make.sphere(position=[0, 0, 0.6 - m * g / K], mass=m)
    case = scene(make, wheel, ball, t_end=0.02, every=0.01, dt=1e-4)
    case |= {"gravity": {"acceleration": [0, 0, -g]}}
    case["contact"] = make.hooke(K, 0.5, mu, overlap=0.01)
    with particlerb.run(case) as t:
        assert t.velocity[-1, 1, 0] == pytest.approx(mu * g * 0.02, rel=0.02)
        slid = mu * m * g * spin * (R - 0.5 * m * g / K) * 0.02  # work of the wheel
        gained = t.ledger.kinetic_energy[-1]
        assert 0.0 < gained < slid
        assert t.ledger.work[-1] == pytest.approx(gained, rel=2e-2)
        assert np.abs(t.ledger.energy_error).max() < 1e-5
        assert np.abs(t.ledger.angular_momentum_error).max() < 1e-13


def stirred(make, every=0.1, threads=1):
    """A paddle that goes round in a crowd of balls in a box."""
    body = make.sphere("ball", 0.04, count=60, mass=0.1)
    body["place"] = {"type": "grid", "spacing": 0.1, "n": [5, 4, 3], "origin": [0, 0, 0.26]}
    motion = {"angular_velocity": [0, 0, 6.0], "centre": [0, 0, 0]}
    motion["oscillation"] = {"amplitude": [0, 0, 0.02], "frequency": 4.0, "phase": 0.0}
    shape = {"type": "points", "mass": 1.0, "radius": 0.03}
    shape["position"] = [[0.05 * k, 0, 0] for k in range(-4, 5)]
    stick = {"name": "stick", "shape": shape, "position": [0, 0, 0.07], "motion": motion}
    box = {"type": "box", "name": "bin", "lower": [-0.3, -0.3, 0], "upper": [0.3, 0.3, 9]}
    case = scene(make, body, stick, t_end=0.6, every=every, dt=2e-4, wall=[box])
    case["run"] |= {"threads": threads}
    case["gravity"] = {"acceleration": [0, 0, -9.81]}
    case["contact"] = make.hooke(K, 0.5, 0.5)
    return case


@pytest.mark.compiled
def test_a_stirrer_gives_what_friction_takes_and_nothing_else_changes_the_motion(make, monkeypatch):
    def ran(**keys):
        with particlerb.run(stirred(make, **keys)) as t:
            return t.position[-1], t.linear_momentum[-1], t.ledger

    x, p, ledger = ran()
    assert ledger.work.min() < -0.1
    assert np.abs(ledger.energy_error).max() < 5e-3 * np.abs(ledger.work).max()
    assert np.abs(ledger.linear_momentum_error).max() < 1e-11
    for other in (ran(every=0.033), ran(every=0.6)):
        assert np.array_equal(x, other[0])
        assert np.array_equal(p, other[1])
    monkeypatch.setattr(contact_motion, "WORTH_THREADS", 0.0)
    assert np.array_equal(x, ran(threads=2)[0])


def test_bodies_of_a_block_go_round_one_centre_together(make):
    """A plate of spheres stays a plate; each about its own centre without one."""
    plate = make.sphere("plate", 0.05, count=4, motion={"angular_velocity": [0, 0, 2.0]})
    plate["place"] = {"type": "grid", "spacing": 0.1, "n": [2, 2, 1]}
    ball = make.sphere("ball", position=[0, 0, 5])
    with particlerb.run(scene(make, plate, ball)) as t:
        assert np.array_equal(t.position[-1], t.position[0])
    plate["motion"]["centre"] = [1.0, 0.0, 0.0]
    with particlerb.run(scene(make, plate, ball)) as t:
        turn = Rotation.from_rotvec([0, 0, 0.4])
        arms = t.position[0, :4] - [1.0, 0, 0]
        assert t.position[-1, :4] - [1.0, 0, 0] == pytest.approx(turn.apply(arms), abs=1e-14)


@pytest.mark.plain
def test_a_file_with_a_driven_body_is_whole(make, tmp_path):
    """Summed again, the ledger counts no bodies that are held either, and lids beside bodies."""
    bodies = [
        make.sphere("wheel", position=[0, 0, 0], motion={"angular_velocity": [0, 0, 3.0]}),
        make.sphere("post", position=[0, 1, 0], fixed=True),
        make.sphere("ball", position=[0.3, 0, 0], velocity=[0.0, 1.0, 0.0]),
    ]
    bodies[0]["motion"]["velocity"] = [0.1, 0, 0]
    lid = make.plane([0, 0, -1], "lid", point=[0, 0, 5.0])
    lid["piston"] = {"mass": 1.0, "axis": [0, 0, 1], "load": 3.0}
    with particlerb.run(scene(make, *bodies, wall=[lid]), tmp_path / "driven.h5") as t:
        assert np.ptp(t.ledger.kinetic_energy) > 0.1  # of the lid
        assert [found.words for found in verify(t) if not found.is_whole] == []


def test_the_displaced_place_counts_at_the_start(make):
    """With a phase of 90° it stands at its amplitude, where it overlaps a ball."""
    swing = {"amplitude": [0.1, 0, 0], "frequency": 1.0, "phase": 0.5 * math.pi}
    bat = make.sphere("bat", position=[0, 0, 0], motion={"oscillation": swing})
    case = scene(make, bat, make.sphere("ball", position=[0.25, 0, 0]))
    with pytest.raises(CaseError, match=r"bat and ball by 0\.05 m"):
        particlerb.run(case)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"fixed": True}, r"body\[0\]\.fixed.*given beside motion"),
        ({"velocity": [1, 0, 0]}, r"body\[0\]\.velocity.*has its velocities in motion"),
        ({"contact": False}, r"body\[0\]\.contact.*driven body that nothing touches"),
        ({"motion": {"velocty": [1, 0, 0]}}, r"body\[0\]\.motion\.velocty"),
        ({"motion": {"oscillation": {"amplitude": [1, 0, 0]}}}, r"oscillation\.frequency.*missing"),
    ],
)
def test_what_a_driven_body_cannot_have_is_an_error_at_its_key(make, keys, message):
    bat = make.sphere("bat", motion={"velocity": [1, 0, 0]}) | keys
    with pytest.raises(CaseError, match=message):
        load(scene(make, bat, make.sphere("ball", position=[1, 0, 0])))


def test_no_force_names_a_driven_body_and_no_attraction(make):
    bat = make.sphere("bat", motion={"velocity": [1, 0, 0]})
    case = scene(make, bat, make.sphere("ball", position=[1, 0, 0]))
    case["force"] = [make.push([1, 0, 0], body="bat")]
    case["attraction"] = {}
    with pytest.raises(CaseError) as found:
        load(case)
    reasons = [problem.reason for problem in found.value.problems]
    assert "bat is driven: no force acts on it" in reasons
    assert "bat is driven: it takes no part in attraction" in reasons
    without = scene(make, bat, make.sphere("ball", position=[1, 0, 0]))
    del without["contact"]
    with pytest.raises(CaseError, match=r"motion.*a driven body is an obstacle of \[contact\]"):
        load(without)
