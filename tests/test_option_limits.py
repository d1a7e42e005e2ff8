"""Options that no machine can serve are errors that name the option, not a run without end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import phugoid as ph


@pytest.mark.parametrize("kind", [ph.Collocation, ph.SingleShooting, ph.MultipleShooting])
@pytest.mark.parametrize("name", ["threads", "substeps", "segments", "steps"])
@pytest.mark.parametrize("value", [100_000_000, 2**64, 10**300])
def test_numbers_beyond_reason(kind: Callable[..., Any], name: str, value: int) -> None:
    if name not in kind.__dataclass_fields__:  # type: ignore[attr-defined]
        return
    with pytest.raises(ph.OptionError, match=name) as caught:
        kind(**{name: value})
    assert len(str(caught.value)) < 200


def test_numbers_that_only_the_record_makes_too_many() -> None:
    m = ph.Model("decay")
    (x,), (p,) = m.states(x=""), m.parameters(p=-0.5)
    m.dynamics(x=p * x)
    m.outputs(x=x)
    t = np.linspace(0, 1, 21)
    run = ph.Experiment(t, outputs={"x": np.exp(-t)}, name="run")
    for how in (
        ph.Collocation(substeps=5_000_000),
        ph.SingleShooting(step=1e-300),
        ph.MultipleShooting(segments=10_000, steps=5_000_000),
        ph.Collocation(order=64, segments=1_000_000),
    ):
        with pytest.raises(ph.OptionError, match="10000000"):
            ph.estimate(m, run, transcription=how)
