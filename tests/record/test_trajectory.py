"""Reading a file back: arrays against a naive computation, and files that are no trajectories."""

import pickle

import h5py
import numpy as np
import pytest

import particlerb
from particlerb.case.to_system import to_system
from particlerb.model.state import as_frame, initial_state, omega_world
from particlerb.record.trajectory import Trajectory, TrajectoryError

SPIN = {"angular_velocity": [1.0, 0.4, -0.7], "velocity": [0.3, 0.1, -0.2]}
R3 = np.random.default_rng(3)
POSITION, MASS = R3.standard_normal((5, 3)), R3.uniform(0.5, 2.0, 5)


def odd_body(name="odd", **keys):
    """Points anywhere: principal axes that are not the body's axes, a com that is not zero."""
    shape = {"type": "points", "position": POSITION.tolist(), "mass": MASS.tolist()}
    return {"name": name, "shape": shape, "orientation": [0.8, 0, 0.6, 0], **SPIN} | keys


@pytest.fixture(scope="module")
def written(make, tmp_path_factory):
    """A file with bodies of several kinds."""
    rod = {"type": "rod", "length": 1.0, "n": 3}
    bodies = [
        odd_body(),
        make.body("pair", count=2, place={"type": "grid", "spacing": 2.0}, **SPIN),
        make.body("rod", shape=rod, angular_velocity=[0.5, 0, 0], position=[1, 2, 3]),
        make.body("point", [0, 0, 0], velocity=[0, 0, 1.0]),
    ]
    path = tmp_path_factory.mktemp("trajectory") / "run.h5"
    particlerb.run(make.case(*bodies, gravity={"acceleration": [0, 0, -9.8]}), path).close()
    return path


def test_arrays_have_the_customary_shapes(written):
    with particlerb.open(written) as t:
        assert (t.n_frames, t.n_bodies) == (11, 5)
        assert t.time == pytest.approx(np.arange(11) / 10, abs=0)
        for name in ("position", "linear_momentum", "angular_momentum", "velocity"):
            assert getattr(t, name).shape == (11, 5, 3)
        assert t.angular_velocity.shape == (11, 5, 3)
        assert t.orientation.shape == (11, 5, 4)
        assert t.energy.shape == (11,)
        assert list(t.names) == ["odd", "pair[0]", "pair[1]", "rod", "point"]
        assert t.fields == ["position", "orientation", "linear_momentum", "angular_momentum"]
        with pytest.raises(KeyError, match="no observable kinetic; there are kinetic_energy, "):
            t.observable("kinetic")
        assert t.read("position", slice(2, None, 3)).shape == (3, 5, 3)
        assert (t.read("position", slice(-1, None)) == t.position[-1:]).all()
        with pytest.raises(KeyError, match="velocity was not recorded: list it in"):
            t.read("velocity")
        with pytest.raises(KeyError, match='no field velocty; did you mean "velocity"'):
            t.read("velocty")
        for name in ("time", "energy", "names"):
            with pytest.raises(KeyError, match=f"it is in `trajectory.{name}`"):
                t.read(name)
        with pytest.raises(KeyError, match=r'it is in `trajectory.observable\("work"\)`'):
            t.read("work")
        assert t.parameter("case_resolved")["run"]["t_end"] == 1.0


def test_a_closed_trajectory_says_so_and_is_read_again_when_it_is_refreshed(written, make):
    on_disk, kept = particlerb.open(written), particlerb.run(make.case(odd_body()))
    for trajectory in (on_disk, kept):
        trajectory.close()
        for name in ("position", "energy", "names", "case"):
            with pytest.raises(TrajectoryError, match=r"^the trajectory is closed: open it again"):
                getattr(trajectory, name)
        assert repr(trajectory) == "<Trajectory: frames: 11, closed>"
    assert on_disk.refresh() == 11
    assert on_disk.position.shape == (11, 5, 3)
    on_disk.close()


def test_a_trajectory_is_pickled_as_its_file(written, make):
    with particlerb.open(written) as t, pickle.loads(pickle.dumps(t)) as again:
        assert np.array_equal(again.position, t.position)
    with pytest.raises(TypeError, match="in memory cannot be pickled: give its run an output file"):
        pickle.dumps(particlerb.run(make.case(odd_body())))


def test_values_against_a_naive_computation(written, make):
    """From the particles: P = Σ m v, L = Σ m r × v, energy, with v = V + ω × r."""
    with particlerb.open(written) as t:
        table = t.file["bodies/particles"]
        offset, kind = table["offset"][:], t.file["bodies/kind"][:]
        mass = t.file["particles/trajectory/mass"][:]
        assert t.velocity == pytest.approx(t.linear_momentum / mass[:, None], rel=3e-16)
        for f in (0, 4, 10):
            energy, first, points = 0.0, 0, t.particle_positions(f)
            for b in range(t.n_bodies):
                own = slice(offset[kind[b]], offset[kind[b] + 1])
                m, local = table["mass"][own], table["position"][own]
                r = make.rotation(t.orientation[f, b]).apply(local)
                x = points[first : first + len(m)]
                first += len(m)
                assert x == pytest.approx(t.position[f, b] + r, abs=1e-14)
                v = t.velocity[f, b] + np.cross(t.angular_velocity[f, b], r)
                assert m @ v == pytest.approx(t.linear_momentum[f, b], abs=1e-13)
                spin = (m[:, None] * np.cross(r, v)).sum(axis=0)
                assert spin == pytest.approx(t.angular_momentum[f, b], abs=1e-13)
                energy += 0.5 * m @ (v * v).sum(axis=1) + 9.8 * m @ x[:, 2]
                turned = make.rotation(t.orientation[f, b]).inv().apply(t.angular_velocity[f, b])
                assert t.omega_body(b)[f] == pytest.approx(turned, abs=1e-14)
            assert first == len(points)
            assert t.energy[f] == pytest.approx(energy, rel=1e-13)


def test_momentum_sizes_are_the_scales_of_the_drifts(written):
    with particlerb.open(written) as t:
        linear = np.linalg.norm(t.linear_momentum, axis=2).sum(axis=1).max()
        orbit = np.cross(t.position, t.linear_momentum)
        spin = np.linalg.norm(orbit, axis=2) + np.linalg.norm(t.angular_momentum, axis=2)
        assert t.momentum_sizes() == pytest.approx((linear, spin.sum(axis=1).max()))


def test_first_frame_is_what_the_case_says(written):
    """Also for a body whose principal axes are turned: nobody outside sees the rotor frame."""
    with particlerb.open(written) as t:
        assert t.orientation[0, 0] == pytest.approx([0.8, 0, 0.6, 0], abs=5e-16)
        assert t.angular_velocity[0, 0] == pytest.approx(SPIN["angular_velocity"], abs=5e-15)
        assert t.velocity[0, 0] == pytest.approx(SPIN["velocity"], abs=1e-15)
        com = MASS @ POSITION / MASS.sum()
        assert t.particle_positions(0)[:5].mean(axis=0) == pytest.approx(
            _turned(POSITION - com).mean(axis=0)
        )


def _turned(vectors):
    """Vectors turned by the quaternion (0.8, 0, 0.6, 0), by hand: about y by 2 atan(0.75)."""
    c, s = 0.8**2 - 0.6**2, 2 * 0.8 * 0.6
    return vectors @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T


def test_frames_are_counted_from_either_end(written):
    with particlerb.open(written) as t:
        assert (t.particle_positions(-1) == t.particle_positions(10)).all()
        for frame in (11, -12):
            with pytest.raises(IndexError):
                t.particle_positions(frame)


def test_bodies_are_chosen_by_numbers_or_by_a_mask(written):
    with particlerb.open(written) as t:
        every, n = t.position, t.n_bodies
        mask = np.arange(n) % 2 == 1
        assert n > 2
        assert np.array_equal(t.read("position", bodies=mask), every[:, mask])
        assert np.array_equal(t.read("position", bodies=[n - 1, 0]), every[:, [n - 1, 0]])
        assert t.read("position", bodies=[]).shape == (t.n_frames, 0, 3)
        for wrong in ([n], mask[1:]):
            with pytest.raises(IndexError):
                t.read("position", bodies=wrong)


def test_one_frame_is_read_by_its_number(written):
    with particlerb.open(written) as t:
        every, last = t.position, t.n_frames - 1
        for frame in (0, last, np.int64(1), -1, -t.n_frames):
            assert np.array_equal(t.read("position", frame), every[frame])
        assert np.array_equal(t.read("position", -1, bodies=[1, 0]), every[last, [1, 0]])
        for wrong in (last + 1, -last - 2):
            with pytest.raises(IndexError, match=f"no frame {wrong}: the file has {last + 1} fra"):
                t.read("position", wrong)
        with pytest.raises(IndexError, match=f"no body 99: the file has {t.n_bodies} bodies"):
            t.read("position", 0, bodies=99)


@pytest.mark.parametrize("frames", [0.5, "a", (0, 1), slice(None, None, -1), slice(0, 3, 0)])
def test_frames_are_a_slice_that_goes_forward(written, frames):
    with particlerb.open(written) as t, pytest.raises((TypeError, ValueError), match="slice"):
        t.read("position", frames)


@pytest.mark.parametrize("bodies", ["odd", [0.0], 1.5, [None]])
def test_bodies_are_numbers(written, bodies):
    with particlerb.open(written) as t, pytest.raises(TypeError, match="must be numbers of bodies"):
        t.read("position", bodies=bodies)


def test_uncommitted_frames_do_not_count(written, tmp_path):
    copy = tmp_path / "copy.h5"
    copy.write_bytes(written.read_bytes())
    with h5py.File(copy, "a") as file:
        file.attrs.modify("n_frames", np.int64(4))
    with particlerb.open(copy) as t, particlerb.open(written) as whole:
        assert len(t.time) == len(t.position) == len(t.energy) == len(t.omega_body(0)) == 4
        assert (t.angular_velocity == whole.angular_velocity[:4]).all()
        with pytest.raises(IndexError):
            t.particle_positions(4)


# State, rotor frame, body frame


def test_state_and_back(make):
    """What the user gives, as a state, as a frame."""
    rng = np.random.default_rng(2)
    bodies = [odd_body(str(k)) for k in range(4)] + [make.body("m")]
    scene = to_system(make.case(*bodies))
    q = rng.standard_normal((5, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    x, v, w = rng.standard_normal((3, 5, 3))
    state = initial_state(scene.bodies, x, q, v, w)
    frame = as_frame(scene.bodies, state)
    assert (frame.position[0] == x).all()
    assert frame.orientation[0] == pytest.approx(q, abs=1e-15)  # with its sign
    assert frame.linear_momentum[0] == pytest.approx(scene.bodies.mass[:, None] * v, abs=0)
    np.testing.assert_allclose(omega_world(scene.bodies, state).T, w, atol=1e-14)
    assert np.abs(np.linalg.norm(state.q, axis=0) - 1).max() < 3e-16
    r = POSITION - MASS @ POSITION / MASS.sum()
    r = make.rotation(q[1]).apply(r)
    L = (MASS[:, None] * np.cross(r, np.cross(w[1], r))).sum(axis=0)
    assert frame.angular_momentum[0, 1] == pytest.approx(L, abs=1e-13)


@pytest.mark.parametrize("start", [[1.0, 0, 0, 0], [-0.6, 0, 0, -0.8]])
@pytest.mark.parametrize("method", ["exact", "strang"])
def test_recorded_orientation_is_continuous_over_many_turns(make, start, method):
    """q of a body that turns about z by 40 turns is cos φ/2 all the way, without jumps."""
    body = make.body(angular_velocity=[0, 0, 2 * np.pi], orientation=start)
    found = make.arrays(make.case(body, t_end=40.0, every=0.125, method=method, dt=0.01))
    half = np.pi * found.time
    w, z = start[0], start[3]
    expected = np.zeros((len(half), 4))
    expected[:, 0] = w * np.cos(half) - z * np.sin(half)
    expected[:, 3] = w * np.sin(half) + z * np.cos(half)
    assert found.orientation[:, 0] == pytest.approx(expected, abs=1e-11)


# Files that are none


def foreign(path, **attributes):
    with h5py.File(path, "w") as file:
        file["data"] = np.arange(3)
        file.attrs.update(attributes)


def test_a_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.h5: no such file"):
        particlerb.open(tmp_path / "none.h5")
    with pytest.raises(FileNotFoundError, match=r"no such file$"):  # no disk takes it with .h5
        particlerb.open(tmp_path / ("n" * 253))


@pytest.mark.parametrize("content", [b"", b"title = 'a case'\n", b"\x89HDF\r\n\x1a\n" + b"\0" * 99])
def test_a_file_that_is_no_hdf5(tmp_path, content):
    path = tmp_path / "file.h5"
    path.write_bytes(content)
    with pytest.raises(TrajectoryError, match="is not a readable HDF5 file"):
        particlerb.open(path)


def test_a_folder(tmp_path):
    with pytest.raises(TrajectoryError, match="is not a regular file"):
        particlerb.open(tmp_path)


@pytest.mark.parametrize(
    "attributes",
    [
        {},
        {"schema": [2, 0]},
        {"schema": [2, 0], "n_frames": 1},
        {"schema": 1, "n_frames": 1},
        {"schema": [1], "n_frames": 1},
        {"schema": np.empty(0, dtype=int), "n_frames": 1},
        {"schema": "one", "n_frames": 1},
        {"schema": [2, 0], "n_frames": "many"},
        {"schema": [2, 0], "n_frames": [1, 2]},
    ],
)
def test_a_foreign_hdf5_file(tmp_path, attributes):
    path = tmp_path / "foreign.h5"
    foreign(path, **attributes)
    with pytest.raises(TrajectoryError, match="is not a trajectory of particlerb"):
        particlerb.open(path)
    path.unlink()  # it was closed


@pytest.mark.parametrize("mass", ["group", "number"])
def test_an_hdf5_file_with_something_else_for_the_masses(tmp_path, mass):
    path = tmp_path / "foreign.h5"
    foreign(path, schema=[2, 0], n_frames=1)
    with h5py.File(path, "a") as file:
        if mass == "group":
            file.create_group("particles/trajectory/mass")
        else:
            file["particles/trajectory/mass"] = 1.0
    with pytest.raises(TrajectoryError, match="is not a trajectory of particlerb"):
        particlerb.open(path)


def test_another_schema_is_refused(written, tmp_path):
    copy = tmp_path / "copy.h5"
    copy.write_bytes(written.read_bytes())
    for version, age in (([3, 3], "a newer"), ([1, 0], "an older")):
        with h5py.File(copy, "a") as file:
            file.attrs["schema"] = version
        words = rf"has schema {version[0]}\.{version[1]}: {age} particlerb .* reads 2\.x"
        with pytest.raises(TrajectoryError, match=words):
            particlerb.open(copy)
    with h5py.File(copy, "a") as file:
        file.attrs["schema"] = [2, 7]  # a newer minor one adds only
    particlerb.open(copy).close()


@pytest.mark.parametrize("share", [0.05, 0.5, 0.99])
def test_a_truncated_file(written, tmp_path, share):
    data = written.read_bytes()
    path = tmp_path / "cut.h5"
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(TrajectoryError):
        particlerb.open(path)


def test_context_manager_closes(written):
    with particlerb.open(written) as t:
        assert isinstance(t, Trajectory)
        assert t.file
    assert not t.file


def test_what_a_run_does_not_observe_is_named_beside_what_it_does():
    body = {"name": "a", "shape": {"type": "sphere", "radius": 0.1}, "mass": 1.0}
    with particlerb.run({"run": {"t_end": 1.0, "every": 1.0}, "body": [body]}) as t:
        for name in ("friction_work", "wall_force"):
            with pytest.raises(KeyError, match=f"no observable {name}; there are kinetic") as found:
                t.observable(name)
            assert "push_out_work" not in str(found.value)
        with pytest.raises(TrajectoryError, match="run in memory is not a"):
            t.table("bodies/gone", "f", (None,))
