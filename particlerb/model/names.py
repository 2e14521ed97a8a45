"""Names of bodies, and which bodies a name stands for. Needs no compiler: readers load it."""

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

_Ints: TypeAlias = NDArray[np.int64]

REFERENCE = re.compile(r"(?P<name>[^\[\]]+)(?:\[(?P<index>\d{1,10})\])?", re.ASCII)
"""All bodies of a record, or one of them: `clump`, `clump[3]`."""


class BodyNames(Sequence[str]):
    """Names of bodies, made when asked for: `cube` alone, `clump[0]`, `clump[1]`, ... .

    Parameters
    ----------
    records : iterable of (str, int)
        Name and number of bodies of each record of a scene, in order.
    part : range, optional
        Bodies of the scene that these are, numbered from 0; default: all.
    n_worlds : int
        Scenes that stand side by side, with the same names in each.
    """

    def __init__(
        self, records: Iterable[tuple[str, int]], part: range | None = None, n_worlds: int = 1
    ) -> None:
        self.records = list(records)
        counts = [0, *(count for _, count in self.records)]
        self.first: _Ints = np.cumsum(np.array(counts, dtype=np.int64))  # and how many there are
        self._number = {name: i for i, (name, _) in enumerate(self.records)}
        self.part = range(int(self.first[-1])) if part is None else part
        self.n_worlds = n_worlds

    @property
    def scene(self) -> "BodyNames":
        """Those of all bodies, where these are a part."""
        return BodyNames(self.records, n_worlds=self.n_worlds)

    def __len__(self) -> int:
        """Number of bodies."""
        return self.n_worlds * len(self.part)

    @overload
    def __getitem__(self, b: int) -> str: ...
    @overload
    def __getitem__(self, b: slice) -> list[str]: ...
    def __getitem__(self, b: int | slice) -> str | list[str]:
        """Name of body b, or of several."""
        if isinstance(b, slice):
            return [self[i] for i in range(*b.indices(len(self)))]
        number = self.part[range(len(self))[b] % len(self.part)]
        record = int(np.searchsorted(self.first, number, side="right")) - 1
        name, count = self.records[record]
        return name if count == 1 else f"{name}[{number - self.first[record]}]"

    def __iter__(self) -> Iterator[str]:
        """All names, a million in a third of a second."""
        for _ in range(self.n_worlds):
            for (name, count), first in zip(self.records, self.first.tolist(), strict=False):
                numbers = range(max(self.part.start - first, 0), min(self.part.stop - first, count))
                yield from (name if count == 1 else f"{name}[{k}]" for k in numbers)

    def find(self, names: str | Sequence[str]) -> _Ints:
        """Indices of the bodies that are named, ascending and each once, shape (n,).

        Parameters
        ----------
        names : str or sequence of str
            `clump` is all bodies of the record, `clump[3]` the fourth of them; what is not in the
            part is left out.

        Raises
        ------
        KeyError
            If there is no such body.
        """
        index = self.find_in_order(names)
        return index if (index[1:] > index[:-1]).all() else np.unique(index)

    def find_in_order(self, names: str | Sequence[str]) -> _Ints:
        """Indices of the bodies as they are named: in this order, and as often; else as `find`.

        Those of several scenes are of one scene after the other.
        """
        listed = [names] if isinstance(names, str) else names
        start, stop = self.part.start, self.part.stop
        spans = [self.span(name) for name in listed]
        ends = [(max(span.start, start), min(span.stop, stop)) for span in spans]
        inside = np.concatenate([np.arange(*end) for end in ends]) - start
        worlds = np.arange(self.n_worlds, dtype=np.int64)[:, None]
        return np.asarray((worlds * len(self.part) + inside).ravel())

    def has(self, name: str) -> bool:
        """Whether there is such a body."""
        try:
            return len(self.span(name)) > 0
        except KeyError:
            return False

    def span(self, name: str) -> range:
        """Bodies of the scene that a name stands for; KeyError where there are none."""
        match = REFERENCE.fullmatch(name)
        if match is None or match["name"] not in self._number:
            raise KeyError(name)
        number = self._number[match["name"]]
        lo, hi = self.first[number : number + 2].tolist()
        if match["index"] is None:
            return range(lo, hi)
        if int(match["index"]) >= hi - lo:
            raise KeyError(name)
        return range(lo + int(match["index"]), lo + int(match["index"]) + 1)
