"""Command `check`: the plan of a case, and how large and how long its run will be."""

import argparse
import json
from time import perf_counter

from particlerb.cli.common import amount, fitted, wall_time
from particlerb.cli.exit_codes import DONE, FAILED, ending, tamed
from particlerb.cli.run import expected_size, plan_text, prepared_case, size_text
from particlerb.ranks import NoRanksError
from particlerb.simulation.estimate import estimated_seconds
from particlerb.simulation.shares import Shares, shares_of
from particlerb.simulation.whole_run import RunError


def check_command(options: argparse.Namespace) -> int:
    """`check`: the plan, the size and the time of a run, and how ranks would share it."""
    prepared = prepared_case(options)
    with ending(NoRanksError):
        shares = shares_of(prepared, options.ranks) if options.ranks else None
    until_now = perf_counter() - options.started  # as a warm run before its first step
    with ending(RunError, code=FAILED, about=f"{options.case} can be run, but fails soon"):
        seconds = until_now + estimated_seconds(prepared)
    if options.json:
        told: dict[str, object] = {"plan": plan_text(options, prepared)}
        told |= {"warnings": prepared.plan.warnings, "bytes": expected_size(prepared.system)}
        told |= {"seconds": seconds}
        told |= {"ranks": shares._asdict()} if shares is not None else {}
        print(json.dumps(told))
    else:
        size, time = size_text(prepared.system), wall_time(seconds)
        plan = f"{plan_text(options, prepared)}\n  run             {size}; about {time}"
        plan += "" if shares is None else f"\n{_words(options.ranks, shares)}"
        print(tamed(f"{options.case} is valid\n\nplan\n{fitted(plan)}"))
    return DONE


def _words(n_ranks: int, shares: Shares) -> str:
    """Shares in words."""
    sends = "they send nothing while bodies move"
    if shares.bytes_of_step and not shares.copies_of_rank:
        sends = f"they share a sum, and receive {amount(shares.bytes_of_step)} for each"
    elif shares.sensible_ranks is not None:
        sends = (
            f"a rank has copies of {shares.copies_of_rank} bodies of others or less, at the start,"
            f" and receives {amount(shares.bytes_of_step)} a step;"
            f" at {shares.sensible_ranks} or fewer the exchange costs less than it saves"
        )
    lines = (
        f"parts of the file: {shares.parts}, of {shares.bodies_of_part} bodies or less and"
        f" {amount(shares.bytes_of_part)} each",
        f"a rank moves {shares.bodies_of_rank} bodies or less, in about"
        f" {amount(shares.run_bytes)} of memory;",
        f"and each rank sets up the whole scene, in about {amount(shares.set_up_bytes)}",
        f"{shares.ranks_at_most} ranks at most; {sends}",
    )
    heads = (f"  on {n_ranks} ranks", *3 * [""])
    return "\n".join(f"{head:18}{words}" for head, words in zip(heads, lines, strict=True))
