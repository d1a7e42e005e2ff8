"""The twin of the paper's ground vibration test, short: what the data determine is found from the subspace start."""

import functools

import ground_vibration
import numpy as np
import pytest
from ground_vibration_twin import NOISE, Twin, paper_model, structure, twin
from scipy.signal import cont2discrete, dlsim

import phugoid as ph


@functools.cache
def record() -> Twin:
    return twin(2001)


@functools.cache
def fit() -> ph.Fit:
    return ground_vibration.estimate(record())


def test_the_twin_is_the_structure_s_answer_to_its_force() -> None:
    system, clean = structure(), record().clean
    signal = record().data.signal("force")
    assert signal is not None
    times, force, *_ = signal
    step = times[1] - times[0]
    a, b, c, d, _ = cont2discrete((system.A, system.B, system.C, system.D), step, "foh")
    out = dlsim((a, b, c, d, step), force)[1][::4, 0]
    # The force is known more coarsely here, and all before the record is unknown: heavily damped modes have forgotten.
    late = slice(1000, None)
    basis = np.array(
        [(c @ np.linalg.matrix_power(a, 4 * 1000) @ np.linalg.matrix_power(a, 4 * k))[0] for k in range(1001)]
    )
    rest = (clean - out[: clean.size])[late]
    free = basis @ np.linalg.lstsq(basis, rest, rcond=None)[0]
    assert np.std(rest - free) < 0.02 * np.std(clean)


def test_the_fit_ends_at_the_noise() -> None:
    assert fit().converged and fit().iterations < 20
    residual = fit().residuals["acceleration"]
    assert 0.93 * NOISE < np.sqrt(np.mean(residual**2)) < 1.01 * NOISE


def test_modes_that_the_record_determines_are_found() -> None:
    rows = [row for row in ground_vibration.compare(fit(), record()) if row[0].frequency.std_error < 0.02]
    assert len(rows) >= 4
    for _, of_frequency, of_damping in rows:
        assert abs(of_frequency) < 4 and abs(of_damping) < 4


def test_the_frequency_response_is_that_of_the_structure() -> None:
    error, standard = (np.abs(each) for each in ground_vibration.response_error(fit(), record()))
    assert np.median(error) < 0.3
    # One record, its errors correlated over frequency: as likely as not below 1, rarely above 3.
    assert np.isfinite(standard).all() and np.median(standard) < 1.5 and np.quantile(standard, 0.98) < 3.5


def test_the_paper_s_start_leads_to_a_fit_as_good_as_the_truth_s() -> None:
    """Without damping and with all else 1; collocation alone ends in a local optimum there."""
    data = twin(3001)
    near = ph.linear.fit_linear(data.structure, data.data, offset=False, moves=0)
    found = ph.linear.fit_linear(ph.linear.linearise(*paper_model()), data.data, offset=False, moves=4)
    assert near.log_likelihood is not None and found.log_likelihood is not None
    assert found.log_likelihood > near.log_likelihood - 1.0


def test_the_paper_s_form_and_start() -> None:
    model, start = paper_model()
    assert len(start) == 60 and len(model.state_names) == 24  # and sigma of the noise
    assert start["sigma_1"] == 0.0 and start["omega_12"] == 48.901 and start["c_3b"] == 1.0 == start["b_7"]


def test_an_unstable_iterate_is_no_end() -> None:
    """From the paper's start growing modes are passed through; the run ends with its best point."""
    data = twin(501).data
    model, start = paper_model()
    short = ph.estimate(model, data, start=start, transcription=ph.Collocation(order=4), solver=ph.Newton(4))
    best = max(line.log_likelihood for line in short.history if line.defect < 1e-4)
    assert short.log_likelihood == pytest.approx(best, abs=1e-6 * abs(best)) or short.log_likelihood > best
