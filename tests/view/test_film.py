"""A film of a file, from the pictures of a real browser."""

from pathlib import Path

import numpy as np
import pytest

import particlerb

pytestmark = pytest.mark.slow
CUBE = {"name": "cube", "shape": {"type": "box", "size": [1.0, 1.0, 1.0]}, "mass": 2.0}
HEADS = {"gif": b"GIF8", "mp4": b"ftyp"}


@pytest.mark.parametrize("form", HEADS)
def test_a_film_has_a_picture_for_every_frame(serve, tmp_path, form):
    imageio = pytest.importorskip("imageio.v3")
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    from particlerb.record.trajectory import open_trajectory
    from particlerb.view.replay import Replay, film_forms

    assert set(film_forms()) == set(HEADS)
    spinning = CUBE | {"angular_velocity": [0.0, 0.0, 2.0]}
    path = tmp_path / "run.h5"
    particlerb.run({"run": {"t_end": 0.4, "every": 0.1}, "body": [spinning]}, path).close()
    with (
        open_trajectory(path) as trajectory,
        serve(lambda server: Replay(trajectory, server, path)) as served,
    ):
        served.choose("film", form)
        with served.page.expect_download(timeout=120_000) as download:
            served.press("make the film")
        made = tmp_path / f"film.{form}"
        made.write_bytes(Path(download.value.path()).read_bytes())
    assert HEADS[form] in made.read_bytes()[:12]
    if form == "mp4":
        assert imageio_ffmpeg.count_frames_and_secs(str(made))[0] == 5
        return
    pictures = imageio.imread(made, index=None)
    assert len(pictures) == 5
    assert np.abs(pictures[0].astype(int) - pictures[-1]).max() > 50  # it has turned
