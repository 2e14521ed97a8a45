"""Kills, power cuts and failing disks at operations of small runs; `every_prefix.py` does more."""

import errno
import sys
from functools import cache

import pytest
from crashes import Session, build
from every_prefix import Recorded, faults, kills, power_cuts

pytestmark = [
    pytest.mark.plain,
    pytest.mark.skipif(sys.platform != "linux", reason="libraries are preloaded as Linux does"),
]


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A process that runs what is recorded; there must be a C compiler."""
    with Session(build(tmp_path_factory.mktemp("shim"))) as one:
        yield one


@pytest.fixture(scope="module")
def recorded(session, tmp_path_factory):
    """Runs whose operations are known, by kind."""

    @cache
    def record(kind):
        found = Recorded(kind, tmp_path_factory.mktemp("run"), session)
        assert 30 < len(found.done.operations) <= 200
        return found

    return record


@pytest.mark.parametrize("kind", ["contact", "resumed contact", "prolonged driven"])
def test_every_prefix_is_a_file_that_goes_on(recorded, kind):
    """Each is opened; those are gone on with where recovery goes another way."""
    found = kills(recorded(kind), every=0)
    assert found.wrong == []
    assert found.resumed > 5
    assert found.only_mended


@pytest.mark.parametrize("kind", ["contact", "resumed contact"])
def test_a_power_cut_takes_nothing_that_was_committed(recorded, kind):
    """Pages that were written since they were synced are missing, or older, at random."""
    assert power_cuts(recorded(kind), states=1, every=4).wrong == []


@pytest.mark.parametrize(
    ("error", "how"), [(errno.EIO, "always"), (errno.ENOSPC, "full"), (errno.EIO, "once")]
)
def test_what_the_disk_refuses_is_said_once(recorded, error, how):
    """Exit code 1, one message, all committed frames, and the same bits where it works again."""
    one = recorded("driven")
    n = len(one.done.operations)
    at = sorted({*range(4), *(k * n // 20 for k in range(20))})  # a file is begun by the first
    assert faults(one, at, [(error, how)]).wrong == []
