"""Bodies, walls, joints, arrows, trails on the page. Knows viser and shapes; no forces, no time.

The page gets places relative to an origin, in a unit near the size of the scene: a screen computes
in float32, and a scene may be of any size and anywhere.
"""

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import viser

from particlerb.case.forces import SpringTable
from particlerb.case.joints import WITHOUT_AXIS
from particlerb.export.surfaces import Surfaces, extent_of, walls_of
from particlerb.forces.links import WORLD
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.state import quaternion_product, rotate
from particlerb.model.system import System
from particlerb.plan.joints import joints_of
from particlerb.plan.links import link_of

_AXIS_LENGTH: Final = 0.18  # in sizes of the scene
_CROSS_LENGTH: Final = 0.02  # of the point of a joint


class BodyLines:
    """Segments between points of bodies, in any of their poses.

    Parameters
    ----------
    body : ndarray, shape (k, 2)
        Body at each end; -1 where it is the world.
    point : ndarray, shape (k, 2, 3) [m]
        The ends, in the frames of their bodies.
    """

    def __init__(self, body: Ints, point: Floats) -> None:
        self.body, self.point = body, point

    def at(self, position: Floats, q: Floats) -> Floats:
        """Ends of all segments [m], world frame, (k, 2, 3), with bodies at (N, 3) and (N, 4)."""
        body = self.body.ravel()  # the world is the last of places and orientations
        place = np.vstack([position, np.zeros(3)])[body]
        turn = np.vstack([q, [1.0, 0.0, 0.0, 0.0]])[body].T
        ends: Floats = place + rotate(turn, self.point.reshape(-1, 3).T).T
        return ends.reshape(-1, 2, 3)


class JointLines(BodyLines):
    """Segments that show the joints of a system.

    Parameters
    ----------
    system : System
    size : float [m]
        Of the scene.
    """

    def __init__(self, system: System, size: float) -> None:
        setup = joints_of(system)
        if setup is None:
            raise ValueError("the system has no joints")
        first, second = setup.body_a, setup.body_b
        self.held = {int(b) for b in np.concatenate([first, second]) if b != WORLD}
        types = np.array(setup.types)
        at, at_to, axis, axis_to = np.moveaxis(setup.places, 1, 0)
        with_axis, is_rod = ~np.isin(types, WITHOUT_AXIS), types == "distance"
        is_cross = np.isin(types, ("universal", "rack"))
        half = 0.5 * _AXIS_LENGTH * size
        parts = [self._around(first, at, axis * half, with_axis)]
        parts.append(self._around(second, at_to, axis_to * half, is_cross))
        for direction in np.eye(3) * _CROSS_LENGTH * size:
            for body, point, chosen in ((first, at, ~with_axis), (second, at_to, is_rod)):
                parts.append(self._around(body, point, direction[None], chosen))
        rods = np.stack([first, second], axis=1), np.stack([at, at_to], axis=1)
        parts.append((rods[0][is_rod], rods[1][is_rod]))
        bodies, points = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        world = np.array([[1.0], [0.0], [0.0], [0.0]])
        frame = np.hstack([system.bodies.rotor_frame, world])[:, bodies.ravel()]
        super().__init__(bodies, rotate(frame, points.reshape(-1, 3).T).T.reshape(-1, 2, 3))

    @staticmethod
    def _around(body: Ints, point: Floats, half: Floats, chosen: Bools) -> tuple[Ints, Floats]:
        """Segments about points of bodies: (k, 2) bodies, (k, 2, 3) ends in their rotor frames."""
        ends = np.stack([point - half, point + half], axis=1)
        return np.stack([body, body], axis=1)[chosen], ends[chosen]


class SpringLines(BodyLines):
    """Segments that show the springs of a system, but those between all that are within reach.

    Parameters
    ----------
    system : System
    """

    def __init__(self, system: System) -> None:
        body, point = [np.zeros((0, 2), dtype=np.int64)], [np.zeros((0, 2, 3))]
        for k, force in enumerate(system.force):
            if isinstance(force, SpringTable) and force.reach is None:
                link = link_of(system, k, force)
                body.append(np.stack([link.body_a, link.body_b], axis=1))
                point.append(np.stack([link.at_a.T, link.at_b.T], axis=1))
        super().__init__(np.concatenate(body), np.concatenate(point))


_Colour = tuple[int, int, int]
COLOURS: Final[tuple[_Colour, ...]] = (
    (245, 124, 20), (58, 123, 191), (70, 160, 90), (196, 78, 82), (129, 102, 178),
    (140, 110, 80), (218, 139, 195), (120, 130, 140), (190, 180, 50), (60, 180, 190),
)  # fmt: skip
_WALL_COLOUR: Final[_Colour] = (176, 184, 192)
ARROWS: Final[dict[str, _Colour]] = {
    "force": (214, 39, 40), "omega": (31, 119, 180), "L": (148, 60, 189),
    "axes": (90, 98, 106),
}  # fmt: skip
_ANCHOR: Final = "center-center"  # of names, which stand where they are put, not below it
_FAST_MOVE: Final = 0.2  # of the end of an arrow from update to update, in sizes of the scene
_ARROW_NAMES: Final = {"force": "F", "omega": "ω", "L": "L"}  # at the free ends of arrows
AXIS_COLOURS: Final[tuple[_Colour, ...]] = ((209, 73, 91), (46, 139, 87), (31, 111, 181))
"""Colours of x, y and z, in the scene and on charts."""
_TRAIL_COLOUR: Final[_Colour] = (20, 20, 20)
_JOINT_COLOUR: Final[_Colour] = (200, 0, 120)
_SPRING_COLOUR: Final[_Colour] = (110, 120, 130)
_LIGHT: Final = 0.8, 2.0  # of the sky and of the sun
_VIEW: Final = (1.15, -1.85, 1.1)  # where the camera stands at first, in sizes of the scene
_NARROW_ASPECT: Final = 0.6  # width over height of a phone; of 1400 px beside two panels 0.71


class Stage:
    """A scene in the browser.

    Parameters
    ----------
    server : ViserServer
        What shows it.
    system : System
        Shapes and constants of the bodies.
    """

    def __init__(self, server: viser.ViserServer, system: System) -> None:
        self.server, self.system = server, system
        self.surfaces = Surfaces(system)
        position = system.state.com.T
        springs = SpringLines(system)
        hung = springs.at(position, system.state.q.T)[springs.body < 0]  # anchors in the world
        held = np.vstack([position, hung]), np.append(self.surfaces.reach, np.zeros(len(hung)))
        size = extent_of(*held)
        self.unit = 1.0 if 0.05 < size < 50.0 else 10.0 ** round(math.log10(size))  # [m]
        self.size = size / self.unit
        middle = 0.5 * (held[0].min(axis=0) + held[0].max(axis=0))
        self.home: Floats = middle if np.abs(middle).max() > 0.05 * size else np.zeros(3)
        self.origin: Floats = self.home
        self.position, self.q = position.copy(), np.tile([1.0, 0.0, 0.0, 0.0], (len(position), 1))
        self.fixed = server.scene.add_frame("/fixed", show_axes=False)
        self.layers = [self.add_layer(k) for k in range(len(self.surfaces.layers))]
        self.arrows: dict[str, Any] = {}
        self.arrow_names: dict[str, Any] = {}
        self.trail = self.add_line("/trail", _TRAIL_COLOUR)
        self.joints = JointLines(system, size) if system.joint else None
        self.lines: list[tuple[BodyLines, Any]] = []
        if self.joints is not None:
            self.lines.append((self.joints, self.add_line("/joints", _JOINT_COLOUR, 4.0)))
        if len(springs.body):
            self.lines.append((springs, self.add_line("/springs", _SPRING_COLOUR)))
        self.furnish(size)
        server.initial_camera.position = self.size * np.array(_VIEW)
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        server.on_client_connect(self.watch)
        for client in server.get_clients().values():  # that have seen another scene before
            client.camera.position, client.camera.look_at = self.size * np.array(_VIEW), np.zeros(3)

    def add_layer(self, k: int) -> Any:
        """Instances of one mesh."""
        layer = self.surfaces.layers[k]
        sizes, n = None if layer.size is None else layer.size / self.unit, layer.body.size
        vertices = layer.mesh.vertices / (self.unit if sizes is None else 1.0)
        poses = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), np.zeros((n, 3))
        how: Any = {"lod": "off", "cast_shadow": n < 100, "receive_shadow": False}
        how |= {"flat_shading": not layer.mesh.is_smooth, "batched_scales": sizes}
        how["batched_colors"] = linear(np.array(COLOURS[k % len(COLOURS)]))
        scene = self.server.scene
        return scene.add_batched_meshes_simple(
            f"/bodies/{k}", vertices, layer.mesh.faces, *poses, **how
        )

    def add_line(self, name: str, colour: _Colour, thickness: float = 2.0) -> Any:
        """A line without points yet."""
        how: Any = {"thickness": thickness, "thickness_units": "screen", "visible": False}
        return self.server.scene.add_line_segments(name, np.zeros((1, 2, 3)), colour, **how)

    def furnish(self, size: float) -> None:
        """Walls, light and a grid below the bodies."""
        scene = self.server.scene
        self.draw_axes()
        for k, mesh in enumerate(walls_of(self.system, size)):
            how: Any = {"color": _WALL_COLOUR, "opacity": 0.35, "side": "double"}
            place = (mesh.vertices - self.home) / self.unit
            scene.add_mesh_simple(f"/fixed/walls/{k}", place, mesh.faces, flat_shading=True, **how)
        if not any(wall.type == "plane" for wall in self.system.wall):
            low = self.position - self.surfaces.reach[:, None]
            floor = float((low[:, 2].min() - self.home[2]) / self.unit) - 0.35 * self.size
            colours: Any = {"cell_color": (236, 238, 241), "section_color": (218, 222, 227)}
            cells: Any = {"cell_size": self.size / 3.0, "section_size": self.size / 0.75}
            extent, where = 8.0 * self.size, (0.0, 0.0, floor)
            scene.add_grid("/fixed/grid", extent, extent, position=where, **cells, **colours)
        scene.configure_default_lights(enabled=False)
        scene.add_light_hemisphere("/lights/sky", intensity=_LIGHT[0])
        scene.add_light_directional(
            "/lights/sun", intensity=_LIGHT[1], position=(3.0, -1.2, 5.0), cast_shadow=True
        )

    def watch(self, client: viser.ClientHandle) -> None:
        """Look at the camera of a browser whenever it moves."""
        client.camera.on_update(self.step_back)

    def step_back(self, camera: viser.CameraHandle) -> None:
        """Show a narrow screen the scene from farther away, above the fields.

        At any time that it has the first view: a slow browser takes that one late, again after this
        was told it.
        """
        view = self.size * np.array(_VIEW)
        off = np.abs(camera.look_at).max() + np.abs(camera.position - view).max()
        if camera.aspect < _NARROW_ASPECT and off < 1e-3 * self.size:
            camera.position, camera.look_at = 1.8 * view, np.array([0.0, 0.0, -2.3 * self.size])

    def draw_axes(self) -> None:
        """Arrows along x, y and z of the world, with their names, where the camera looks."""
        scene, length = self.server.scene, 0.35 * self.size
        corner = np.array([-0.75, -0.3, -0.55]) * self.size
        for axis, name, colour in zip(np.eye(3), "xyz", AXIS_COLOURS, strict=True):
            ends = np.stack([corner, corner + length * axis])[None].astype(np.float32)
            r = 0.012 * self.size
            scene.add_arrows(
                f"/axes/{name}", ends, linear(colour),
                shaft_radius=r, head_radius=2.4 * r, head_length=6.0 * r,
            )  # fmt: skip
            tip = ends[0, 1] + 0.15 * length * axis
            scene.add_label(f"/axes/{name}/name", name, position=tip, anchor=_ANCHOR)

    def show(self, position: Floats, q: Floats, follow: int | None = None) -> None:
        """Put the bodies where they are; with the camera on one of them, or on the scene.

        Parameters
        ----------
        position, q : ndarray, shapes (N, 3) [m] and (N, 4)
            Of all bodies.
        """
        if not (np.isfinite(position).all() and np.isfinite(q).all()):
            return
        self.position, self.q = position, q
        self.origin = self.home if follow is None else position[follow]
        shown = self.on_page(position)
        for layer, handle in zip(self.surfaces.layers, self.layers, strict=True):
            turn = q[layer.body]
            if layer.turn is not None:
                turn = quaternion_product(turn.T, layer.turn).T
            handle.batched_positions = shown[layer.body].astype(np.float32)
            handle.batched_wxyzs = turn.astype(np.float32)
        place = tuple(((self.home - self.origin) / self.unit).tolist())
        if tuple(self.fixed.position) != place:
            self.fixed.position = place
        for lines, handle in self.lines:
            handle.points = self.on_page(lines.at(position, q)).astype(np.float32)
            tell(handle, visible=True)

    def on_page(self, places: Floats) -> Floats:
        """Places [m] in the units of the page."""
        return (places - self.origin) / self.unit

    def in_world(self, place: Sequence[float]) -> Floats:
        """A place of the page [m]."""
        return self.origin + self.unit * np.array(place, dtype=np.float64)

    def colour(self, colours: Any) -> None:
        """Colours of all bodies, (N, 3) of 0 to 255."""
        for layer, handle in zip(self.surfaces.layers, self.layers, strict=True):
            handle.batched_colors = linear(colours[layer.body])

    def point(self, name: str, start: Floats, vectors: Floats, thickness: float = 1.0) -> None:
        """Arrows (n, 3) in units of the page from a place [m] on; none where they are empty."""
        handle = self.arrows.get(name)
        self.name_arrow(name, start, vectors)
        if not len(vectors):
            if handle is not None:
                tell(handle, visible=False)
            return
        first = np.tile(self.on_page(start), (len(vectors), 1))
        points = np.stack([first, first + vectors], axis=1).astype(np.float32)
        if handle is None:
            r = 0.018 * self.size * thickness
            self.arrows[name] = self.server.scene.add_arrows(
                f"/arrows/{name}", points, linear(ARROWS[name]),
                shaft_radius=r, head_radius=2.4 * r, head_length=6.0 * r,
            )  # fmt: skip
            return
        handle.points = points
        tell(handle, visible=True)

    def name_arrow(self, name: str, start: Floats, vectors: Floats) -> None:
        """Name an arrow at its free end: a force ends on its body, others begin there.

        A browser moves names a frame later than arrows: what turns fast has none.
        """
        if name not in _ARROW_NAMES:
            return
        label, is_slow = self.arrow_names.get(name), False
        if len(vectors):
            gap = 0.04 * self.size * vectors[0] / max(float(np.linalg.norm(vectors[0])), 1e-300)
            place = self.on_page(start) + (-gap if name == "force" else vectors[0] + gap)
            if label is None:
                label = self.arrow_names[name] = self.server.scene.add_label(
                    f"/arrows/{name}/name", _ARROW_NAMES[name], anchor=_ANCHOR
                )
            way = float(np.linalg.norm(place - label.position))
            is_slow = name == "force" or way < _FAST_MOVE * self.size
            label.position = tuple(place.tolist())
        if label is not None:
            tell(label, visible=is_slow)

    def draw_trail(self, places: Floats) -> None:
        """A line through places (n, 3) [m]."""
        if len(places) > 1:
            shown = self.on_page(places).astype(np.float32)
            self.trail.points = np.stack([shown[:-1], shown[1:]], axis=1)
        tell(self.trail, visible=len(places) > 1)

    def clickable(self, callback: Any) -> None:
        """Call back with the event of every click on a body."""
        for handle in self.layers:
            handle.on_click(callback)


def tell(handle: Any, **values: Any) -> None:
    """Set what a handle of the page has; the browser hears of it only where it is new."""
    for name, value in values.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)


def linear(colours: Any) -> Any:
    """Colours as the page wants them of instances and arrows: proportional to light, not sRGB."""
    return np.rint(255.0 * (np.asarray(colours) / 255.0) ** 2.2).astype(np.uint8)
