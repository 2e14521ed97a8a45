"""Files that are damaged, foreign, or made to harm: one clear error, and nothing elsewhere."""

import hashlib
import lzma
import os
import re
import shutil
import subprocess
import sys
import threading
from contextlib import nullcontext
from pathlib import Path

import h5py
import numpy as np
import pytest
from h5py import h5d, h5p, h5s
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import particlerb
from particlerb.case.output import FIELDS_OF_CONTACT
from particlerb.cli import main
from particlerb.model.superblocks import Range
from particlerb.record import checked_reading as checked
from particlerb.record import provenance
from particlerb.record.checksums import list_checksums
from particlerb.record.parts import Parts, note_master
from particlerb.record.schema import FIELDS, PARAMETERS
from particlerb.record.trajectory import TrajectoryError
from particlerb.record.verify import verify

pytestmark = pytest.mark.once

FUZZ = Path(__file__).parents[1] / "fuzz"
MASS = "particles/trajectory/mass"
ORIENTATION = "particles/trajectory/orientation/value"
POSITION = "particles/trajectory/position/value"


@pytest.fixture(scope="module")
def sound(make, tmp_path_factory):
    """A sound file of two bodies and five frames."""
    path = tmp_path_factory.mktemp("hostile") / "sound.h5"
    spin = {"angular_velocity": [1.0, 0.4, -0.7], "velocity": [1.0, 0, 0]}
    bodies = [make.body("a", **spin), make.body("b", position=[3, 0, 0], **spin)]
    particlerb.run(make.case(*bodies, t_end=0.4), path).close()
    return path


@pytest.fixture
def copy(sound, tmp_path, monkeypatch):
    """A copy to be harmed; it is at rest, so nobody waits for it."""
    monkeypatch.setattr(checked, "SECONDS_OF_PATIENCE", 0.0)
    return Path(shutil.copy(sound, tmp_path / "harmed.h5"))


def damaged(path: Path) -> set[str]:
    """What `verify` finds wrong."""
    with particlerb.open(path) as t:
        return {finding.what for finding in verify(t) if not finding.is_whole}


# Verification


def test_a_sound_file_is_whole(sound, capsys):
    assert damaged(sound) == set()
    assert main(["info", str(sound), "--verify"]) == 0
    out = capsys.readouterr().out
    assert f"{sound} is whole" in out
    for heading in ("schema", "versions", "machine", "git_revision", "seed", "\nplan\n", "\ncase"):
        assert heading in out


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_every_bit_of_a_frame_counts(make, tmp_path, dtype):
    """Turn one bit of one number: the checksum of that frame differs."""
    path = tmp_path / "run.h5"
    case = make.case(make.body(angular_velocity=[1, 2, 3]), t_end=0.4, output={"dtype": dtype})
    particlerb.run(case, path).close()
    assert damaged(path) == set()
    word = np.uint64 if dtype == "float64" else np.uint32
    for bit in (0, 20, 31):
        with h5py.File(path, "a") as file:
            values = file["particles/trajectory/orientation/value"]
            frame = values[3:4]
            frame.view(word)[0, 0, 1] ^= word(1 << bit)
            values[3:4] = frame
        with particlerb.open(path) as t:
            found = {f.what: f.words for f in verify(t) if not f.is_whole}
        assert found["checksums"] == "frame 3 differ from what was written"
        with h5py.File(path, "a") as file:
            frame.view(word)[0, 0, 1] ^= word(1 << bit)
            file["particles/trajectory/orientation/value"][3:4] = frame
    assert damaged(path) == set()


@pytest.mark.parametrize(
    ("path", "index", "value", "found"),
    [
        (MASS, 0, 3.0, {"tables, texts", "energy balance"}),
        ("bodies/particles/position", (0, 0), 9.0, {"tables, texts"}),
        (POSITION, (2, 0, 1), 7.0, {"checksums", "energy balance"}),
        (POSITION, (2, 0, 0), np.nan, {"checksums", "energy balance"}),
        (
            "particles/trajectory/linear_momentum/value",
            (4, 1, 2),
            1.0,
            {"checksums", "energy balance"},
        ),
        (
            "particles/trajectory/orientation/value",
            (1, 0, 3),
            2.0,
            {"checksums", "energy balance", "frames"},
        ),
        ("observables/work/value", 3, 1.0, {"checksums", "energy balance"}),
        ("observables/energy/value", 3, 1.0, {"checksums", "energy balance"}),
        ("particles/trajectory/step", 3, 9, {"times"}),
        ("particles/trajectory/time", 3, 0.0, {"times", "checksums", "steps for VTK"}),
        ("VTKHDF/Steps/Values", 2, 9.0, {"steps for VTK"}),
    ],
)
def test_what_was_changed_is_found(copy, path, index, value, found, capsys):
    with h5py.File(copy, "a") as file:
        file[path][index] = value
    assert damaged(copy) == found
    assert main(["info", str(copy), "--verify"]) == 1
    out = capsys.readouterr().out
    assert out.count("NOT OK") == len(found)
    assert f"{copy} is DAMAGED" in out


def stored(dataset):
    """Where the used part of the first piece of a dataset lies in its file: offset, bytes."""
    row = dataset.dtype.itemsize * int(np.prod(dataset.shape[1:], dtype=int))
    if not dataset.size or dataset.is_virtual:
        return None
    if dataset.chunks is None:
        return dataset.id.get_offset(), dataset.nbytes
    if not dataset.id.get_num_chunks():
        return None  # a constant, which takes no room
    return dataset.id.get_chunk_info(0).byte_offset, row * min(len(dataset), dataset.chunks[0])


def test_a_changed_byte_of_any_dataset_is_found(make, tmp_path):
    """In a file that has everything: contacts, walls, both slots of the checkpoint."""
    path, places = tmp_path / "run.h5", {}
    fields = [*FIELDS, *FIELDS_OF_CONTACT]
    balls = make.sphere(count=2, place={"type": "grid", "spacing": 0.19, "origin": [0, 0, 0.09]})
    keys = {
        "contact": make.hooke(1e3, overlap=0.5),
        "wall": [make.plane()],
        "output": {"fields": fields},
    }
    particlerb.run(make.case(balls, t_end=0.3, dt=0.01, **keys), path).close()
    assert damaged(path) == set()
    with h5py.File(path) as file:

        def note(name, found):
            if isinstance(found, h5py.Dataset) and (place := stored(found)):
                places[place[0]] = (name, place[1])

        file.visititems(note)
    assert len(places) > 70
    content = path.read_bytes()
    for offset, (name, size) in places.items():
        harmed = bytearray(content)
        harmed[offset + size // 2] ^= 1
        path.write_bytes(harmed)
        try:
            assert damaged(path), name
        except TrajectoryError:
            continue


def test_checksums_of_lists_do_not_depend_on_what_is_read_together():
    """Nor on other frames; rows of zeros count too."""
    r = np.random.default_rng(4)
    columns = [r.integers(0, 9, (7, 2)).astype(np.int32), r.standard_normal((7, 3))]
    ends = np.array([0, 2, 2, 7])
    together = list_checksums(columns, ends)
    for k, (lo, hi) in enumerate(zip([0, *ends[:-1]], ends, strict=True)):
        alone = list_checksums([c[lo:hi] for c in columns], np.array([hi - lo]))
        assert alone[0] == together[k]
    zeros = [np.zeros((3, 2))]
    assert (
        list_checksums(zeros, np.array([1, 3])) != list_checksums(zeros, np.array([2, 3]))
    ).all()


def test_a_changed_text_is_found(copy):
    with h5py.File(copy, "a") as file:
        text = file["parameters/plan"]
        text[()] = text[()].replace(b"closed", b"cloSed")
    assert damaged(copy) == {"tables, texts"}


# Links and storage elsewhere


def outside(tmp_path: Path) -> Path:
    """Another file, that must not be read or written."""
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file["secret"] = np.arange(2.0)
        file["frames"] = np.zeros((5, 2, 3))
        file.create_group("group")["mass"] = np.arange(2.0)
    return path


def external_storage(file: h5py.File, path: str, target: Path, shape: tuple[int, ...]) -> None:
    """A dataset whose bytes are those of any file."""
    file.create_dataset(path, shape, "f8", external=[(str(target), 0, h5py.h5f.UNLIMITED)])


def view_of(file: h5py.File, path: str, target: Path, name: str, shape: tuple[int, ...]) -> None:
    space = h5s.create_simple(shape)
    properties = h5p.create(h5p.DATASET_CREATE)
    properties.set_virtual(space, str(target).encode(), name.encode(), h5s.create_simple(shape))
    h5d.create(file.id, path.encode(), h5py.h5t.NATIVE_DOUBLE, space, properties)


HARM = {
    "external link": lambda f, to: f.__setitem__(MASS, h5py.ExternalLink(str(to), "/secret")),
    "soft link": lambda f, to: f.__setitem__(MASS, h5py.SoftLink("/bodies/particles/mass")),
    "external storage": lambda f, to: external_storage(f, MASS, to, (2,)),
    "virtual": lambda f, to: view_of(f, MASS, to, "secret", (2,)),
    "strings": lambda f, to: f.__setitem__(MASS, ["a", "b"]),
    "a table": lambda f, to: f.__setitem__(MASS, np.zeros(2, dtype=[("a", "f8")])),
    "complex": lambda f, to: f.__setitem__(MASS, np.zeros(2, dtype=complex)),
    "half precision": lambda f, to: f.__setitem__(MASS, np.zeros(2, dtype="f2")),
    "too many": lambda f, to: f.create_dataset(MASS, (10**15,), "f8"),
    "far too many": lambda f, to: f.create_dataset(MASS, (10**12,), "f8", chunks=(1000,)),
    "nothing": lambda f, to: f.create_dataset(MASS, data=h5py.Empty("f8")),
}


@pytest.mark.parametrize("harm", HARM)
def test_only_what_lies_in_the_file_is_read(copy, tmp_path, harm):
    other = outside(tmp_path)
    before = other.read_bytes()
    with h5py.File(copy, "a") as file:
        del file[MASS]
        HARM[harm](file, other)
    with pytest.raises(TrajectoryError, match="is not a trajectory of particlerb"):
        particlerb.open(copy)
    assert main(["info", str(copy)]) == 2
    assert other.read_bytes() == before


@pytest.mark.parametrize("kind", ["link", "group", "storage", "virtual"])
def test_frames_that_lie_elsewhere_are_not_read(copy, tmp_path, kind):
    other = outside(tmp_path)
    with h5py.File(copy, "a") as file:
        del file[POSITION if kind != "group" else "particles/trajectory/position"]
        if kind == "link":
            file[POSITION] = h5py.ExternalLink(str(other), "/frames")
        elif kind == "group":
            file["particles/trajectory/position"] = h5py.ExternalLink(str(other), "/group")
        elif kind == "storage":
            external_storage(file, POSITION, other, (5, 2, 3))
        else:
            view_of(file, POSITION, other, "frames", (5, 2, 3))
    with particlerb.open(copy) as t, pytest.raises(TrajectoryError):
        _ = t.position
    assert main(["export", str(copy), "--to", "npz", "-o", str(tmp_path / "a.npz")]) == 1
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["harmed.h5", "other.h5"]


@pytest.mark.parametrize(
    "place", ["VTKHDF/Steps/Values", "particles/trajectory/time", POSITION, "observables/new"]
)
@pytest.mark.parametrize("kind", ["link", "storage"])
def test_resume_writes_to_no_other_file(copy, tmp_path, place, kind):
    other = outside(tmp_path)
    before = other.read_bytes()
    with h5py.File(copy, "a") as file:
        if place in file:
            del file[place]
        if kind == "link":
            file[place] = h5py.ExternalLink(str(other), "/frames")
        else:
            external_storage(file, place, other, (5,))
    assert main(["resume", str(copy), "--t-end", "1.0"]) != 0
    assert other.read_bytes() == before


def test_a_case_only_reads_the_file_that_it_names(make, tmp_path):
    """Points from a file that is no table of points: one message, and nothing is written."""
    secret = tmp_path / "secret"
    secret.write_text("root:x:0:0:root:/root:/bin/bash\n")
    for name in ("../secret", str(secret), "/dev/null", "/proc/self/mem", ".."):
        folder = tmp_path / "cases"
        folder.mkdir(exist_ok=True)
        path = folder / "case.toml"
        shape = f'shape = {{ type = "points", file = "{name}" }}'
        path.write_text(f'run = {{ t_end = 1.0, every = 1.0 }}\n[[body]]\nname = "a"\n{shape}\n')
        with pytest.raises(particlerb.CaseError):
            particlerb.run(path, tmp_path / "out.h5")
        assert not (tmp_path / "out.h5").exists()


# Broken bytes


@pytest.mark.slow
@settings(
    max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)
@given(data=st.data())
def test_any_bytes_give_a_value_or_one_error(sound, tmp_path, capsys, data):
    """Truncated, or with bytes replaced anywhere; the drivers in tests/fuzz go on from here."""
    content = bytearray(sound.read_bytes())
    for _ in range(data.draw(st.integers(0, 8))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at] = data.draw(st.integers(0, 255))
    cut = data.draw(st.one_of(st.just(len(content)), st.integers(0, len(content))))
    path = tmp_path / "broken.h5"
    path.write_bytes(content[:cut])
    os.utime(path, (0, 0))
    code = main(["info", str(path), "--verify"])
    told = capsys.readouterr()
    assert code in (0, 1, 2)
    assert code == 0 or str(path) in told.out + told.err
    try:
        with particlerb.open(path) as t:
            verify(t)
            _ = t.position, t.names, t.ledger, t.parameter("case_resolved")
    except (TrajectoryError, KeyError) as error:
        message = str(error)
        assert str(path) in message or "was not recorded" in message


def test_states_that_overflow_are_a_flaw_and_no_warning(copy):
    """A momentum of 1e300 kg m/s: its energy is inf, and so is the difference."""
    with h5py.File(copy, "a") as file:
        file["particles/trajectory/linear_momentum/value"][1] = 1e300
    assert "energy balance" in damaged(copy)


@pytest.mark.parametrize("name", ["versions", "identity", "case_resolved"])
def test_a_text_whose_characters_nobody_knows_is_one_message(copy, name, capsys):
    """HDF5 keeps the number of a character set, and h5py makes no type of another than 0 and 1."""
    with h5py.File(copy, "r+") as file:
        text = file[f"parameters/{name}"][()].ljust(40_961)
        del file[f"parameters/{name}"]
        file.create_dataset(f"parameters/{name}", data=text, dtype=h5py.string_dtype(length=40_961))
    utf8, size = b"\x13\x11\x00\x00", (40_961).to_bytes(4, "little")
    data = copy.read_bytes()
    assert data.count(utf8 + size) == 1
    copy.write_bytes(data.replace(utf8 + size, b"\x13\x51\x00\x00" + size))
    assert main(["resume", str(copy), "--t-end", "0.6"]) in (1, 2)
    assert capsys.readouterr().err.count("harmed.h5") == 1


def test_steps_of_vtk_that_are_missing_are_one_message(copy, capsys):
    with h5py.File(copy, "r+") as file:
        del file["VTKHDF/Steps/PartOffsets"]
    assert main(["resume", str(copy)]) in (1, 2)
    assert capsys.readouterr().err.count("harmed.h5") == 1


def found_by_fuzzing(name: str, tmp_path: Path) -> Path:
    path = tmp_path / "found.h5"
    path.write_bytes(lzma.decompress((FUZZ / f"{name}.h5.xz").read_bytes()))
    return path


def test_each_file_that_fuzzing_has_found_is_tried_here():
    names = {path.name.split(".")[0] for path in (FUZZ / "found").glob("*.xz")}
    assert names == {"crash_in_symbol_table", "endless_heap"}


def test_what_crashes_hdf5_is_one_message(tmp_path):
    """Where the look at a file meets nothing, and it is read then."""
    path = found_by_fuzzing("found/crash_in_symbol_table", tmp_path)
    os.utime(path, (0, 0))
    words = [sys.executable, "-m", "particlerb", "info", str(path), "--verify"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode in (1, 2)
    assert "Traceback" not in done.stderr
    assert str(path) in done.stdout + done.stderr


@pytest.mark.parametrize(
    ("command", "name", "is_harmed"),
    [
        ("info", "found/endless_heap", False),
        ("resume", "found_by_resume/endless_visit", False),
        ("view", "found_by_resume/endless_visit", False),
        ("plot", "found_by_resume/endless_visit", True),
    ],
)
def test_a_visit_without_end_is_ended(tmp_path, monkeypatch, capsys, command, name, is_harmed):
    """Of a file that is read in this process; also beside a group that HDF5 cannot list."""
    from particlerb.cli import guard

    monkeypatch.setattr(guard, "SECONDS_TO_LOOK", 1)
    path = found_by_fuzzing(name, tmp_path)
    if is_harmed:  # a node of that group, where a visit by HDF5 ends
        data = path.read_bytes()
        place = [found.start() for found in re.finditer(b"SNOD", data)][5]
        path.write_bytes(data[:place] + b"node" + data[place + 4 :])
    os.utime(path, (0, 0))
    assert main([command, str(path)]) == 1
    assert "found.h5 is damaged: HDF5 crashed reading it, or did not end" in capsys.readouterr().err


def test_links_of_others_in_a_file_are_not_followed(copy, capsys):
    """One in a circle, one to where it began, one to a pipe that nobody writes."""
    pipe = copy.with_name("pipe")
    os.mkfifo(pipe)
    with h5py.File(copy, "r+") as file:
        file["mine/again"] = file["/"]
        file["mine/root"] = h5py.SoftLink("/")
        file["mine/other"] = h5py.ExternalLink(str(pipe), "/")
    os.utime(copy, (0, 0))
    assert main(["info", str(copy)]) == 0
    assert "damaged" not in capsys.readouterr().err


def test_what_resume_misses_while_it_writes_is_told(copy, capsys):
    """No visit finds what is not there, and the other slot is opened for the next checkpoint."""
    with h5py.File(copy, "r+") as file:
        place = file["checkpoint"]
        del place["ab"[1 - place.attrs["current"]]]
    assert main(["resume", str(copy), "-q", "--t-end", "0.6"]) == 1
    err = capsys.readouterr().err
    assert "the run failed" in err
    assert "harmed.h5 is damaged" in err
    assert "5 frames are kept" in err
    assert "continue with" not in err


def test_a_state_packed_in_a_foreign_way_is_damaged(copy, capsys):
    """Its hash is right; zipfile says that it does not know method 77."""
    with h5py.File(copy, "r+") as file:
        for slot in file["checkpoint"].values():
            content = slot[()].tobytes()
            for head, at in ((b"PK\3\4", 8), (b"PK\1\2", 10)):
                places = [found.start() + at for found in re.finditer(head, content)]
                for place in places:
                    content = content[:place] + b"\x4d\0" + content[place + 2 :]
            slot[()] = np.frombuffer(content, np.uint8)
            slot.attrs.modify("sha256", np.bytes_(hashlib.sha256(content).hexdigest()))
    assert main(["resume", str(copy), "-q", "--t-end", "0.6"]) == 2
    told = "harmed.h5 is damaged: the checkpoint cannot be read: That compression method is not"
    assert told in capsys.readouterr().err


def test_a_crash_of_hdf5_is_a_message(tmp_path, monkeypatch, capfd):
    """The guard tells a death by a signal from an exit code."""
    from particlerb.cli import guard

    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    for body, code in (("kill -SEGV $$", 1), ("exit 2", 2), ("exit 0", 0)):
        (tmp_path / "python").write_text(f"#!/bin/sh\n{body}\n")
        (tmp_path / "python").chmod(0o755)
        assert guard.guarded(["info", "run.h5"]) == code
    err = capfd.readouterr().err
    assert "particlerb: run.h5 is damaged: HDF5 crashed on it (signal 11)" in err


def test_the_guard_is_for_commands_that_read_files(monkeypatch):
    from particlerb.cli import guard

    monkeypatch.delenv(guard.GUARD_MARK, raising=False)
    assert [guard.wants_guard([word]) for word in (*guard.GUARDED, "run")] == [
        *(True for _ in guard.GUARDED),
        False,
    ]
    assert guard.wants_guard(["view", "--port", "8000", "run.H5"])
    assert not guard.wants_guard(["view", "case.toml"])
    assert not guard.wants_guard(["view"])
    monkeypatch.setenv(guard.GUARD_MARK, "1")
    assert not guard.wants_guard(["info"])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"count":1,', '"count":6,'),
        ('"count":1,', '"count":-1,'),
        ('"count":1,', '"count":[],'),
        ('"body":', '"bodx":'),
    ],
)
def test_a_case_in_the_file_that_is_not_its_own_is_told(copy, capsys, old, new):
    """Other digits or letters in a text that is JSON all the same."""
    with h5py.File(copy, "r+") as file:
        words = file[f"{PARAMETERS}/case_resolved"][()].decode()
        assert old in words
        provenance.write_text(file, "case_resolved", words.replace(old, new, 1))
    assert main(["info", str(copy), "--verify"]) == 1
    assert re.search(r"NOT OK +energy balance", capsys.readouterr().out)


@pytest.mark.parametrize("old", ['"joint":', '"force":', '"title":'])
def test_a_picture_of_a_case_that_lacks_a_table_is_one_message(copy, tmp_path, capsys, old):
    with h5py.File(copy, "r+") as file:
        words = file[f"{PARAMETERS}/case_resolved"][()].decode()
        provenance.write_text(file, "case_resolved", words.replace(old, '"other":', 1))
    assert main(["plot", str(copy), "-o", str(tmp_path / "a.png")]) == 1
    err = capsys.readouterr().err
    assert "harmed.h5 is damaged: tables, texts have the digest" in err
    assert not (tmp_path / "a.png").exists()


@pytest.mark.parametrize("path", ["particles/trajectory/time", POSITION])
def test_a_file_whose_frames_are_damaged_is_not_played(copy, capsys, path):
    pytest.importorskip("viser")
    with h5py.File(copy, "r+") as file:
        file[path][0] = np.nan
    assert main(["view", str(copy), "--no-browser"]) == 1
    assert "has entries that are not finite" in capsys.readouterr().err


def test_a_fault_of_the_program_is_none_of_a_whole_file(copy, tmp_path, monkeypatch):
    monkeypatch.setattr(particlerb, "plot", lambda *_, **__: {}["a"])
    with pytest.raises(KeyError):
        main(["plot", str(copy), "-o", str(tmp_path / "a.png")])


def test_what_is_copied_by_a_link_to_elsewhere_is_one_message(copy, tmp_path, capsys):
    with h5py.File(copy, "r+") as file:
        del file["observables/work/value"]
        file["observables/work/value"] = h5py.SoftLink("/observables/work/value")
    assert main(["export", str(copy), "--to", "h5", "-o", str(tmp_path / "b.h5")]) == 1
    assert "observables/work/value is a link to elsewhere" in capsys.readouterr().err
    assert not (tmp_path / "b.h5").exists()


def test_what_is_copied_with_another_form_is_one_message(copy, tmp_path, capsys):
    """A table of bodies that is a list of lists: nothing can say what its columns are."""
    with h5py.File(copy, "r+") as file:
        n = len(file["particles/trajectory/moment_inertia"])
        del file["particles/trajectory/moment_inertia"]
        kind = h5py.vlen_dtype(np.dtype("f8"))
        file.create_dataset("particles/trajectory/moment_inertia", (n,), dtype=kind)
    assert main(["export", str(copy), "--to", "h5", "-o", str(tmp_path / "b.h5")]) == 1
    assert capsys.readouterr().err.startswith(f"particlerb: {copy} is not a trajectory")
    assert not (tmp_path / "b.h5").exists()


# Refusals that pass


def test_a_refusal_that_passes_is_waited_for(copy, monkeypatch):
    """As while another process is in the middle of a commit."""
    monkeypatch.setattr(checked, "SECONDS_OF_PATIENCE", 2.0)
    content = copy.read_bytes()
    copy.write_bytes(content[:300])
    later = threading.Timer(0.1, lambda: copy.write_bytes(content))
    later.start()
    with particlerb.open(copy) as t:
        assert t.n_frames == 5
    later.join()


def test_numbers_that_were_never_written_are_refused(copy):
    """A chunk that the index does not know reads as no number, and not as zero."""
    with h5py.File(copy, "a") as file:
        values = file[POSITION]
        values.resize(300, axis=0)
        assert np.isnan(values[256:]).all()
        file["particles/trajectory/time"].resize(300, axis=0)
        file.attrs["n_frames"] = 300
    with particlerb.open(copy) as t, pytest.raises(TrajectoryError, match="not finite"):
        _ = t.position


LIVE = """
import sys, particlerb
from particlerb.record import writer
from particlerb.simulation import frame_times
writer.SECONDS_BETWEEN_COMMITS = 0.0
frame_times.BATCH_FRAMES, frame_times.BATCH_SECONDS = 20, 1e9
shape = {"type": "moments", "inertia": [1.0, 2.0, 2.5]}
body = {"name": "b", "shape": shape, "mass": 2.0, "count": 20, "velocity": [0.5, 0.0, -1.0],
    "place": {"type": "grid", "spacing": 1.0}, "angular_velocity": [1.0, 0.4, -0.7]}
particlerb.run({"run": {"t_end": 1e7, "every": 1.0}, "body": [body]}, sys.argv[1])
"""


@pytest.mark.slow
@pytest.mark.compiled
def test_a_reader_of_a_growing_file_reads_no_wrong_number(tmp_path):
    """Another process commits as fast as it can; every read is compared with the closed form.

    With LIVE_READS=10000 in the environment there are more than a thousand.
    """
    wanted = int(os.environ.get("LIVE_READS", "1000"))
    path, reads, opened, longest = tmp_path / "live.h5", 0, 0, 0
    rng = np.random.default_rng(1)
    with subprocess.Popen([sys.executable, "-c", LIVE, str(path)]) as process:
        try:
            while not path.exists() or path.stat().st_size < 200_000:
                assert process.poll() is None
            while reads < wanted:
                with particlerb.open(path) as t:
                    opened += 1
                    start = t.read("position", slice(0, 1)) if t.n_frames else None
                    for _ in range(100):
                        n = t.refresh() if rng.random() < 0.1 else t.n_frames
                        if start is None or n == 0:
                            break
                        k = int(rng.integers(n)) if rng.random() < 0.5 else n - 1
                        x = t.read("position", slice(k, k + 1))
                        moved = start + k * np.array([0.5, 0.0, -1.0])
                        np.testing.assert_allclose(x, moved, rtol=1e-13, atol=1e-10)
                        q = t.read("orientation", slice(k, k + 1), bodies=3)
                        assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-12)
                        reads += 1
                        longest = max(longest, n)
                assert process.poll() is None
        finally:
            process.kill()
    assert opened > wanted // 200
    assert longest > 100


@pytest.mark.parametrize("shown", ["group", "link", "nothing", "values"])
def test_a_view_is_of_a_dataset_or_refused(tmp_path, shown):
    """HDF5 crashes where it looks for the extent of a group: number 312 299 of the fuzz."""
    master, part = tmp_path / "a.h5", tmp_path / "a.parts" / "0000.h5"
    part.parent.mkdir()
    with h5py.File(part, "w") as file:
        if shown == "link":
            file["here/values"] = h5py.ExternalLink("0000.h5", "/elsewhere")
        file.create_group("elsewhere" if shown == "link" else "here/values")
        if shown in ("nothing", "values"):
            del file["here/values"]
        if shown == "values":
            file["here"]["values"] = np.ones((1, 3))
    unlimited = h5s.UNLIMITED
    layout = h5py.VirtualLayout((1, 3), float, (None, 3))
    source = h5py.VirtualSource("a.parts/0000.h5", "/here/values", (1, 3), float, (None, 3))
    layout[:unlimited, :] = source[:unlimited, :]
    with h5py.File(master, "w") as file:
        note_master(file, Parts("a.parts", (Range(0, 3),), ""))
        file.create_virtual_dataset("values", layout)
    refused = pytest.raises(TrajectoryError, match=r"0000\.h5")
    with h5py.File(master) as file, nullcontext() if shown == "values" else refused:
        assert (checked.dataset_at(file, "values", "f", (None, 3))[:] == 1.0).all()
