"""Contacts in colours: those of one colour share no body that moves, so threads may share them.

Each contact gets the first colour that no contact before it has with one of its two bodies, and
contacts stand colour after colour. A colour is cut into chunks; threads take some each, and meet
before the next colour. Sums are those of chunks, in their order. So no bit depends on how many
threads there are. From the first colour with few contacts on, all are the last one, in which one
thread goes from contact to contact, as it does with all where there are few, or where joints or
pistons let several move.
"""

from typing import Final

from particlerb.compiled.barrier import Team, share_of
from particlerb.compiled.jit import inline, kernel
from particlerb.impulses import records as col
from particlerb.impulses.records import Colours, Impulses

_LEAST_SHARE: Final = 80  # of the least number of contacts, in a colour that threads share


@inline
def alone(team: Team) -> Team:
    """One thread of a team by itself."""
    return Team(1, team.thread, team.arrivals, team.values)


@inline
def who_solves(team: Team, colours: Colours) -> Team:
    """All threads where contacts have colours; else the first one, as if it were alone."""
    return team if colours.chunk[colours.counts[0]] > 1 else alone(team)


@inline
def rows_of(team: Team, colours: Colours, i: int) -> tuple[int, int]:
    """Contacts of colour i that this thread takes: in all of a step the same."""
    if team.thread >= team.size:
        return 0, 0
    first, end = share_of(team, colours.chunk[i], colours.chunk[i + 1])
    return colours.row[first], colours.row[end]


@inline
def total(colours: Colours, column: int) -> float:
    """Sum of what was found of all chunks, once all threads have met."""
    found: float = colours.sums[: colours.chunk[colours.counts[0]], column].sum()
    return found


@kernel
def put_in_colours(impulses: Impulses) -> None:
    """Sort the partners and entries of contacts by colour, where there are many."""
    _, partners, rows, count, _, newton = impulses
    colours, m = rows.colours, count[0]
    colours.size[:] = 0
    if m >= colours.counts[1] and partners.mechanisms is None and newton.change.size == 0:
        _sort(impulses)
    row, i, chunks = 0, 0, 0
    while i + 1 < colours.size.size and _LEAST_SHARE * colours.size[i] >= colours.counts[1]:
        end, colours.chunk[i] = row + colours.size[i], chunks
        while row < end:
            colours.row[chunks] = row
            row, chunks = min(row + col.CHUNK, end), chunks + 1
        i += 1
    if row < m or i == 0:
        colours.chunk[i], colours.row[chunks] = chunks, row
        i, chunks = i + 1, chunks + 1
    colours.counts[0], colours.chunk[i], colours.row[chunks] = i, chunks, m


@inline
def _sort(impulses: Impulses) -> None:
    """Find the colour of each contact, and sort them: a counting sort."""
    _, partners, rows, count, _, _ = impulses
    size, listed, used = rows.colours.size, rows.colours.listed, partners.used
    used[:] = 0
    for k in range(count[0]):
        a, b, colour = rows.partner_a[k], rows.partner_b[k], 0
        taken = used[a] | used[b]
        while taken & 1 and colour + 1 < size.size:
            taken, colour = taken >> 1, colour + 1
        for body in (a, b):
            if partners.inverse[body, 0] > 0.0:
                used[body] |= 1 << colour
        listed[k, 0], listed[k, 1], listed[k, 2], listed[k, 3] = a, b, rows.entry[k], colour
        size[colour] += 1
    at = 0
    for i in range(size.size):
        rows.colours.chunk[i], at = at, at + size[i]
    for k in range(count[0]):
        row = rows.colours.chunk[listed[k, 3]]
        rows.colours.chunk[listed[k, 3]] = row + 1
        rows.partner_a[row], rows.partner_b[row] = listed[k, 0], listed[k, 1]
        rows.entry[row] = listed[k, 2]
