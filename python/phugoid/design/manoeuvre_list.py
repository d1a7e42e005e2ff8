"""Manoeuvres that were found in a record: their spans as a table, a figure, and records cut out of the log."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, TypeAlias, overload

from ..data.experiment import Experiment
from ..errors import ByName, DataError, OptionError
from ..figures import INPUT, SERIES, WIDTH, Panels, labelled, plain, styled
from ..notebook import notebook_page, table
from ..parameters import text_table
from ..tabular import package
from ..time_unit import UNKNOWN, TimeUnit

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Kind", "Manoeuvre", "Manoeuvres"]

Kind: TypeAlias = Literal[
    "step", "pulse", "doublet", "3-2-1-1", "multistep", "sweep", "sine", "multisine", "continuous", "other"
]

_COLOURS: Mapping[str, int] = {"step": 0, "pulse": 0, "doublet": 1, "3-2-1-1": 1, "multistep": 1, "sweep": 2, "sine": 4}


@dataclass(frozen=True)
class Manoeuvre:
    """A span of a record in which one input is excited.

    input      the input.
    kind       "step", "pulse", "doublet", "3-2-1-1", "multistep" (other steps), "sweep", "sine", "multisine",
               "continuous" (longer than a manoeuvre, as under a pilot or an autopilot), or "other".
    start, end s.
    amplitude  greatest deviation from the level before, in ``unit``.
    band       lowest and highest frequency that hold the excitation, Hz: 5 and 95 % of its energy.
    snr        output -> standard deviation of its motion in the span over that of its noise, which is estimated from
               its differences.
    together   other input that is excited in the same span -> its correlation with this one. Effects of inputs whose
               correlation is near 1 or -1 cannot be distinguished.
    """

    input: str
    kind: Kind
    start: float
    end: float
    amplitude: float
    band: tuple[float, float]
    unit: str = ""
    snr: Mapping[str, float] = field(default_factory=dict)
    together: Mapping[str, float] = field(default_factory=dict)
    time_unit: TimeUnit = UNKNOWN

    def __post_init__(self) -> None:
        object.__setattr__(self, "snr", ByName("output", self.snr))

    @property
    def span(self) -> tuple[float, float]:
        """Start and end, s."""
        return self.start, self.end

    def __str__(self) -> str:
        span = self.time_unit.of(f"{self.start:.1f} to {self.end:.1f}")
        return f"{self.kind} of {self.input}, {span}"


class Manoeuvres(Sequence[Manoeuvre]):
    """The manoeuvres of a record in order of time, as `phugoid.manoeuvres` found them."""

    def __init__(self, record: Experiment, found: Sequence[Manoeuvre]) -> None:
        self._record, self._found = record, tuple(found)

    @overload
    def __getitem__(self, i: int) -> Manoeuvre: ...
    @overload
    def __getitem__(self, i: slice) -> Manoeuvres: ...
    def __getitem__(self, i: int | slice) -> Manoeuvre | Manoeuvres:
        return Manoeuvres(self._record, self._found[i]) if isinstance(i, slice) else self._found[i]

    def __len__(self) -> int:
        return len(self._found)

    def __iter__(self) -> Iterator[Manoeuvre]:
        return iter(self._found)

    def of(self, *names: str) -> Manoeuvres:
        """Return the manoeuvres of some inputs or kinds alone, as in ``found.of("de", "doublet", "3-2-1-1")``.

        Names of inputs and of kinds both narrow the choice. Raises OptionError for a name that is neither.
        """
        inputs, kinds = {m.input for m in self}, set(Kind.__args__)  # type: ignore[attr-defined]
        for name in names:
            if name not in kinds and name not in self._record.inputs and name not in inputs:
                raise OptionError(f"of: '{name}' is neither an input of '{self._record.name}' nor a kind of manoeuvre")
        own, wanted = set(names) - kinds, set(names) & kinds
        chosen = [m for m in self if (not own or m.input in own) and (not wanted or m.kind in wanted)]
        return Manoeuvres(self._record, chosen)

    def cut(self, before: float = 1.0, after: float = 3.0) -> list[Experiment]:
        """Return the records of the manoeuvres, each from ``before`` before its start to ``after`` after its end.

        Spans that overlap are one record, so that no sample is in two. They are called ``name[1]``, ``name[2]``, ...
        Raises OptionError for lengths that are not numbers from 0, DataError where there are no manoeuvres.
        """
        for what, value in (("before", before), ("after", after)):
            if not (isinstance(value, (int, float)) and 0 <= value < math.inf):
                raise OptionError(f"cut: {what} is a number from 0, not {value!r}")
        if not self._found:
            raise DataError(f"cut: no manoeuvres were found in '{self._record.name}'")
        return self._record.cut([(m.start - before, m.end + after) for m in self])

    def _rows(self) -> tuple[list[str], list[list[str]], str]:
        time = self._record.time_unit
        heads = ["", "input", "kind", time.axis("start"), time.axis("end"), "amplitude", "unit"]
        heads += [f"band, {time.frequency}" if time else "band", "signal/noise", "together"]
        rows = []
        for i, m in enumerate(self):
            ratios = "  ".join(f"{n} {v:.3g}" for n, v in m.snr.items() if math.isfinite(v))
            others = "  ".join(f"{n} ({v:+.2f})" if math.isfinite(v) else n for n, v in m.together.items())
            band = f"{m.band[0]:.2g} to {m.band[1]:.2g}" if all(map(math.isfinite, m.band)) else ""
            spans = [f"{m.start:.2f}", f"{m.end:.2f}", f"{m.amplitude:.3g}"]
            rows.append([str(i), m.input, m.kind, *spans, m.unit, band, ratios, others])
        return heads, rows, "rllrrrllll"

    def summary(self) -> str:
        """Return the manoeuvres as a plain-text table."""
        title = f"{self._record.name}: {self._counts()}"
        return f"{title}\n\n{text_table(*self._rows())}" if self._found else title

    def to_pandas(self) -> pandas.DataFrame:
        """Return a table with a row for each manoeuvre: input, kind, start, end, amplitude, unit, band_low, band_high,
        ``snr_<output>``. Raises MissingDependency without pandas.
        """
        pd = package("pandas", "to_pandas")
        plain_fields = ("input", "kind", "start", "end", "amplitude", "unit")
        return pd.DataFrame(
            [
                {
                    **{n: getattr(m, n) for n in plain_fields},
                    "band_low": m.band[0],
                    "band_high": m.band[1],
                    **{f"snr_{n}": v for n, v in m.snr.items()},
                }
                for m in self
            ]
        )

    def plot(self) -> tuple[Figure, dict[str, Axes]]:
        """Plot the inputs over time with the spans of their manoeuvres; return the figure and its axes by input."""
        names = list(dict.fromkeys([*self._record.inputs, *(m.input for m in self)]))
        with styled() as plt:
            figure, grid = plt.subplots(
                len(names), 1, sharex=True, squeeze=False, figsize=(WIDTH, 1.0 + 1.1 * len(names)), layout="constrained"
            )
            axes: dict[str, Axes] = dict(zip(names, grid[:, 0], strict=True))
            for name, axis in axes.items():
                axis.plot(*self._record.samples(name), color=INPUT, linewidth=0.6)
                axis.set_ylabel(plain(labelled(name, self._record.units)))
                for i, m in enumerate(self):
                    if m.input == name:
                        colour = SERIES[_COLOURS.get(m.kind, 3)][0]
                        axis.axvspan(m.start, m.end, color=colour, alpha=0.25, linewidth=0.0)
                        wide = m.end - m.start > 0.06 * (self._record.t[-1] - self._record.t[0])
                        text = f"{i} {m.kind}" if wide else str(i)
                        axis.text(m.start, 1.0, text, transform=axis.get_xaxis_transform(), fontsize=6, va="bottom")
            grid[-1, 0].set_xlabel(plain(self._record.time_unit.axis()))
        return figure, Panels(axes)

    def _repr_html_(self) -> str:
        return notebook_page(self._record.name, table(*self._rows()), note=self._counts())

    def __repr__(self) -> str:
        return f"<Manoeuvres of '{self._record.name}': {self._counts()}>"

    def _counts(self) -> str:
        moving = sum(m.kind == "continuous" for m in self)
        found = f"{len(self) - moving} manoeuvre{'' if len(self) - moving == 1 else 's'}"
        return f"{found}, {moving} continuous span{'' if moving == 1 else 's'}" if moving else found

    def __str__(self) -> str:
        return self.summary()
