"""Mass properties: identities, symmetries, classes, exact sums; closed forms are in test_shapes.

u = 2^-53 is the unit roundoff. Every product m r r is rounded four times and sums are compensated,
so that an element of the tensor is within 4 u tr I of the exact one.
"""

import math

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from particlerb.geometry import shapes, sums
from particlerb.geometry.mass_properties import mass_properties
from particlerb.geometry.particles import concatenate, one_kind, transformed, united
from particlerb.rotors.rotor_class import ASYMMETRIC, NAMES, POINT, ROD, SPHERE, SYMMETRIC

U = 2.0**-53
REGULAR = [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]
IDENTITY = np.eye(3)
ORIGIN = np.zeros(3)
checks = settings(deadline=None, max_examples=40, derandomize=True)


@st.composite
def particle_sets(draw, largest=8):
    """Particles on a grid of 2^-20, so that a shift by whole numbers is exact; some massless."""
    n = draw(st.integers(1, largest))
    whole = st.integers(-(2**20), 2**20)
    position = draw(arrays(np.int64, (n, 3), elements=whole)) / 2.0**20
    mass = draw(arrays(np.float64, n, elements=st.sampled_from([0.0, 1e-3, 0.1, 1.0, 3.0, 1e3])))
    radius = draw(arrays(np.float64, n, elements=st.sampled_from([0.0, 0.0, 0.1, 2.0])))
    mass[0] = max(mass[0], 0.1)
    return one_kind(position, mass, radius)


@st.composite
def rotations(draw):
    """Rotation matrix of a random unit quaternion."""
    q = np.random.default_rng(draw(st.integers(0, 2**32 - 1))).standard_normal(4)
    w, x, y, z = q / np.linalg.norm(q)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return IDENTITY + 2 * w * skew + 2 * skew @ skew


def random_set(seed, n=12):
    rng = np.random.default_rng(seed)
    return one_kind(rng.standard_normal((n, 3)), rng.random(n) + 0.1)


def shifted(particles, translation):
    return particles._replace(position=particles.position + np.asarray(translation, float))


def tensor_of(particles):
    return mass_properties(particles).inertia_tensor[0]


def gyration(properties, k=0):
    return math.sqrt(0.5 * np.trace(properties.inertia_tensor[k]) / properties.mass[k])


# Exact sums


@checks
@given(particle_sets(), st.sampled_from([0.0, 1.0, 1e3, 1e6, 1e9]))
def test_sums_equal_rational_arithmetic_at_any_offset(particles, offset):
    particles = shifted(particles, [offset, -0.7 * offset, 0.3 * offset])
    found = mass_properties(particles)
    tensor, centre = naive.inertia_tensor(particles), naive.com(particles)
    trace = float(tensor[0][0] + tensor[1][1] + tensor[2][2])
    bound = U * (np.abs(found.com[0]).max() + 4 * gyration(found))
    assert naive.largest_difference(naive.mass(particles), found.mass[0]) <= U * found.mass[0]
    assert naive.largest_difference(centre, found.com[0]) <= bound
    assert naive.largest_difference(tensor, found.inertia_tensor[0]) <= 4 * U * trace


@pytest.mark.parametrize("seed", range(5))
def test_offset_of_a_million_sizes_costs_only_the_rounding_of_positions(seed):
    """Rounding p to u |p| moves I by 2 u Σ m |r| |p| <= 2 u M g |p| on each of three axes."""
    here = random_set(seed)
    there = shifted(here, [1e6, -2e6, 5e5])
    found, moved = mass_properties(here), mass_properties(there)
    rounding = 6 * U * found.mass[0] * gyration(found) * np.linalg.norm(moved.com[0])
    difference = np.abs(found.inertia_tensor - moved.inertia_tensor).max()
    assert 0.0 < difference <= rounding


@checks
@given(particle_sets())
def test_first_moment_about_the_com_is_zero(particles):
    found = mass_properties(particles)
    first = [
        math.fsum(particles.mass * (particles.position[:, k] - found.com[0, k])) for k in range(3)
    ]
    size = np.abs(found.com[0]).max() + 4 * gyration(found)
    assert np.abs(first).max() <= 4 * U * found.mass[0] * size


@pytest.mark.parametrize("seed", range(4))
def test_order_of_particles_changes_an_ulp_at_most(seed):
    """Without the compensation 2000 particles would change about √2000 u."""
    rng = np.random.default_rng(seed)
    n = 2000
    position, mass = rng.standard_normal((n, 3)) + 5.0, 10.0 ** rng.uniform(-3, 3, n)
    order = rng.permutation(n)
    found = mass_properties(one_kind(position, mass))
    mixed = mass_properties(one_kind(position[order], mass[order]))
    difference = np.abs(found.inertia_tensor - mixed.inertia_tensor).max()
    assert difference <= 2 * U * np.trace(found.inertia_tensor[0])
    assert np.abs(found.com - mixed.com).max() <= 4 * U * 5.0


# Identities of mechanics


@checks
@given(particle_sets(), st.lists(st.integers(-1000, 1000), min_size=3, max_size=3))
def test_translation_moves_the_com_and_nothing_else(particles, shift):
    found, moved = mass_properties(particles), mass_properties(shifted(particles, shift))
    trace = np.trace(found.inertia_tensor[0])
    assert np.abs(moved.inertia_tensor - found.inertia_tensor).max() <= 8 * U * trace
    assert np.abs(moved.com - shift - found.com).max() <= 4 * U * (1000 + gyration(found))


@checks
@given(particle_sets(), rotations())
def test_tensor_turns_with_the_particles(particles, R):
    """I' = R I Rᵀ; R p is rounded to 3 u |p|, and 3 × 3 products twice more."""
    found = mass_properties(particles)
    turned = mass_properties(transformed(particles, R, ORIGIN))
    expected = R @ found.inertia_tensor[0] @ R.T
    spread = gyration(found) * (gyration(found) + np.linalg.norm(found.com[0]))
    bound = 48 * U * found.mass[0] * spread
    assert np.abs(turned.inertia_tensor[0] - expected).max() <= bound
    assert np.abs(turned.moments - found.moments).max() <= 2 * bound


@checks
@given(particle_sets(), particle_sets())
def test_parallel_axis_theorem_joins_two_sets(a, b):
    """I = Σ_k (I_k + M_k (|d_k|² 1 − d_k d_kᵀ)) with d_k from the common com."""
    parts = mass_properties(concatenate([a, b]))
    whole = mass_properties(united(concatenate([a, b])))
    expected = np.zeros((3, 3))
    for k in range(2):
        d = parts.com[k] - whole.com[0]
        expected += parts.inertia_tensor[k]
        expected += parts.mass[k] * (d @ d * IDENTITY - np.outer(d, d))
    assert np.abs(whole.inertia_tensor[0] - expected).max() <= 32 * U * whole.mass[0] * 12.0


@checks
@given(particle_sets(), rotations())
def test_principal_frame_is_right_handed_and_gives_the_tensor_back(particles, R):
    found = mass_properties(transformed(particles, R, ORIGIN))
    tensor, moments, V = found.inertia_tensor[0], found.moments[0], found.axes[0]
    offset = np.linalg.norm(found.com[0]) / (gyration(found) or 1.0)
    assert np.abs(V.T @ V - IDENTITY).max() <= 8 * U
    assert np.linalg.det(V) == pytest.approx(1.0, abs=16 * U)
    back = (V * moments) @ V.T
    assert np.abs(back - tensor).max() <= 32 * U * (1 + offset) * np.trace(tensor)


@checks
@given(particle_sets())
def test_tensor_is_symmetric_and_moments_obey_the_triangle_inequality(particles):
    found = mass_properties(particles)
    I1, I2, I3 = found.moments[0]
    tensor = found.inertia_tensor[0]
    assert (tensor == tensor.T).all()
    assert 0.0 <= I1 <= I2 <= I3
    assert I1 + I2 - I3 >= -16 * U * I3


@pytest.mark.parametrize(
    ("length", "mass"),
    [(1e-9, 1e-27), (1e30, 1e30), (1e-30, 1e-30), (1e100, 1e-100), (1e-100, 1e100),
     (1e100, 1e100), (1e-100, 1e-100)],
)  # fmt: skip
def test_units_change_nothing_but_the_unit(length, mass):
    here = random_set(3)
    there = here._replace(position=here.position * length, mass=here.mass * mass)
    found, scaled = mass_properties(here), mass_properties(there)
    ratio = scaled.inertia_tensor / length / mass / length / found.inertia_tensor
    assert np.abs(ratio - 1.0).max() <= 64 * U
    assert np.abs(scaled.moments / length / mass / length / found.moments - 1).max() <= 64 * U
    assert scaled.rotor_class == found.rotor_class


def test_powers_of_two_scale_to_the_bit():
    here = random_set(4)
    there = here._replace(position=here.position * 2.0**-200, mass=here.mass * 2.0**150)
    found, scaled = mass_properties(here), mass_properties(there)
    assert (scaled.moments == found.moments * 2.0**-250).all()
    assert (scaled.axes == found.axes).all()


def test_radius_adds_two_fifths_m_r_squared():
    point = random_set(5)
    balls = point._replace(radius=np.linspace(0.0, 2.0, len(point.mass)))
    added = 0.4 * np.sum(balls.mass * balls.radius**2)
    expected = tensor_of(point) + added * IDENTITY
    assert np.allclose(tensor_of(balls), expected, rtol=8 * U, atol=0.0)


def test_massless_particles_weigh_nothing_however_far():
    here = random_set(6)
    ghost = one_kind([[1e200, 0.0, -3.0]], [0.0], [7.0])
    found = tensor_of(united(concatenate([ghost, here])))  # in other lanes of the sum
    assert np.abs(found - tensor_of(here)).max() <= 2 * U * np.trace(found)


def test_kinds_do_not_see_each_other():
    sets = [random_set(1, 5), shapes.box([1, 2, 3], 1e40), shapes.rod(1e-20, 1e-30), random_set(2)]
    together = mass_properties(concatenate(sets))
    for k, alone in enumerate(sets):
        for a, b in zip(together, mass_properties(alone), strict=True):
            assert (a[k] == b[0]).all()


# Rotor classes

CLASSES = {
    "point": (one_kind([[0.1, 0.2, 0.3]] * 3, [1.0, 0.1, 7.0]), POINT),
    "dumbbell": (one_kind([[0, 0, 0], [0, 0, 1]], [1.0, 1e-9]), ROD),
    "rod": (shapes.rod(3.0, 1.0), ROD),
    "exact rod": (shapes.rod(3.0, 1.0, arrangement="exact"), ROD),
    "cube": (shapes.box([1, 1, 1], 2.0, 6), SPHERE),
    "exact cube": (shapes.box([1, 1, 1], 2.0, arrangement="exact"), SPHERE),
    "exact ball": (shapes.ball(2.0, 1.0, arrangement="exact"), SPHERE),
    "ball": (shapes.ball(2.0, 1.0, n=5), SPHERE),
    "thin shell": (shapes.shell(2.0, 1.0, n=3), SPHERE),
    "tetrahedron": (shapes.tetrahedron(REGULAR, 1.0, n=4), SPHERE),
    "exact tetrahedron": (shapes.tetrahedron(REGULAR, 1.0, arrangement="exact"), SPHERE),
    "single ball": (one_kind([[0.1, 0.2, 0.3]], [1.0], [0.1]), SPHERE),
    "cylinder": (shapes.cylinder(1.0, 1.5, 1.0, n=6), SYMMETRIC),
    "torus": (shapes.torus(1.0, 0.4, 1.0, n=8), SYMMETRIC),
    "disc": (shapes.moments([1, 1, 2], 1.0), SYMMETRIC),
    "needle": (shapes.moments([1e-10, 1, 1], 1.0), SYMMETRIC),
    "flat needle": (shapes.moments([1e-10, 1, 1 - 1e-10], 1.0), ASYMMETRIC),
    "brick": (shapes.box([1, 2, 3], 1.0, 3), ASYMMETRIC),
    "lamina": (shapes.moments([1, 2, 3], 1.0), ASYMMETRIC),
    "nearly a ball": (shapes.moments([1, 1, 1 + 1e-13], 1.0), SYMMETRIC),
}


TOO_COARSE = {("flat needle", 1e3), ("nearly a ball", 1e3)}  # rounding hides the difference
PLACED = [(n, d) for n in CLASSES for d in (0.0, 1.0, 1e3) if (n, d) not in TOO_COARSE]


@pytest.mark.parametrize(("name", "offset"), PLACED)
def test_class_survives_turning_and_moving(name, offset):
    particles, expected = CLASSES[name]
    rng = np.random.default_rng(7)
    copies = [particles]
    for _ in range(20):
        R, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        copies.append(transformed(particles, R, offset * rng.standard_normal(3)))
    found = mass_properties(concatenate(copies))
    assert [NAMES[c] for c in found.rotor_class] == [NAMES[expected]] * 21


EQUAL = {  # what must hold to the bit
    POINT: lambda I1, I2, I3: I1 == I2 == I3 == 0.0,
    ROD: lambda I1, I2, I3: 0.0 == I1 < I2 == I3,
    SPHERE: lambda I1, I2, I3: 0.0 < I1 == I2 == I3,
    SYMMETRIC: lambda I1, I2, I3: (I1 == I2) != (I2 == I3),
    ASYMMETRIC: lambda I1, I2, I3: I1 < I2 < I3,
}


@pytest.mark.parametrize("name", CLASSES)
def test_moments_are_equal_or_zero_to_the_bit(name):
    particles, expected = CLASSES[name]
    rng = np.random.default_rng(11)
    turns = [IDENTITY, *np.linalg.qr(rng.standard_normal((20, 3, 3)))[0]]
    found = mass_properties(concatenate([transformed(particles, R, ORIGIN) for R in turns]))
    assert all(EQUAL[expected](*moments) for moments in found.moments)


def test_coincident_particles_far_away_are_a_point():
    """Sums of coordinates that agree to rounding: 0.1 + 0.2 and 0.3 differ by an ulp."""
    found = mass_properties(one_kind([[0.1 + 0.2, 1.0, 0.0], [0.3, 1.0, 0.0]], [1.0, 1.0]))
    assert found.rotor_class == POINT
    assert mass_properties(one_kind([[1e-12, 1, 0], [0, 1, 0]], [1.0, 1.0])).rotor_class == ROD


# Principal frames


def test_diagonal_tensor_keeps_the_given_axes_and_its_own_diagonal():
    found = mass_properties(shapes.moments([3.0, 1.0, 2.5], 1.0))
    assert (np.sort(np.diagonal(found.inertia_tensor[0])) == found.moments[0]).all()
    assert (np.abs(found.axes[0]) == IDENTITY[[1, 2, 0]].T).all()


def test_rounding_off_the_diagonal_does_not_turn_the_axes():
    rng = np.random.default_rng(12)
    brick = shapes.box([1.0, 2.0, 3.0], 1.0, 3)
    noise = [rng.standard_normal(brick.position.shape) * 1e-16 for _ in range(20)]
    copies = [brick._replace(position=brick.position + e) for e in noise]
    found = mass_properties(concatenate(copies))
    assert np.count_nonzero(found.inertia_tensor) > 9 * 20 / 2
    assert (np.abs(found.axes) == IDENTITY[[2, 1, 0]].T).all()


@pytest.mark.parametrize(
    ("inertia", "columns"),
    [([1, 2, 2], "xyz"), ([2, 1, 2], "yzx"), ([2, 2, 1], "zxy"),
     ([3, 3, 4], "xyz"), ([3, 4, 3], "zxy"), ([4, 3, 3], "yzx"), ([1, 1, 1], "xyz")],
)  # fmt: skip
def test_symmetric_bodies_use_the_given_axes_without_signs(inertia, columns):
    found = mass_properties(shapes.moments(inertia, 1.0))
    assert (found.axes[0] == IDENTITY[["xyz".index(c) for c in columns]].T).all()


@pytest.mark.parametrize("inertia", [[1, 2, 2], [3, 3, 4], [0, 1, 1]])
def test_symmetric_frame_does_not_jump_with_rounding(inertia):
    """An axis along (1, −1, 0) has two equally large components: its sign must not flicker."""
    R = np.array([[1, 0, 1], [-1, 0, 1], [0, math.sqrt(2), 0]]) / math.sqrt(2)
    R = R[:, [0, 1, 2]] if inertia[0] != inertia[1] else R[:, [1, 2, 0]]
    base = transformed(shapes.moments(inertia, 1.0), R, ORIGIN)
    rng = np.random.default_rng(8)
    noise = [rng.standard_normal(base.position.shape) * 1e-16 for _ in range(30)]
    copies = [base._replace(position=base.position + e) for e in noise]
    axes = mass_properties(concatenate(copies)).axes
    assert np.abs(axes - axes[0]).max() < 1e-14


def test_asymmetric_axes_point_along_their_largest_components():
    axes = mass_properties(concatenate([random_set(seed) for seed in range(40)])).axes[:, :, :2]
    largest = np.take_along_axis(axes, np.abs(axes).argmax(axis=1)[:, None], axis=1)
    assert (largest > 0.0).all()


# Errors and report


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("position", math.nan, "kind 1: a position that is not finite"),
        ("mass", -1.0, "kind 1: a mass that is negative"),
        ("mass", math.inf, "kind 1: a mass that is negative or not finite"),
        ("radius", -1.0, "kind 1: a radius that is negative"),
        ("mass", 0.0, "kind 1: no mass"),
    ],
)
def test_errors_name_the_kind(field, value, message):
    particles = concatenate([random_set(1, 4), random_set(2, 1), random_set(3, 4)])
    broken = getattr(particles, field).copy()
    broken[4] = value
    with pytest.raises(ValueError, match=message):
        mass_properties(particles._replace(**{field: broken}))


def test_empty_kind_and_overflow_are_errors():
    empty = random_set(1, 4)._replace(offset=np.array([0, 4, 4]))
    with pytest.raises(ValueError, match="kind 1: no particles"):
        mass_properties(empty)
    with pytest.raises(ValueError, match="kind 0: the inertia tensor exceeds"):
        mass_properties(shapes.box([1e120, 1e120, 1e120], 1e120))


# Sums over many particles


def test_the_lattice_cube_is_exact_to_rounding():
    for n in (1, 2, 7, 24):
        found = mass_properties(shapes.box([3.0, 3.0, 3.0], 2.0, n))
        expected = 2.0 * 9.0 / 6.0 * (1.0 - 1.0 / n**2)
        assert np.abs(found.inertia_tensor[0] - expected * np.eye(3)).max() <= 1e-15 * 3.0


@pytest.mark.compiled
def test_an_offset_of_a_million_sides_loses_only_what_the_coordinates_lose():
    particles = shapes.box([1.0, 1.0, 1.0], 1.0, 40)
    far = particles._replace(position=particles.position + np.array([1e6, -1e6, 3e5]))
    near = far._replace(position=far.position - far.position[0])  # exact: neighbours in float64
    found, expected = tensor_of(far), tensor_of(near)
    assert np.abs(found - expected).max() <= 4 * U * np.trace(expected)
    lost = np.abs(expected - np.eye(3) / 6.0 * (1 - 1 / 40**2)).max()
    assert 1e-14 < lost < 1e-10  # what the coordinates have lost: 2⁻³³ of a side each


@pytest.mark.compiled
def test_threads_do_not_change_a_bit():
    rng = np.random.default_rng(4)
    particles = one_kind(rng.normal(size=(400_001, 3)), rng.random(400_001), rng.random(400_001))
    before, found = sums.THREADS.count, []
    try:
        for count in (1, 2, 5):
            sums.THREADS.use(count)
            found.append([array.tobytes() for array in mass_properties(particles)])
    finally:
        sums.THREADS.use(before)
    assert found[0] == found[1] == found[2]


@pytest.mark.parametrize("n", [15, 16, 17, 300])
def test_a_poor_guess_from_the_sample_costs_no_digits(n):
    """One particle has almost all mass, at the end of the list and far away in place and scale."""
    rng = np.random.default_rng(n)
    position, mass = rng.normal(size=(n, 3)), rng.random(n)
    position[-1], mass[-1] = (1e9, 2e9, -1e9), 1e9
    far = position.copy()
    far[-1] *= 1e150
    for p, m in ((position, mass), (position * 1e70, mass), (far * 1e-100, mass * 1e-50)):
        particles = one_kind(p, m)
        expected = np.array(naive.inertia_tensor(particles)).astype(float)
        found = tensor_of(particles)
        assert np.abs(found - expected).max() <= 4 * U * np.trace(expected)


def test_what_is_known_of_a_set_is_nobodys_to_change():
    """Few particles are summed once; who changes what he got changes nothing for the next."""
    particles = one_kind(np.array(REGULAR, dtype=np.float64), np.array([1.0, 2.0, 3.0, 5.0]))
    first = mass_properties(particles)
    kept = [array.copy() for array in first]
    for array in first:
        np.add(array, 1, out=array)
    again = mass_properties(particles)
    heavier = mass_properties(particles._replace(mass=2.0 * particles.mass))
    assert all((one == other).all() for one, other in zip(again, kept, strict=True))
    assert heavier.mass[0] == 2.0 * kept[0][0]


@pytest.mark.parametrize("wrong", ["position", "mass"])
def test_of_several_kinds_the_wrong_particle_is_counted_in_its_own(wrong):
    position, mass = np.zeros((2, 4, 3)), np.ones((2, 4))
    {"position": position[..., 0], "mass": mass}[wrong][1, 2] = math.nan
    with pytest.raises(ValueError, match=f"{wrong} of particle 2 "):
        one_kind(position, mass)
