"""The example of hard systems: collocation finds the truth of each, single shooting from the same start does not."""

from __future__ import annotations

import functools
from pathlib import Path

import hard_systems
import hard_systems_figure
import numpy as np
import pytest
from hard_systems import Result

NAMES = [system.name for system in hard_systems.SYSTEMS]
each = pytest.mark.parametrize("name", NAMES)


@functools.cache
def result(name: str) -> Result:
    """Single shooting gets little time here: more does not help it."""
    return hard_systems.solve({s.name: s for s in hard_systems.SYSTEMS}[name], seconds=3.0)


@each
def test_collocation_converges_without_warning(name: str) -> None:
    fit = result(name).fit
    assert fit.converged, fit.message
    # The stiff system leaves its start within a sample: one segment is wrong by twice the noise there, and says so.
    assert ["the mesh is coarse" in text for text in fit.warnings] == [True] * (name == "stiff")


@each
def test_estimates_lie_within_four_standard_errors_of_the_truth(name: str) -> None:
    errors = result(name).collocation_errors
    assert errors.keys() == result(name).system.truth.keys()
    assert all(abs(error) < 4 for error in errors.values()), errors


@each
def test_noise_is_found_as_it_was_made(name: str) -> None:
    r = result(name)
    assert 0.9 < r.rms < 1.1
    for output, sigma in r.system.sigma.items():
        found = r.fit.parameters[f"sigma_{output}"]
        assert abs(found.value - sigma) < 4 * found.std_error


@each
def test_start_is_far_from_the_truth(name: str) -> None:
    r = result(name)
    far = [abs(r.system.start[n] - v) / r.fit.parameters[n].std_error for n, v in r.system.truth.items()]
    assert max(far) > 100


@each
def test_single_shooting_does_not_get_there(name: str) -> None:
    r = result(name)
    assert r.verdict != "ok"
    assert r.shot.rms > 3 * r.rms
    assert max(abs(error) for error in r.shot_errors.values()) > 50


@pytest.mark.parametrize("name", ["stiff", "oscillating"])
def test_a_simulation_from_the_estimate_agrees_with_collocation(name: str) -> None:
    assert result(name).rms_again == pytest.approx(result(name).rms, rel=1e-3)


def test_no_simulation_follows_the_unstable_aircraft_even_from_the_estimate() -> None:
    r = result("unstable")
    assert r.rms_again > 1e6
    Za, _, Ma, Mq, _ = r.system.truth.values()
    growth = np.linalg.eigvals([[Za, 1], [Ma, Mq]]).max() * r.data.t[-1]
    assert growth > np.log(1e20)


def test_explicit_integrators_fail_on_the_stiff_system() -> None:
    assert "overflows" in hard_systems.explicit_methods(result("stiff"))


def test_table_and_figure_show_all(tmp_path: Path) -> None:
    results = [result(name) for name in NAMES]
    text = hard_systems.table(results)
    assert all(r.system.title in text and n in text for r in results for n in r.system.truth)
    hard_systems_figure.draw(results).savefig(tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 50_000
