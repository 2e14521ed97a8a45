"""Walls as geoms of MuJoCo: planes and solid bodies."""

import numpy as np

from particlerb.case.contact import AnyWall, BoxWall, CylinderWall, PlaneWall
from particlerb.export import ExportError
from particlerb.export.bodies import numbers
from particlerb.maths.vec3 import Floats


def geoms_of(wall: AnyWall) -> list[dict[str, str]]:
    """A wall as geoms that bodies touch from where they are."""
    if wall.motion is not None or wall.piston is not None:
        raise ExportError(f"{wall.name} moves, which is not written")
    if isinstance(wall, PlaneWall):
        return [_plane(np.array(wall.point), np.array(wall.normal))]
    if isinstance(wall, BoxWall):
        low, high = np.array(wall.lower), np.array(wall.upper)
        if wall.inside:
            return [
                _plane(low if sign > 0 else high, sign * normal)
                for axis, normal in zip("xyz", np.eye(3), strict=True)
                for end, sign in (("-", 1.0), ("+", -1.0))
                if end + axis not in wall.open
            ]
        if not wall.open:
            middle, half = numbers(0.5 * (low + high)), numbers(0.5 * (high - low))
            return [{"type": "box", "pos": middle, "size": half}]
    if isinstance(wall, CylinderWall) and not wall.inside and not wall.open:
        size = numbers(wall.radius, 0.5 * wall.length)
        place = {"pos": numbers(wall.centre), "zaxis": numbers(wall.axis)}
        return [{"type": "cylinder", "size": size, **place}]
    raise ExportError(f"{wall.name} is hollow: walls of MuJoCo are planes and solid bodies")


def _plane(point: Floats, normal: Floats) -> dict[str, str]:
    """A plane, drawn without end."""
    return {"type": "plane", "size": "0 0 1", "pos": numbers(point), "zaxis": numbers(normal)}
