"""What a browser may say: four kinds of message, each looked at in full before it changes anything.

viser takes from every browser whatever it can decode: any attribute of any field, uploads into a
field that takes none, a tunnel to the open net. Here a message has the types and ranges of what
our page sends, or it is dropped. What goes on is written anew from the values that were looked at.
"""

import io
import math
from typing import Annotated, Any, Final

import msgspec
import viser

_MAX_TEXT_LENGTH: Final = 300  # characters of a field
_MAX_NUMBER: Final = 1e30  # of a camera or a ray, in units of the page
_MAX_PIXELS: Final = 4_000_000  # of a picture
_MAX_MESSAGE_BYTES: Final = 10_000  # of a message that is no picture

Pair = tuple[float, float]
_Triple = tuple[float, float, float]
_Pixels = Annotated[int, msgspec.Meta(ge=0, le=100_000)]
_Word = Annotated[str, msgspec.Meta(max_length=100)]


class _Camera(msgspec.Struct, forbid_unknown_fields=True, tag="ViewerCameraMessage"):
    """Where someone looks from."""

    wxyz: tuple[float, float, float, float]
    position: _Triple
    fov: float
    near: float
    far: float
    image_height: _Pixels
    image_width: _Pixels
    look_at: _Triple
    up_direction: _Triple


class _Click(msgspec.Struct, forbid_unknown_fields=True, tag="SceneNodeClickMessage"):
    """A ray through a body."""

    name: _Word
    instance_index: Annotated[int, msgspec.Meta(ge=0, lt=2**31)] | None
    ray_origin: _Triple
    ray_direction: _Triple
    screen_pos: Pair
    modifier: _Word | None = None
    owner: _Word = ""


class Update(msgspec.Struct, forbid_unknown_fields=True, tag="GuiUpdateMessage"):
    """What a field or a button says."""

    uuid: _Word
    updates: dict[_Word, Any]


class _Picture(msgspec.Struct, forbid_unknown_fields=True, tag="GetRenderResponseMessage"):
    """What someone sees."""

    payload: bytes
    render_uuid: _Word


_MESSAGE_DECODER: Final = msgspec.msgpack.Decoder(_Camera | _Click | Update | _Picture)


class Sieve:
    """Lets through what our page sends; `server` is None until there is one."""

    def __init__(self) -> None:
        self.server: viser.ViserServer | None = None

    def __call__(self, raw: str | bytes) -> bytes | None:
        """The message as it may go on; None where it may not."""
        if self.server is None or isinstance(raw, str):
            return None
        try:
            message = _MESSAGE_DECODER.decode(raw)
            if not (isinstance(message, _Picture) or len(raw) <= _MAX_MESSAGE_BYTES):
                return None
            return msgspec.msgpack.encode(message) if self.takes(message) else None
        except (msgspec.MsgspecError, ValueError, OverflowError, RecursionError):
            return None

    def takes(self, message: _Camera | _Click | Update | _Picture) -> bool:
        """Whether the values of a message can be, for what is on the page."""
        match message:
            case _Picture():
                return _is_picture(message.payload)
            case Update():
                return self.takes_update(message)
            case _Click():
                assert self.server is not None
                return (
                    _are_numbers((*message.ray_origin, *message.ray_direction, *message.screen_pos))
                    and any(message.ray_direction)
                    and self.server.scene.get_handle_by_name(message.name) is not None
                )
        vectors = *message.wxyz, *message.position, *message.look_at, *message.up_direction
        return _are_numbers((*vectors, message.fov, message.near, message.far))

    def takes_update(self, message: Update) -> bool:
        """Whether a field is there and can have this value, and nothing but a value is set."""
        assert self.server is not None
        field: Any = self.server.gui._gui_input_handle_from_uuid.get(message.uuid)
        if field is None or set(message.updates) != {"value"}:
            return False
        value = message.updates["value"]
        match field:
            case viser.GuiTextHandle():
                return isinstance(value, str) and len(value) <= _MAX_TEXT_LENGTH
            case viser.GuiCheckboxHandle() | viser.GuiButtonHandle():
                return isinstance(value, bool)
            case viser.GuiDropdownHandle() | viser.GuiButtonGroupHandle():
                return isinstance(value, str) and value in field.options
            case viser.GuiSliderHandle():
                return (
                    type(value) in (int, float)
                    and field.min <= value <= field.max
                    and (isinstance(field.value, float) or value == int(value))
                )
        return False


def _are_numbers(values: tuple[float, ...]) -> bool:
    """Whether all are finite and of a size that a screen can have to do with."""
    return all(math.isfinite(value) and abs(value) <= _MAX_NUMBER for value in values)


def _is_picture(data: bytes) -> bool:
    """Whether these are the bytes of a JPEG of a size that was asked for; only its head is read."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data), formats=("JPEG",)) as image:
            return 0 < image.width * image.height <= _MAX_PIXELS
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return False
