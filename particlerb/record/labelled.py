"""Trajectories as labelled arrays of xarray, tables of pandas, pictures, and in a line.

No such library is needed for anything else, so that each is loaded when it is asked for.
"""

from collections.abc import Sequence
from functools import cached_property
from html import escape
from importlib import import_module
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from particlerb.maths.vec3 import Floats
from particlerb.record import schema
from particlerb.record.frame_reader import FrameReader

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


class LabelledReader(FrameReader):
    """Frames with the names of what they show."""

    @property
    def time(self) -> Floats:
        """Times of the frames [s], shape (T,)."""
        return self.series(schema.TIME)

    @cached_property
    def names(self) -> Sequence[str]:
        """Names of the bodies."""
        names = self.table(f"{schema.BODIES}/names", "S", (self.n_bodies,))
        return [name.decode(errors="replace") for name in names]

    def __repr__(self) -> str:
        """What it holds, in a line."""
        return f"<Trajectory: {'; '.join(f'{word}: {text}' for word, text in self._summary())}>"

    def _repr_html_(self) -> str:
        """The same as a table, for notebooks."""
        facts = self._summary()
        rows = (f"<tr><th>{word}</th><td>{escape(text)}</td></tr>" for word, text in facts)
        return f"<table><caption>Trajectory</caption>{''.join(rows)}</table>"

    def _summary(self) -> list[tuple[str, str]]:
        """What it holds: pairs of a word and a text."""
        if not self.file:
            return [("frames", f"{self.n_frames}, closed")]
        n, time, names = self.n_frames, self.time, self.names
        span = f"{n} from {time[0]:g} to {time[-1]:g} s" if n else "none"
        shown = ", ".join([names[b] for b in range(min(len(names), 3))])
        more = f", ... ({len(names)})" if len(names) > 3 else ""
        fields = ", ".join([*self.fields, *self.other_fields])
        lines = [("frames", span), ("bodies", shown + more), ("fields", fields)]
        if n:
            error = np.abs(self.series(f"{schema.OBSERVABLES}/energy_error/value")).max()
            lines.append(("energy error", f"{error:.2g} J"))
        return lines

    def plot(self, path: str | PathLike[str] | None = None, *, body: str | None = None) -> Any:
        """Draw it, as `particlerb.plot`.

        Parameters
        ----------
        path : str or Path, optional
            Picture to write: .png, .svg or .pdf.
        body : str, optional
            Whose rotation is drawn; default: panels that fit the scene.

        Returns
        -------
        matplotlib Figure
        """
        return import_module("particlerb").plot(self, path, body=body)

    def view(self, *, port: int = 8080, browser: bool = True) -> Any:
        """Play it on a page of this machine, which a thread of this program serves.

        Parameters
        ----------
        port : int
            Where it listens; the next free one where it is taken.
        browser : bool
            Whether to open a browser, where there is a screen.

        Returns
        -------
        particlerb.view.showing.Shown
            With the `address` of the page; `close()` ends it, `wait()` keeps a script until Ctrl-C.
            The trajectory stays open meanwhile.

        Raises
        ------
        ImportError
            If viser is not installed: `pip install "particlerb[view]"`.
        ReplayError
            If positions, orientations or the files of the case are missing.
        """
        return import_module("particlerb.view.showing").Shown(self, port, browser)

    def to_xarray(self) -> "xr.Dataset":
        """All that was recorded per frame, with units; a copy in memory.

        Dimensions are time [s], bodies, walls, joints and coordinates by their names, xyz and wxyz.
        Totals over all bodies whose names are those of fields begin with `total_`; lists of
        contacts, of which each frame has another number, are left out.

        Raises
        ------
        ImportError
            If xarray is not installed.
        """
        xarray = _library("xarray", "to_xarray")
        labels: dict[str, Any] = {"time": ("time", self.time, {"units": "s"})}
        variables = {}
        for path, element in schema.series_of([*self.fields, *self.other_fields]).items():
            if path == schema.TIME:
                continue
            place, name = path.split("/")[-3:-1]
            if place == schema.OBSERVABLES and name in schema.FIELDS:
                name = f"total_{name}"
            if element.per:
                names = self.names if element.per == "body" else self.names_of(element.per)
                labels[element.per] = list(names)
            if element.components:
                labels[element.components] = list(element.components)
            sizes = [one for one in (element.per, element.components) if one]
            about = {"units": element.units, "long_name": element.meaning}
            variables[name] = (("time", *sizes), self.series(path), about)
        return xarray.Dataset(variables, labels)

    def to_pandas(self) -> "pd.DataFrame":
        """A row per frame and body, index (time [s], body), columns as `position_x` [SI units].

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        pandas = _library("pandas", "to_pandas")
        columns = {}
        for name, element in (schema.FIELDS | schema.CONTACT_FIELDS).items():
            if name not in (*self.fields, *self.other_fields):
                continue
            values = self.series(f"{schema.TRAJECTORY}/{name}/value")
            for k, letter in enumerate(element.components or ("",)):
                key = f"{name}_{letter}" if letter else name
                columns[key] = (values[..., k] if letter else values).ravel()
        labels = [self.time, list(self.names)]
        index = pandas.MultiIndex.from_product(labels, names=["time", "body"])
        return pandas.DataFrame(columns, index)


def _library(name: str, method: str) -> Any:
    """Load a library that particlerb does not need by itself.

    Raises
    ------
    ImportError
        If it is not installed: what to do.
    """
    try:
        return import_module(name)
    except ImportError:
        raise ImportError(f"{method} needs {name}: pip install {name}") from None
