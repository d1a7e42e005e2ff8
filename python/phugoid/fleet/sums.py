"""Sums over a fleet at trial values of the shared variables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Sums"]

_Array = NDArray[np.float64]


@dataclass
class Sums:
    """Minus the log-likelihood of a fleet, priors counted, as a function of the shared variables, with derivatives.

    value           at ``at``.
    gradient        (n,).
    hessian         (n, n).
    failures        records that are not in the sums: name -> (reason, whether the record itself cannot be used).
    results         what is said of each record, where that was asked for.
    """

    at: _Array
    value: float = 0.0
    gradient: _Array = field(default_factory=lambda: np.zeros(0))
    hessian: _Array = field(default_factory=lambda: np.zeros((0, 0)))
    records: int = 0
    samples: int = 0
    factorizations: int = 0
    failures: dict[str, tuple[str, bool]] = field(default_factory=dict)
    results: list[Mapping[str, Any]] = field(default_factory=list)

    @classmethod
    def of(cls, at: _Array, answers: Iterable[Mapping[str, Any]]) -> Sums:
        """Return the sums over the answers of all parts. The parts are added in their order, so that the result does
        not depend on which worker was first."""
        n = at.size
        found = cls(at, gradient=np.zeros(n), hessian=np.zeros((n, n)))
        for answer in answers:
            found.failures |= answer["failures"]
            if "value" not in answer:
                continue
            found.value += answer["value"]
            found.gradient = found.gradient + answer["gradient"]
            found.hessian = found.hessian + answer["hessian"]
            found.records += answer["records"]
            found.samples += answer["samples"]
            found.factorizations += answer["factorizations"]
            found.results.extend(answer["results"])
        return found
