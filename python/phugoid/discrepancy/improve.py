"""Repeated diagnosis: named causes are added to the model, until no further cause is named."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..data.experiment import Experiment, as_experiments
from ..errors import OptionError
from ..fit_result import FitResult
from ..notebook import Rows, overview
from ..parameters import text_table
from ..solvers import limited
from .candidates.candidate import Candidate
from .candidates.collection import Candidates
from .diagnose import diagnose
from .misfit.phrases import number, percent
from .search.finding import DiagnosisResult, Finding, Gain

__all__ = ["ImprovementResult", "ImprovementStep", "improve"]

_STEPS = 5


@dataclass(frozen=True, eq=False)
class ImprovementStep:
    """One diagnosis, and what was made of it.

    diagnosis  of the model at that step.
    added      names of the causes that were put into the model, of ``findings`` (canonical, ``where:what``); inputs
               that act otherwise than they are recorded are among them.
    rejected   finding -> why it was left out: "minor", "surrogate", "unexplained", or "no term of a model".
    gain       of the extended model over that of the step; None where nothing was added.
    """

    diagnosis: DiagnosisResult
    added: tuple[str, ...]
    rejected: Mapping[str, str]
    gain: Gain | None


@dataclass(frozen=True, eq=False, repr=False)
class ImprovementResult:
    """What `improve` came to.

    fit    of the last model.
    steps  one after the other; the last is the diagnosis of the last model, which adds nothing (unless there were as
           many steps as were allowed).
    """

    fit: FitResult
    steps: tuple[ImprovementStep, ...]

    @property
    def added(self) -> tuple[str, ...]:
        """All that was added, in order."""
        return tuple(name for step in self.steps for name in step.added)

    @property
    def verdict(self) -> str:
        """What the last diagnosis came to; see `Diagnosis.verdict`."""
        return self.steps[-1].diagnosis.verdict

    @property
    def interrupted(self) -> bool:
        """Return whether Ctrl-C or the time limit ended the last diagnosis: a complete one may name other causes."""
        return self.steps[-1].diagnosis.interrupted

    def summary(self) -> str:
        """Return a table of the steps: what was added, the part of the misfit that it explains, the RMS of each output
        on data held out before and after; and what was rejected, with the reason."""
        return "\n\n".join([text_table(*self._rows()), *self._remarks()])

    def _repr_html_(self) -> str:
        title = f"{self.steps[0].diagnosis.fit.model.name}: improvement"
        return overview(title, self._rows(), remarks=self._remarks(), note=self.verdict)

    def _rows(self) -> Rows:
        rows = []
        for i, step in enumerate(self.steps, start=1):
            parts = [f.explained for f in step.diagnosis.findings if f.cause in step.added and np.isfinite(f.explained)]
            rows.append(
                [
                    str(i),
                    ", ".join(step.added) or f"({step.diagnosis.verdict})",
                    percent(min(sum(parts), 1.0)) if parts else "",
                    _changes(step.gain),
                ]
            )
        return ["step", "added", "explains", "RMS, held out or of the fit"], rows, "rlrl"

    def _remarks(self) -> list[str]:
        lines = []
        rejected = {name: why for step in self.steps for name, why in step.rejected.items()}
        if rejected:
            lines.append("Not added: " + ", ".join(f"{name} ({why})" for name, why in rejected.items()) + ".")
        if self.interrupted:
            lines.append(
                "The last diagnosis was ended by Ctrl-C or the time limit before it was complete: what it found is "
                "preliminary, and a complete one may name other causes."
            )
        return lines

    def __repr__(self) -> str:
        early = ", ended early" if self.interrupted else ""
        model = self.steps[0].diagnosis.fit.model.name
        return f"<Improvement of '{model}' by {', '.join(self.added) or 'nothing'}{early}>"


def _changes(gain: Gain | None) -> str:
    """Return by how much the RMS of each output changes, on data held out where there are any."""
    if gain is None:
        return ""
    held = bool(gain.held_out_rms_before)
    found = {name: gain.change(name, held_out=held) for name in gain.channels}
    return ", ".join(f"{name} {number(100.0 * c, 2)} %" for name, c in found.items() if np.isfinite(c))


def improve(
    fit: FitResult,
    validation: Experiment | Sequence[Experiment] | None = None,
    *,
    candidates: Candidates | Sequence[Candidate] | Mapping[str, Any] | None = None,
    biases: Sequence[str] | None = None,
    steps: int = _STEPS,
    progress: bool | Callable[[str], None] = False,
    time_limit: float | None = None,
) -> ImprovementResult:
    """Diagnose a fit, add the named causes, and diagnose again, until no cause is named.

    The arguments are those of `diagnose`; ``steps`` is the most diagnoses, ``time_limit`` in seconds is that of all.
    Inputs that are found to be held between their samples, or to be recorded with noise, are held or filtered from
    then on, in the validation records too.
    Disturbances are not terms of a model and are not put in. Ctrl-C and the time limit end it with what was found.

    Raises as `diagnose` does, for the first model; OptionError for a number of steps below 1.
    """
    if not isinstance(steps, int) or isinstance(steps, bool) or steps < 1:
        raise OptionError(f"improve: steps is a whole number from 1, not {steps!r}")
    deadline = limited("improve", time_limit)
    others = None if validation is None else as_experiments(validation, "improve: validation")
    own: Any = candidates
    done: list[ImprovementStep] = []
    current = fit
    for _ in range(steps):
        d = diagnose(current, own, others, biases=biases, progress=progress, time_limit=deadline.left())
        extension = d.extend()
        added = (*d._inputs, *extension.added)
        rejected = {_label(f): _reason(f) for f in d.findings if f.cause not in added}
        done.append(ImprovementStep(d, added, rejected, extension.gain if added else None))
        if not added:
            break
        current = extension.fit
        if others is not None:
            others = list(d._validation)
        if d.interrupted or deadline.passed():
            break
        own = _left(candidates, {name for step in done for name in step.added})
    return ImprovementResult(current, tuple(done))


def _left(candidates: Any, taken: Collection[str]) -> Any:
    """Candidates that are not in the model yet; the library's where terms of one's own were given, for the model has
    those that were right."""
    if candidates is None or isinstance(candidates, Mapping):
        return None
    left = [c for c in candidates if c.name not in taken]
    return Candidates(left) if isinstance(candidates, Candidates) else left


def _label(finding: Finding) -> str:
    return finding.cause or (finding.aliases[0] if finding.aliases else "a cause not established")


def _reason(finding: Finding) -> str:
    if finding.status != "named":
        return finding.status
    # What has parameters could be a term: it was fitted, and the validation records do not have it.
    return (
        "of its record alone" if finding.coefficient == finding.coefficient and finding.units else "no term of a model"
    )
