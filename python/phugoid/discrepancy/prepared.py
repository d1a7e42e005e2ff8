"""The records that a diagnosis searches: without the faults of their sensors, or parts of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

from ..data.experiment import Experiment
from ..fit_result import ENDED_WELL, FitResult
from ..sensitivities.tangents import collocated
from ..solvers import Deadline
from .arguments import check_size
from .search.finding import Finding
from .search.findings import finding_of_sensor_fault, finding_of_unsigned_sensor
from .search.parts import Parts, parts_of
from .search.refit import Refit
from .search.restart import Restart, restarted
from .search.segments import Segments, Thinned, segments_of, thinned
from .search.sensor_fault import SensorFault, UnsignedSensor, sensor_faults, unsigned_sensor, without_faults

__all__ = ["PreparedRecords", "prepared", "within"]

_Found = TypeVar("_Found")


@dataclass(frozen=True, eq=False)
class PreparedRecords:
    """Hold what is searched: the records without the faults of their sensors, or parts of them.

    given     the fit to diagnose, of the records without these faults; ``fit``: of what is searched.
    base      the same, at an optimum; None where there is none.
    others    the validation records, like the records.
    faults, unsigned, restart, thin, parts, segments   what was done to come to this; None or empty where not needed.
    together   why the records held out are searched as well, and nothing is held out, in words; "" where they are not.
    """

    given: FitResult
    fit: FitResult
    base: Refit | None
    others: Sequence[Experiment]
    faults: Sequence[SensorFault] = ()
    unsigned: UnsignedSensor | None = None
    restart: Restart | None = None
    thin: Thinned | None = None
    parts: Parts | None = None
    segments: Segments | None = None
    together: str = ""

    @property
    def causes(self) -> list[str]:
        """Return the causes that were found in the samples themselves."""
        return [f.cause for f in self.faults] + ([self.unsigned.cause] if self.unsigned is not None else [])

    @property
    def findings(self) -> list[Finding]:
        """Return what is reported of these."""
        faults = [finding_of_sensor_fault(f, self.fit.model.time_unit) for f in self.faults]
        return faults + ([finding_of_unsigned_sensor(self.unsigned)] if self.unsigned is not None else [])


def prepared(fit: FitResult, others: Sequence[Experiment], deadline: Deadline) -> PreparedRecords:
    """Return what is searched of a fit and the validation records."""
    no_faults: tuple[list[SensorFault], FitResult] = ([], fit)
    faults, fit = within(deadline, partial(sensor_faults, fit), no_faults)
    others = without_faults(others, faults) if faults else others
    unsigned = within(deadline, partial(unsigned_sensor, fit), None)
    fit = unsigned.fit if unsigned is not None else fit
    begun = collocated(fit) if fit.status in ENDED_WELL else fit
    records = PreparedRecords(fit, begun, None, others, faults, unsigned)
    if begun.status not in ENDED_WELL:
        not_again = f"The fit ended as '{begun.status}', and the diagnosis before it could be estimated again"
        restart = within(deadline, partial(restarted, begun, others), Restart(None, not_again))
        records = replace(records, restart=restart)
        if restart.fit is None:
            return records
        begun = restart.fit
    base = Refit((), begun)
    check_size(base)
    again = records.restart is not None
    thin = None if again else within(deadline, partial(thinned, base, others), None)
    base, others = (base, others) if thin is None else (thin.base, thin.validation)
    segments = records.restart.segments if records.restart is not None else None
    parts = within(deadline, partial(parts_of, base, others), None) if segments is None else None
    base, others = (base, others) if parts is None else (parts.base, parts.validation)
    segments = segments or within(deadline, partial(segments_of, base, others), None)
    base, others = (base, others) if segments is None else (segments.base, segments.validation)
    # That of a fit as it was given is the user's own, on its own mesh.
    own = fit if not again and thin is None and parts is None and segments is None else base.fit
    return replace(records, fit=own, base=base, others=others, thin=thin, parts=parts, segments=segments)


def within(deadline: Deadline, work: Callable[[], _Found], otherwise: _Found) -> _Found:
    """Return what is found within the time limit, or what there is where that, or the user, ends it."""
    try:
        with deadline.in_force():
            return work()
    except KeyboardInterrupt:
        return otherwise
