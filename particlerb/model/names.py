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
    """Names of all bodies, made when asked for: `cube` alone, `clump[0]`, `clump[1]`, ... .

    Parameters
    ----------
    records : iterable of (str, int)
        Name and number of bodies of each record, in order.
    """

    def __init__(self, records: Iterable[tuple[str, int]]) -> None:
        self.records = list(records)
        counts = [0, *(count for _, count in self.records)]
        self.first: _Ints = np.cumsum(np.array(counts, dtype=np.int64))  # and how many there are
        self._number = {name: i for i, (name, _) in enumerate(self.records)}
        self.range = range(int(self.first[-1]))

    def __len__(self) -> int:
        """Number of bodies."""
        return len(self.range)

    @overload
    def __getitem__(self, b: int) -> str: ...
    @overload
    def __getitem__(self, b: slice) -> list[str]: ...
    def __getitem__(self, b: int | slice) -> str | list[str]:
        """Name of body b, or of several."""
        if isinstance(b, slice):
            return [self[i] for i in range(*b.indices(len(self)))]
        number = self.range[b]
        record = int(np.searchsorted(self.first, number, side="right")) - 1
        name, count = self.records[record]
        return name if count == 1 else f"{name}[{number - self.first[record]}]"

    def __iter__(self) -> Iterator[str]:
        """All names, a million in a third of a second."""
        for name, count in self.records:
            if count == 1:
                yield name
            else:
                yield from (f"{name}[{k}]" for k in range(count))

    def find(self, names: str | Sequence[str]) -> _Ints:
        """Indices of the bodies that are named, ascending and each once, shape (n,).

        Parameters
        ----------
        names : str or sequence of str
            `clump` is all bodies of the record, `clump[3]` the fourth of them.

        Raises
        ------
        KeyError
            If there is no such body.
        """
        return np.unique(self.find_in_order(names))

    def find_in_order(self, names: str | Sequence[str]) -> _Ints:
        """Indices of the bodies as they are named: in this order, and as often; else as `find`."""
        listed = [names] if isinstance(names, str) else names
        return np.concatenate([self._find_one(name) for name in listed])

    def _find_one(self, name: str) -> _Ints:
        match = REFERENCE.fullmatch(name)
        if match is None or match["name"] not in self._number:
            raise KeyError(name)
        number = self._number[match["name"]]
        lo, hi = self.first[number], self.first[number + 1]
        if match["index"] is None:
            return np.arange(lo, hi)
        if int(match["index"]) >= hi - lo:
            raise KeyError(name)
        return np.array([lo + int(match["index"])])


class NamesInRange(BodyNames):
    """Names of the bodies of a scene from `first` to `stop`, numbered from 0.

    Parameters
    ----------
    records : iterable of (str, int)
        Of the whole scene.
    first, stop : int
        Which bodies these are.
    """

    def __init__(self, records: Iterable[tuple[str, int]], first: int, stop: int) -> None:
        super().__init__(records)
        self.range = range(first, stop)

    def __iter__(self) -> Iterator[str]:
        """All names."""
        return (self[b] for b in range(len(self)))

    def find_in_order(self, names: str | Sequence[str]) -> _Ints:
        """As for the whole scene, without bodies that are not in the range."""
        found = super().find_in_order(names)
        inside = (found >= self.range.start) & (found < self.range.stop)
        return found[inside] - self.range.start


class NamesInWorlds(BodyNames):
    """Names of the bodies of scenes that stand side by side: in each scene the same.

    Parameters
    ----------
    records : iterable of (str, int)
        Of one scene.
    n_worlds : int
        Scenes.
    """

    def __init__(self, records: Iterable[tuple[str, int]], n_worlds: int) -> None:
        super().__init__(records)
        self.n_worlds, self.in_each = n_worlds, super().__len__()

    def __len__(self) -> int:
        """Number of bodies."""
        return self.n_worlds * self.in_each

    @overload
    def __getitem__(self, b: int) -> str: ...
    @overload
    def __getitem__(self, b: slice) -> list[str]: ...
    def __getitem__(self, b: int | slice) -> str | list[str]:
        """Name of body b in its scene, or of several."""
        if isinstance(b, slice):
            return [self[i] for i in range(*b.indices(len(self)))]
        return super().__getitem__(range(len(self))[b] % self.in_each)

    def __iter__(self) -> Iterator[str]:
        """All names."""
        for _ in range(self.n_worlds):
            yield from super().__iter__()

    def find_in_order(self, names: str | Sequence[str]) -> _Ints:
        """As for one scene, in one scene after the other."""
        found = super().find_in_order(names)
        worlds = np.arange(self.n_worlds, dtype=np.int64)[:, None]
        return (worlds * self.in_each + found).ravel()
