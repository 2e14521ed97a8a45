"""Mass properties of one body as a record for machines and as text for people.

`record_of` gathers every number once; `text_of` words a record. SI units, full precision: a number
gives back the same float64.
"""

import math
from typing import Any, Final

import numpy as np

from particlerb.case.matter import Matter
from particlerb.geometry.analytic import Analytic
from particlerb.geometry.fill import differences
from particlerb.geometry.mass_properties import (
    MassProperties,
    Ratios,
    eigen_systems,
    of_kind,
    ratios,
)
from particlerb.geometry.solid import impossible
from particlerb.maths.vec3 import Floats
from particlerb.rotors.rotor_class import NAMES, POINT

UNIT_ROUNDOFF: Final = 2.0**-53
LARGEST_DEFICIT: Final = 64 * UNIT_ROUNDOFF  # of I3: below 0 by so much is rounding
PER_CENT: Final = 100.0


def record_of(
    name: str,
    properties: MassProperties,
    k: int,
    n_particles: int,
    matter: Matter,
    spin: float = 0.0,
    radians_per_step: float = 0.05,
) -> dict[str, Any]:
    """Everything that is known of kind k.

    Parameters
    ----------
    name : str
        What to call it.
    properties : MassProperties
    k : int
        Kind.
    n_particles : int
        That were summed.
    matter : Matter
        What is known beside the sums.
    spin : float [rad/s]
        Fastest angular velocity of bodies of this kind.
    radians_per_step : float
        Of the default step.

    Raises
    ------
    ValueError
        If no body has such moments; with the name and all digits.
    """
    mass, com, tensor, moments, axes, code = (array[k] for array in properties)
    excess = float(moments[0] + moments[1] - moments[2])
    if moments[0] < 0.0 or excess < -LARGEST_DEFICIT * moments[2]:
        raise ValueError(f"{name}: {impossible(moments)}")
    about_origin = tensor + mass * (com @ com * np.eye(3) - np.outer(com, com))
    ratio = ratios_of(properties, k)
    offset = float(ratio.offset[0]) if code != POINT else 0.0
    relative = UNIT_ROUNDOFF * (4.0 + 3.0 * math.hypot(1.0, offset))
    return {
        "name": name,
        "particles": n_particles,
        "mass": float(mass),
        "volume": matter.volume,
        "density": None if matter.volume is None else float(mass) / matter.volume,
        "com": com.tolist(),
        "inertia_tensor": tensor.tolist(),
        "inertia_about_origin": about_origin.tolist(),
        "moments": moments.tolist(),
        "axes": axes.tolist(),
        "radii_of_gyration": np.sqrt(moments / mass).tolist(),
        "triangle_excess": excess,
        "rotor_class": NAMES[int(code)],
        "ratios": {field: float(value[0]) for field, value in ratio._asdict().items()},
        "error": max(relative, matter.error),
        "solid": None if matter.solid is None else solid_record(com, tensor / mass, matter.solid),
        "plain_sum": None if matter.plain is None else plain_record(matter, float(mass)),
        "spin": spin,
        "advised_step": radians_per_step / spin if spin > 0.0 else None,
        "notes": list(matter.notes),
    }


def ratios_of(properties: MassProperties, k: int) -> Ratios:
    """Ratios that decided the rotor class of kind k."""
    mass, com, tensor, *_ = of_kind(properties, k)
    with np.errstate(all="ignore"):
        return ratios(mass, com, tensor, eigen_systems(tensor)[0])


def solid_record(com: Floats, tensor: Floats, solid: Analytic) -> dict[str, float]:
    """How far particles are from the solid that they stand for: shares of its tensor and size."""
    inertia_error, com_error = differences(com, tensor, solid)
    return {"inertia_error": inertia_error, "com_error": com_error}


def plain_record(matter: Matter, mass: float) -> dict[str, Any]:
    """The sum over spheres beside their union, of the same density."""
    plain, exact = matter.plain, matter.exact
    assert plain is not None
    assert exact is not None
    density = mass / (matter.volume or math.nan)
    moments = np.linalg.eigvalsh(plain.inertia), np.linalg.eigvalsh(exact.inertia)
    return {
        "mass": density * plain.volume,
        "com": plain.com.tolist(),
        "inertia_tensor": (density * plain.inertia).tolist(),
        "mass_per_cent": PER_CENT * (plain.volume / exact.volume - 1.0),
        "moments_per_cent": (PER_CENT * (moments[0] / moments[1] - 1.0)).tolist(),
        "com_distance": float(np.linalg.norm(plain.com - exact.com)),
    }


def text_of(record: dict[str, Any]) -> str:
    """A record in words."""
    summed = f"{record['particles']} particle{'s' if record['particles'] != 1 else ''}"
    volume = record["volume"]
    lines = [
        f"{record['name']}: {record['rotor_class']}, {summed}",
        f"  mass                 {numbers(record['mass'])} kg",
        *([] if volume is None else [f"  volume               {numbers(volume)} m³"]),
        *([] if volume is None else [f"  density              {numbers(record['density'])} kg/m³"]),
        f"  centre of mass       {numbers(record['com'])} m",
        *matrix("inertia tensor", record["inertia_tensor"], "kg m², about the centre of mass"),
        *matrix("", record["inertia_about_origin"], "kg m², about the origin of the shape's axes"),
        f"  principal moments    {numbers(record['moments'])} kg m²",
        *matrix("principal axes", record["axes"], "in columns"),
        f"  radii of gyration    {numbers(record['radii_of_gyration'])} m",
        f"  triangle inequality  I1 + I2 − I3 = {numbers(record['triangle_excess'])} kg m²"
        " (0 or more, to rounding)",
        f"  rotor class          {record['rotor_class']}: {reason(record)}",
        f"  error of the sums    {record['error']:.2g} of mass and trace of the tensor, estimated",
        *solid_lines(record["solid"]),
        *plain_lines(record["plain_sum"]),
        f"  step                 {step_text(record)}",
        *(
            f"  {'particles' if k == 0 else '':<19}  {note}"
            for k, note in enumerate(record["notes"])
        ),
    ]
    return "\n".join(lines)


def solid_lines(solid: dict[str, float] | None) -> list[str]:
    """What a staircase of particles costs."""
    if solid is None:
        return []
    inertia, com = solid["inertia_error"], solid["com_error"]
    return [
        f"  beside the solid     tensor per mass off by {inertia:.2g} of its norm, com by {com:.2g}"
        " radii of gyration"
    ]


def plain_lines(plain: dict[str, Any] | None) -> list[str]:
    """What a sum that counts overlaps twice would have been."""
    if plain is None:
        return []
    shares = ", ".join(f"{share:+.3g} %" for share in plain["moments_per_cent"])
    return [
        f"  plain sum            mass {plain['mass_per_cent']:+.3g} %, principal moments {shares},",
        f"                       com {plain['com_distance']:.3g} m away: overlaps counted twice",
    ]


def step_text(record: dict[str, Any]) -> str:
    """Advice for a stepping method."""
    if record["advised_step"] is None:
        return "it does not spin: any; free rotation has a closed form and needs none"
    return (
        f"{record['advised_step']:.3g} s for {record['spin']:.6g} rad/s where something acts;"
        " free rotation has a closed form and needs none"
    )


def numbers(values: float | list[float] | Floats) -> str:
    """Numbers with the digits that give back the same float64."""
    return ", ".join(repr(float(value)) for value in np.atleast_1d(values))


def matrix(name: str, rows: list[list[float]], unit: str) -> list[str]:
    """Lines of a (3, 3) matrix, the first with its name, the last with its unit."""
    heads = (f"  {name:<19}  ", *2 * (" " * 23,))
    ends = ("", "", f"  {unit}")
    return [f"{h}[{numbers(row)}]{end}" for h, row, end in zip(heads, rows, ends, strict=True)]


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
