"""What pages show in Python runs as it stands."""

import re
from pathlib import Path

import pytest

import particlerb

DOCS = Path(__file__).parents[1] / "docs"


@pytest.mark.parametrize("page", ["python.md"])
def test_code_of_a_page_runs(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for block in re.findall(r"^```python\n(.*?)^```$", (DOCS / page).read_text(), re.S | re.M):
        exec(block, names)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 13
    assert float(lines[-1]) < 1e-3
    with particlerb.open("cube.h5") as trajectory:
        assert trajectory.n_frames == 101
