"""Every snippet of docs/opening_files.md runs on a written file, where its tool is installed."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import particlerb

pytestmark = pytest.mark.once

PAGE = Path(__file__).parents[2] / "docs" / "opening_files.md"
BRICKS = [[1, 0.6, 0.25], [1, 0.9, 0.1], [1.2, 0.15, 0.15]]  # m


def tumbling(every: float = 0.1) -> dict:
    """Thirty free bodies of three kinds."""
    bodies = []
    for k, size in enumerate(BRICKS):
        shape = {"type": "box", "size": size, "n": [8, 5, 2]}
        place = {"type": "grid", "spacing": 1.5, "n": [10, 1, 1], "origin": [0, 0, 1.5 * k]}
        spin = {"random": 2.0}
        bodies.append(
            {"name": f"brick{k}", "shape": shape, "mass": 1.0, "count": 10, "place": place}
            | {"angular_velocity": spin, "velocity": {"random": 0.1}, "orientation": "random"}
        )
    return {"run": {"t_end": 1.0, "every": every, "seed": 5}, "body": bodies}


def snippets() -> dict[str, str]:
    """Python of each section."""
    text = PAGE.read_text(encoding="utf-8")
    parts = re.split(r"^## (.*)\n", text, flags=re.MULTILINE)
    found = {}
    for heading, body in zip(parts[1::2], parts[2::2], strict=True):
        blocks = re.findall(r"```python\n(.*?)```", body, re.DOTALL)
        if blocks:
            found[heading] = "\n".join(blocks)
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with run.vtkhdf."""
    folder = tmp_path_factory.mktemp("opening")
    particlerb.run(tumbling(), folder / "run.vtkhdf").close()
    return folder


def test_the_page_has_all_tools():
    assert set(snippets()) == {
        "particlerb",
        "ParaView",
        "MDAnalysis",
        "xarray",
        "h5py",
        "pyh5md",
        "OVITO",
    }


@pytest.mark.slow
@pytest.mark.parametrize("heading", [name for name in snippets() if name != "OVITO"])
def test_snippet(heading, folder):
    words = [sys.executable, "-c", snippets()[heading]]
    done = subprocess.run(
        words, cwd=folder, capture_output=True, text=True, timeout=120, check=False, env=os.environ
    )
    assert done.returncode == 0, done.stderr
    if heading == "ParaView":
        from matplotlib.image import imread

        colours = imread(folder / "frame.png")[..., :3].reshape(-1, 3)
        share = (colours < 0.99).any(axis=1).mean()
        assert 0.05 < share < 0.9  # bodies are there, and so is what lies behind
    else:
        assert done.stdout


def test_what_ovito_would_open(folder):
    """The export of the page; read by OVITO where it is installed, and by gsd anyway."""
    import gsd.hoomd

    line = "python -m particlerb export run.vtkhdf --to gsd"
    assert line in PAGE.read_text(encoding="utf-8")
    words = [sys.executable, *line.split()[1:], "--overwrite"]
    subprocess.run(words, cwd=folder, check=True, capture_output=True, timeout=120)
    frames = gsd.hoomd.open(folder / "run.gsd")
    with particlerb.open(folder / "run.vtkhdf") as t:
        assert len(frames) == t.n_frames
        assert frames[-1].particles.position == pytest.approx(t.position[-1], rel=1e-5, abs=1e-5)
    if importlib.util.find_spec("ovito"):
        words = [sys.executable, "-c", snippets()["OVITO"]]
        subprocess.run(words, cwd=folder, check=True, capture_output=True, timeout=120)


if __name__ == "__main__":  # the picture of the page
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        particlerb.run(tumbling(), Path(name) / "run.vtkhdf").close()
        subprocess.run([sys.executable, "-c", snippets()["ParaView"]], cwd=name, check=True)
        PAGE.with_suffix(".png").write_bytes((Path(name) / "frame.png").read_bytes())
