"""A file that changes at commits only, whatever is cut off, and however a disk fails."""

import errno
import os
import random
import struct
from contextlib import closing

import h5py
import numpy as np
import pytest
from crashes import SYNC, TRUNCATE, WRITE, Disk, Operation

from particlerb.record import atomic
from particlerb.record.atomic import (
    END,
    PAGE,
    SUPERBLOCK,
    VERSION_0,
    AtomicFile,
    left_over,
    to_read,
)
from particlerb.record.writer_lock import WriterLock

pytestmark = pytest.mark.once


def claimed(path):
    """A file for HDF5."""
    return AtomicFile(WriterLock(path), path)


@pytest.fixture
def path(tmp_path):
    """A committed file with 3 numbers."""
    found = tmp_path / "a.h5"
    disk = claimed(found)
    with h5py.File(disk, "w") as file:
        file.create_dataset("x", data=np.arange(3.0), maxshape=(None,), chunks=(500,))
    disk.commit()
    return found


def grown(disk, n):
    """Let a file have n numbers, which no commit has brought to the disk."""
    with h5py.File(disk, "r+") as file:
        file["x"].resize((n,))
        file["x"][:] = np.arange(float(n))
    assert disk.changed


def numbers(path):
    with h5py.File(to_read(path), "r", locking=False) as file:
        return len(file["x"])


def stopped_in_the_third_step(path, monkeypatch):
    """Write more numbers; a kill comes before the changed pages are in their places."""
    disk = claimed(path)
    grown(disk, 20_000)
    with monkeypatch.context() as patch:
        patch.setattr(AtomicFile, "settle", lambda file: None)
        disk.commit()
    disk.source.close()


def test_nothing_is_seen_before_the_commit(path):
    before = path.read_bytes()
    disk = claimed(path)
    grown(disk, 20_000)
    assert path.read_bytes()[: len(before)] == before
    assert numbers(path) == 3
    disk.commit()
    assert numbers(path) == 20_000
    assert path.stat().st_size == disk.end()


def test_a_commit_that_was_cut_off_is_brought_to_its_end_by_a_reader(path, monkeypatch):
    stopped_in_the_third_step(path, monkeypatch)
    with h5py.File(path) as file:
        assert len(file["x"]) == 3
    assert numbers(path) == 20_000
    with h5py.File(path) as file:
        assert file["x"][:].tolist() == list(range(20_000))


def test_where_the_file_cannot_be_written_it_is_read_as_it_should_be(path, monkeypatch):
    stopped_in_the_third_step(path, monkeypatch)
    before = path.read_bytes()

    def refuse(descriptor, data, place):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr("os.pwrite", refuse)
    assert numbers(path) == 20_000
    monkeypatch.undo()
    monkeypatch.setattr(WriterLock, "lock", lambda lock: False)  # no locks: another may write
    assert numbers(path) == 20_000
    assert path.read_bytes() == before


def test_a_reader_leaves_a_file_alone_that_another_process_writes(path, monkeypatch):
    stopped_in_the_third_step(path, monkeypatch)
    with closing(WriterLock(path)):
        assert to_read(path) == path


def test_a_reader_that_may_not_write_reads_on_when_the_writer_settles(path, monkeypatch):
    """The record is cut off then: the file is shorter than when it was opened."""
    disk = claimed(path)
    grown(disk, 20_000)

    def refuse(path):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    with monkeypatch.context() as patch:
        patch.setattr(AtomicFile, "settle", lambda file: None)
        patch.setattr(atomic, "finish", refuse)
        disk.commit()
        source = to_read(path)
    size = path.stat().st_size
    disk.settle()
    assert path.stat().st_size < size
    with h5py.File(source, "r", locking=False) as file:
        assert file["x"][:].tolist() == list(range(20_000))


def test_a_read_that_fails_is_told_to_a_reader_and_no_longer_than_it_fails(path, monkeypatch):
    with h5py.File(AtomicFile(path.open("rb"), path), "r") as file:
        with monkeypatch.context() as patch:
            patch.setattr(os, "preadv", failing)
            with pytest.raises(OSError, match=f"Input/output error: '{path}'"):
                file["x"][:]
        assert file["x"][:].tolist() == [0.0, 1.0, 2.0]


def failing(*arguments):
    raise OSError(errno.EIO, os.strerror(errno.EIO))


def test_a_record_that_is_not_whole_counts_for_nothing(path, monkeypatch):
    stopped_in_the_third_step(path, monkeypatch)
    whole = path.read_bytes()
    with path.open("rb") as file:
        pages = left_over(file.fileno())
    assert 0 in pages  # the superblock
    start = len(whole) - len(pages) * PAGE
    for place in (start, len(whole) - 1, len(whole) - 40, len(whole) - 60):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with path.open("rb") as file:
            assert left_over(file.fileno()) == {}
        assert numbers(path) == 3
    for size in (len(whole) - 1, start, start - PAGE):
        path.write_bytes(whole[:size])
        assert numbers(path) == 3


def test_a_record_may_not_lead_out_of_the_file(path):
    """A file may come from anyone."""
    place = -(-path.stat().st_size // PAGE) * PAGE
    page = bytearray(PAGE)
    os.truncate(path, place)
    with path.open("ab") as file:
        file.write(atomic.record(place, {2**40: page}))
    with path.open("rb") as file:
        assert left_over(file.fileno()) == {}


@pytest.mark.parametrize("step", [1, 2, 3])
def test_an_error_ends_the_writing_and_keeps_what_was_committed(path, monkeypatch, step):
    disk = claimed(path)
    grown(disk, 20_000)
    sync, count = os.fsync, iter(range(1, 10))

    def failing(descriptor):
        if next(count) == step:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        sync(descriptor)

    monkeypatch.setattr("os.fsync", failing)
    with pytest.raises(OSError, match="Input/output error") as caught:
        disk.commit()
    assert caught.value.filename == str(path)
    after = path.read_bytes()
    disk.write(bytes(3 * PAGE))
    with pytest.raises(OSError, match="Input/output error"):
        disk.commit()
    assert path.read_bytes() == after
    disk.source.close()
    assert numbers(path) == (3 if step == 1 else 20_000)


def test_any_sequence_of_writes_reads_as_in_memory(tmp_path):
    """Small and large, over each other, across commits."""
    rng = np.random.default_rng(5)
    disk, right = claimed(tmp_path / "a"), bytearray()
    for k in range(400):
        place = int(rng.integers(0, len(right) + PAGE))
        size = int(rng.choice([1, 50, PAGE, 3 * PAGE + 7, 20 * PAGE]))
        data = rng.bytes(size)
        right.extend(bytes(max(0, place + size - len(right))))
        right[place : place + size] = data
        disk.seek(place)
        disk.write(data)
        place = int(rng.integers(0, len(right)))
        disk.seek(place)
        assert disk.read(5 * PAGE)[: len(right) - place] == right[place : place + 5 * PAGE]
        if k % 50 == 49:
            disk.commit()
            assert (tmp_path / "a").read_bytes()[: len(right)] == right
    disk.source.close()


def written(path, monkeypatch, is_durable):
    """Operations of some commits, what each commit holds, and how many were done at each operation.

    Writes of all sizes, the more the nearer to the end, which moves to and fro.
    """
    rng, operations, commits, done = np.random.default_rng(7), [], [b""], [0]

    def noted(name, kind):
        work = getattr(os, name)

        def noting(descriptor, *arguments):
            data = bytes(arguments[0]) if kind == WRITE else b""
            place = arguments[-1] if kind == WRITE else 0
            size = len(data) if kind == WRITE else arguments[0] if arguments else 0
            operations.append(Operation(kind, "a", "", 0, place, size, 0, data))
            done.append(done[-1])
            return work(descriptor, *arguments)

        monkeypatch.setattr(os, name, noting)

    for name, kind in (("pwrite", WRITE), ("ftruncate", TRUNCATE), ("fsync", SYNC)):
        noted(name, kind)
    disk, now = AtomicFile(WriterLock(path), path, is_durable), bytearray(SUPERBLOCK)
    for _ in range(12):
        for _ in range(int(rng.integers(1, 12))):
            place = SUPERBLOCK + int(len(now) * rng.beta(3, 1))
            data = rng.bytes(int(rng.choice([1, 50, PAGE, 3 * PAGE + 7, 20 * PAGE])))
            now.extend(bytes(max(0, place + len(data) - len(now))))
            now[place : place + len(data)] = data
            disk.seek(place)
            disk.write(data)
        if rng.random() < 0.3:
            del now[max(SUPERBLOCK, len(now) - int(rng.integers(0, 8 * PAGE))) :]
        now[:SUPERBLOCK] = VERSION_0.ljust(END, b"x") + struct.pack("<Q", len(now)).ljust(56, b"x")
        disk.seek(0)
        disk.write(now[:SUPERBLOCK])
        disk.truncate(len(now))
        commits.append(bytes(now))
        disk.commit()
        done[-1] = len(commits) - 1
    disk.source.close()
    monkeypatch.undo()
    return operations, commits, done


@pytest.mark.parametrize("how", ["kill", "power cut"])
def test_a_commit_is_whole_or_not_there(tmp_path, monkeypatch, how):
    """Behind any operation, with any pages missing; read as it is, and finished once and twice."""
    operations, commits, done = written(tmp_path / "a", monkeypatch, how == "power cut")
    disk, path, dice = Disk({"a": b""}), tmp_path / "left", random.Random(3)
    found, numbers_of = set(), {content: n for n, content in enumerate(commits)}
    for operation, least in zip(operations, done[1:], strict=True):
        disk.apply(operation)
        for _ in range((1 if how == "kill" else 4) if least else 0):  # before, it has no name
            state = disk.killed() if how == "kill" else disk.power_cut(dice)
            path.write_bytes(state["a"])
            for _ in range(2):
                with path.open("rb") as source:
                    file = AtomicFile(source, path)
                    end = file.end()
                    file.seek(0)
                    n = numbers_of.get(file.read(end), -1)
                is_whole = n >= least
                assert is_whole
                found.add(n)
                atomic.finish(path)
            is_settled = path.read_bytes()[:end] == commits[n]
            assert is_settled
    assert found == set(range(1, len(commits)))
