"""Numbers that a user gives are checked by one rule for each kind, and errors name them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from phugoid import ModelError, OptionError
from phugoid.errors import finite, part, positive, whole


def test_sound_numbers_come_back_as_plain_ones() -> None:
    assert [
        type(v) for v in (whole("n", np.int32(3), 1), positive("k", np.float32(2)), part("p", np.float64(0.5)))
    ] == [
        int,
        float,
        float,
    ]
    assert finite("x", "1e3", ModelError) == 1000.0


@pytest.mark.parametrize(
    ("check", "values", "words"),
    [
        (lambda v: whole("f: n", v, 1), [0, 1.0, True, None, "1", np.nan], "f: n is a whole number from 1, not {!r}"),
        (
            lambda v: positive("f: k", v, "seconds"),
            [0, -1.0, True, "1", None, np.inf, np.nan],
            "f: k is a positive number of",
        ),
        (
            lambda v: part("f: level", v, "0.95"),
            [0, 1, -0.5, True, "0.5", None, np.nan],
            "0 and 1, such as 0.95, not {!r}",
        ),
    ],
    ids=["whole", "positive", "part"],
)
def test_others_are_refused(check: Callable[[Any], float], values: list[Any], words: str) -> None:
    for value in values:
        with pytest.raises(OptionError) as error:
            check(value)
        assert words.format(value) in str(error.value)


@pytest.mark.parametrize("value", [np.nan, np.inf, "one", None, [1.0, 2.0]])
def test_what_is_not_finite_raises_the_error_asked_for(value: Any) -> None:
    with pytest.raises(ModelError, match="start: 'a' is .*, not a finite number"):
        finite("start: 'a'", value, ModelError)
