"""Sweeps on real executors: ranks of MPI, workers of dask; and what a plain run imports."""

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from particlerb.sweeping import executors
from particlerb.sweeping.executors import NoExecutorError, cluster

CASE = """
[run]
t_end = 0.5
every = 0.25
[[body]]
name = "ball"
shape = { type = "sphere", radius = 0.1, n = 2 }
mass = 2.0
velocity = [1.0, 0.0, 0.0]
[[force]]
type = "drag"
body = "ball"
translation = 0.5
[sweep.axes]
"run.t_end" = [0.5, 0.75, 1.0]
"force.0.translation" = [0.1, 0.2, 0.5]
[[sweep.value]]
body = "ball"
quantity = "velocity"
"""
MPIEXEC = Path(sys.executable).with_name("mpiexec")
PLAIN = {**os.environ, "NUMBA_DISABLE_JIT": "1"}


def swept(folder: Path, *options: str, before: tuple[str, ...] = (), name: str = "t.csv") -> bytes:
    """The table that the command writes."""
    case, table = folder / "case.toml", folder / name
    case.write_text(CASE)
    command = [sys.executable, "-m", "particlerb", "sweep", str(case), "-o", str(table), *options]
    subprocess.run([*before, *command], env=PLAIN, check=True, capture_output=True, timeout=300)
    return table.read_bytes()


@pytest.mark.slow
def test_ranks_and_dask_write_the_table_of_processes(tmp_path):
    here = swept(tmp_path, "--workers", "1", name="here.csv")
    assert here.count(b"done") == 9
    pytest.importorskip("distributed")
    assert swept(tmp_path, "--executor", "dask", "--workers", "2", name="dask.csv") == here
    pytest.importorskip("mpi4py")
    if not MPIEXEC.exists() and shutil.which("mpiexec") is None:
        pytest.skip("there is no mpiexec")
    ranks = str(MPIEXEC) if MPIEXEC.exists() else "mpiexec", "-n", "3"
    assert swept(tmp_path, "--executor", "mpi", before=ranks, name="mpi.csv") == here


@pytest.mark.slow
def test_a_killed_worker_of_dask_costs_no_row(tmp_path):
    distributed = pytest.importorskip("distributed")
    script = tmp_path / "script.py"
    script.write_text(KILLING)
    (tmp_path / "case.toml").write_text(CASE)
    command = [sys.executable, str(script)]
    done = subprocess.run(
        command, cwd=tmp_path, env=PLAIN, check=False, capture_output=True, timeout=300
    )
    assert done.returncode == 0, done.stderr.decode()[-2000:]
    with (tmp_path / "t.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["run"]) for row in rows] == list(range(9))
    assert {row["status"] for row in rows} == {"done"}
    assert done.stdout.split()[-1] == b"9"
    del distributed


KILLING = f"""
import os, signal
from distributed import Client, LocalCluster
import particlerb

if __name__ == "__main__":
    killed = []
    with LocalCluster(2, threads_per_worker=1, dashboard_address=None) as c, Client(c) as client:
        def kill(n):
            workers = list(client.run(os.getpid).values())
            if n and not killed:
                killed.append(workers[0])
                os.kill(workers[0], {int(signal.SIGKILL)})
        executor = client.get_executor()
        found = particlerb.sweep("case.toml", "t.csv", executor=executor, workers=2, progress=kill)
    assert killed
    print(len(found.rows))
"""


@pytest.mark.parametrize(("name", "words"), [("mpi", "cluster"), ("dask", "dask")])
def test_a_missing_package_is_named(name, words, monkeypatch):
    def nothing(module: str) -> None:
        raise ImportError(f"No module named {module}")

    monkeypatch.setattr(executors.importlib, "import_module", nothing)
    with (
        pytest.raises(NoExecutorError, match=rf"pip install 'particlerb\[{words}\]'"),
        cluster(name),
    ):
        pass


@pytest.mark.slow
def test_a_plain_run_imports_neither_mpi_nor_dask(tmp_path):
    (tmp_path / "case.toml").write_text(CASE)
    code = (
        "import sys\nfrom particlerb.cli import main\n"
        "assert main(['case.toml', '-o', 'a.h5']) == 0\n"
        "import particlerb.sweeping.driver\n"
        "assert not {'mpi4py', 'distributed', 'dask'} & set(sys.modules)\n"
    )
    command = [sys.executable, "-c", code]
    subprocess.run(command, cwd=tmp_path, env=PLAIN, check=True, capture_output=True, timeout=120)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_does_not_wait_for_runs_that_take_long(number, tmp_path):
    """The second variant has 1e12 steps; the first one's row stays."""
    case, table = tmp_path / "case.toml", tmp_path / "t.csv"
    case.write_text(CASE.replace("[0.5, 0.75, 1.0]", "[0.5]").split("[[sweep.value]]")[0])
    run = "{ t_end = 1.0, every = 1.0, method = 'strang', dt = %s }"
    axis = f"run=[{run % '0.5'}, {run % '1e-12'}]"
    options = ["sweep", str(case), "-o", str(table), "--workers", "2", "--axis", axis]
    command = [sys.executable, "-m", "particlerb", *options]
    with subprocess.Popen(command, env=PLAIN, stderr=subprocess.PIPE, text=True) as driver:
        while driver.poll() is None and (not table.exists() or table.read_bytes().count(b"\n") < 2):
            time.sleep(0.1)
        driver.send_signal(number)
        try:
            _, err = driver.communicate(timeout=60)
        finally:
            driver.kill()
    assert driver.returncode == 130
    assert "has the rows so far; the same command continues" in err
    assert table.read_bytes().count(b",done,") == 1


@pytest.mark.slow
def test_workers_end_with_a_killed_driver(tmp_path):
    case, table = tmp_path / "case.toml", tmp_path / "t.csv"
    axes = CASE.replace("[0.5, 0.75, 1.0]", "{ low = 0.5, high = 1.0, n = 3000 }")
    case.write_text(axes)
    options = ["sweep", str(case), "-o", str(table), "--workers", "1"]
    driver = subprocess.Popen([sys.executable, "-m", "particlerb", *options], env=PLAIN)
    children = Path(f"/proc/{driver.pid}/task/{driver.pid}/children")
    if not children.exists():
        driver.kill()
        pytest.skip("this system does not list the children of a process")
    while driver.poll() is None and (not table.exists() or table.read_bytes().count(b"\n") < 2):
        time.sleep(0.1)
    own = [Path("/proc") / pid for pid in children.read_text().split()]
    driver.kill()
    driver.wait()
    assert own
    late = time.monotonic() + 30.0
    while any(one.exists() for one in own) and time.monotonic() < late:
        time.sleep(0.1)
    assert not any(one.exists() for one in own)
