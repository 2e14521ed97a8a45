"""Mass properties of one body as a record for machines and as text for people.

`record_of` gathers every number once; `text_of` words a record. SI units, full precision: a number
gives back the same float64.
"""

import math
from typing import Any, Final

import numpy as np

from particlerb.case.matter import Matter
from particlerb.export.bodies import NamedBody
from particlerb.geometry import mass_properties
from particlerb.geometry.analytic import Analytic
from particlerb.geometry.fill import differences
from particlerb.geometry.solid import impossible
from particlerb.maths.vec3 import Floats
from particlerb.plan.time_step import RADIANS_PER_STEP
from particlerb.rotors.rotor_class import NAMES, POINT
from particlerb.words import count_of

_UNIT_ROUNDOFF: Final = 2.0**-53
_MAX_DEFICIT: Final = 64 * _UNIT_ROUNDOFF  # of I3: below 0 by so much is rounding
_PER_CENT: Final = 100.0


def record_of(body: NamedBody) -> dict[str, Any]:
    """Everything that is known of a kind of body.

    Raises
    ------
    ValueError
        If no body has such moments; with the name and all digits.
    """
    mass, com, tensor, moments, axes, code = (array[0] for array in body.properties)
    name, matter, spin = body.name, body.matter, body.spin
    excess = float(moments[0] + moments[1] - moments[2])
    if moments[0] < 0.0 or excess < -_MAX_DEFICIT * moments[2]:
        raise ValueError(f"{name}: {impossible(moments)}")
    with np.errstate(all="ignore"):
        eigenvalues, _ = mass_properties.eigen_systems(body.properties.inertia_tensor)
        ratios = mass_properties.ratios(*body.properties[:3], eigenvalues)
    ratio = {key: float(value[0]) for key, value in ratios._asdict().items()}
    offset = 0.0 if code == POINT else ratio["offset"]  # of the com, in radii of gyration
    rounding = _UNIT_ROUNDOFF * (4.0 + 3.0 * math.hypot(1.0, offset))  # of the sums, relative
    return {
        "name": name,
        "particles": len(body.particles.mass),
        "mass": float(mass),
        "volume": matter.volume,
        "density": None if matter.volume is None else float(mass) / matter.volume,
        "com": com.tolist(),
        "inertia_tensor": tensor.tolist(),
        "inertia_about_origin": mass_properties.tensor_off_com(mass, tensor, com).tolist(),
        "moments": moments.tolist(),
        "axes": axes.tolist(),
        "radii_of_gyration": np.sqrt(moments / mass).tolist(),
        "triangle_excess": excess,
        "rotor_class": NAMES[int(code)],
        "ratios": ratio,
        "error": max(rounding, matter.error),
        "solid": _solid_record(com, tensor / mass, matter.solid),
        "plain_sum": _plain_record(matter, float(mass)),
        "spin": spin,
        "advised_step": RADIANS_PER_STEP / spin if spin > 0.0 else None,
        "notes": list(matter.notes),
    }


def _solid_record(com: Floats, tensor: Floats, solid: Analytic | None) -> dict[str, float] | None:
    """How far particles are from the solid that they stand for: shares of its tensor and size."""
    if solid is None:
        return None
    inertia_error, com_error = differences(com, tensor, solid)
    return {"inertia_error": inertia_error, "com_error": com_error}


def _plain_record(matter: Matter, mass: float) -> dict[str, Any] | None:
    """The sum over spheres beside their union, of the same density; None without spheres."""
    plain, exact = matter.plain, matter.exact
    if plain is None or exact is None:
        return None
    density = mass / (matter.volume or math.nan)
    moments = np.linalg.eigvalsh(plain.inertia), np.linalg.eigvalsh(exact.inertia)
    return {
        "mass": density * plain.volume,
        "com": plain.com.tolist(),
        "inertia_tensor": (density * plain.inertia).tolist(),
        "mass_per_cent": _PER_CENT * (plain.volume / exact.volume - 1.0),
        "moments_per_cent": (_PER_CENT * (moments[0] / moments[1] - 1.0)).tolist(),
        "com_distance": float(np.linalg.norm(plain.com - exact.com)),
    }


def text_of(record: dict[str, Any]) -> str:
    """A record in words."""
    volume, excess = record["volume"], numbers(record["triangle_excess"])
    about_com = "kg m², about the centre of mass"
    about_0 = "kg m², about the origin of the shape's axes"
    rows = [
        ("mass", f"{numbers(record['mass'])} kg"),
        *([] if volume is None else [("volume", f"{numbers(volume)} m³")]),
        *([] if volume is None else [("density", f"{numbers(record['density'])} kg/m³")]),
        ("centre of mass", f"{numbers(record['com'])} m"),
        *matrix("inertia tensor", record["inertia_tensor"], about_com),
        *matrix("", record["inertia_about_origin"], about_0),
        ("principal moments", f"{numbers(record['moments'])} kg m²"),
        *matrix("principal axes", record["axes"], "in columns"),
        ("radii of gyration", f"{numbers(record['radii_of_gyration'])} m"),
        ("triangle inequality", f"I1 + I2 − I3 = {excess} kg m² (0 or more, to rounding)"),
        ("rotor class", f"{record['rotor_class']}: {reason(record)}"),
        ("error of the sums", f"{record['error']:.2g} of mass and trace of the tensor, estimated"),
        *_solid_rows(record["solid"]),
        *_plain_rows(record["plain_sum"]),
        ("step", _step_text(record)),
        *(("" if k else "particles", note) for k, note in enumerate(record["notes"])),
    ]
    head = f"{record['name']}: {count_of(record['particles'], 'particle')}"
    return "\n".join([head, *(f"  {name:<19}  {text}" for name, text in rows)])


def _solid_rows(solid: dict[str, float] | None) -> list[tuple[str, str]]:
    """What a staircase of particles costs."""
    if solid is None:
        return []
    inertia, com = solid["inertia_error"], solid["com_error"]
    text = f"tensor per mass off by {inertia:.2g} of its norm, com by {com:.2g} radii of gyration"
    return [("beside the solid", text)]


def _plain_rows(plain: dict[str, Any] | None) -> list[tuple[str, str]]:
    """What a sum that counts overlaps twice would have been."""
    if plain is None:
        return []
    shares = ", ".join(f"{share:+.3g} %" for share in plain["moments_per_cent"])
    return [
        ("plain sum", f"mass {plain['mass_per_cent']:+.3g} %, principal moments {shares},"),
        ("", f"com {plain['com_distance']:.3g} m away: overlaps counted twice"),
    ]


def _step_text(record: dict[str, Any]) -> str:
    """Advice for a stepping method."""
    advice = "it does not spin: any"
    if record["advised_step"] is not None:
        step, spin = record["advised_step"], record["spin"]
        advice = f"{step:.3g} s for {spin:.6g} rad/s where something acts"
    return f"{advice}; free rotation has a closed form and needs none"


def numbers(values: float | list[float] | Floats) -> str:
    """Numbers with the digits that give back the same float64."""
    return ", ".join(repr(float(value)) for value in np.atleast_1d(values))


def matrix(name: str, rows: list[list[float]], unit: str) -> list[tuple[str, str]]:
    """Rows of a (3, 3) matrix, the first with its name, the last with its unit."""
    first, middle, last = (f"[{numbers(row)}]" for row in rows)
    return [(name, first), ("", middle), ("", f"{last}  {unit}")]


def reason(record: dict[str, Any]) -> str:
    """Ratios that decided the class, beside the thresholds."""
    ratio = record["ratios"]
    if record["rotor_class"] == NAMES[POINT]:
        return "it has no extent beyond the rounding of its place"
    return (
        f"I1/I3 = {ratio['smallest']:.3g} (zero up to {ratio['zero_below']:.2g}),"
        f" (I2 − I1)/I3 = {ratio['lower_gap']:.3g}, (I3 − I2)/I3 = {ratio['upper_gap']:.3g}"
        f" (equal up to {ratio['equal_below']:.2g}), |com|/g = {ratio['offset']:.3g}"
    )
