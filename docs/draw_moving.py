"""Draw the moving picture of README.md, a handle that turns over and clumps that fall.

Also the plot of the handle, dzhanibekov.png.

python docs/draw_moving.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from PIL import Image, ImageSequence

import particlerb
from particlerb import Scene, Trajectory
from particlerb.studies.charts.bodies import draw_particles, draw_side
from particlerb.studies.charts.style import COLOURS, INK
from particlerb.tables import BoxWall, ContactTable, GridPlacement, PointsShape, RunTable

FRAMES, PER_SECOND = 90, 13
PICTURE = Path(__file__).with_name("moving.gif")
PLOT = PICTURE.with_name("dzhanibekov.png")


def handle(frames: int = FRAMES) -> Trajectory:
    """A T-handle of balls that spins about its stem, the axis of its middle moment."""
    grip = [(x, 0.0, 0.5) for x in np.linspace(-1.0, 1.0, 15)]
    stem = [(0.0, 0.0, z) for z in np.linspace(0.35, -0.6, 8)]
    table = RunTable(t_end=10.0, every=10.0 / (frames - 1))
    scene = Scene(table, title="A handle of 23 balls turns over")
    shape = PointsShape(position=grip + stem, mass=[0.1] * 23, radius=0.13)
    scene.add_body(name="handle", shape=shape, angular_velocity={"body": (0.03, 0.0, 3.0)})
    return particlerb.run(scene)


def heap() -> Trajectory:
    """Clumps of three balls that fall into a box."""
    step = 2.2 / (FRAMES - 1)
    scene = Scene(
        RunTable(t_end=step * (FRAMES - 1), every=step, dt=step / 120, seed=3),
        gravity=(0.0, 0.0, -9.81),
        contact=ContactTable(law="hooke", stiffness=2e4, restitution=0.4, friction=0.5),
    )
    shape = PointsShape(
        position=[(-0.06, 0, 0), (0.06, 0, 0), (0, 0.08, 0)], mass=[0.1] * 3, radius=0.06
    )
    place = GridPlacement(spacing=0.3, n=(5, 3, 8), origin=(0.0, 0.0, 1.4))
    scene.add_body(name="clump", shape=shape, count=120, place=place, orientation="random")
    scene.add_wall(
        BoxWall(name="box", lower=(-0.8, -0.5, 0.0), upper=(0.8, 0.5, 3.0), open=("+z",))
    )
    return particlerb.run(scene)


def main() -> None:
    """Run both scenes and write the pictures."""
    handle(401).plot(PLOT)
    left, right = handle(), heap()
    figure, (turning, falling) = plt.subplots(1, 2, figsize=(7.0, 3.6), layout="constrained")

    def draw(frame: int) -> None:
        turning.clear()
        centres = left.particle_positions(frame)
        order = np.argsort(-centres[:, 1])
        radii = left.particles.radius[order]
        colours = np.where(np.arange(23) < 15, COLOURS[0], COLOURS[1])[order]
        draw_particles(turning, centres[order][:, [0, 2]], radii, colours)
        turning.set(xlim=(-1.3, 1.3), ylim=(-1.3, 1.3), aspect="equal")
        turning.set_title("nothing acts, and it turns over", fontsize=10, color=INK)
        falling.clear()
        draw_side(falling, right, frame)
        falling.set(xlim=(-0.9, 0.9), ylim=(-0.05, 1.75))
        falling.set_title("", loc="left")
        falling.set_title("120 clumps of balls fall into a box", fontsize=10, color=INK)
        for axes in (turning, falling):
            axes.set_axis_off()

    moving = FuncAnimation(figure, draw, frames=FRAMES)
    moving.save(PICTURE, PillowWriter(fps=PER_SECOND), dpi=80)
    with Image.open(PICTURE) as found:
        first, *rest = [part.convert("RGB").quantize(24) for part in ImageSequence.Iterator(found)]
    every = 1000 // PER_SECOND  # ms
    first.save(PICTURE, save_all=True, append_images=rest, duration=every, loop=0, optimize=True)


if __name__ == "__main__":
    main()
