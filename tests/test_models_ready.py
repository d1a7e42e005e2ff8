"""The ready models are those that `phugoid example` writes."""

from __future__ import annotations

from pathlib import Path

import pytest

import phugoid as ph
from phugoid.cli.example import EXAMPLES
from phugoid.cli.model_file import load_model
from phugoid.models.general import READY, model_text


@pytest.mark.parametrize("name", READY)
def test_a_ready_model_is_that_of_the_example(name: str, tmp_path: Path) -> None:
    made = getattr(ph.models, name)()
    made.check()
    file = tmp_path / f"{name}.py"
    file.write_text(model_text(name), encoding="utf-8")
    there = load_model(str(file))
    assert {n: str(e) for n, e in made.equations.items()} == {n: str(e) for n, e in there.equations.items()}
    assert made.declared_parameters == there.declared_parameters and made.units == there.units
    assert made is not getattr(ph.models, name)()
    assert set(made.parameter_names) == set(EXAMPLES[name].parameters) and EXAMPLES[name].look


def test_all_examples_have_one() -> None:
    assert list(EXAMPLES) == list(READY)
    with pytest.raises(ph.OptionError, match="there is no example 'quad'. Did you mean 'quadrotor'"):
        model_text("quad")
