"""`mass`: mass properties of the bodies of a case, of a table of points or spheres."""

import argparse
import json

from particlerb.cli.bodies import named_bodies
from particlerb.cli.exit_codes import DONE, Ending
from particlerb.plan.time_step import RADIANS_PER_STEP
from particlerb.studies.mass_report import record_of, text_of


def mass_command(options: argparse.Namespace) -> int:
    """Print the mass properties of distinct bodies."""
    records = []
    for body in named_bodies(options, options.body):
        known = body.name, body.properties, 0, len(body.particles.mass), body.matter, body.spin
        try:
            records.append(record_of(*known, RADIANS_PER_STEP))
        except ValueError as error:
            raise Ending(f"{options.file}: {error}") from None
    if options.json:
        print(json.dumps(records))
    else:
        print("\n\n".join(map(text_of, records)))
    return DONE
