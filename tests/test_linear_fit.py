"""`fit_linear` finds the maximum-likelihood estimate of linear systems by variable projection."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from linear_case import run

import phugoid as ph
from phugoid.linear import linear_fit
from phugoid.linear.modal_blocks import ModalBlocks
from phugoid.linear.modal_regression import regression
from phugoid.linear.sampled import Sampled
from phugoid.linear.state_space import modal_parts


def system(poles: tuple[complex, ...], m: int = 1, p: int = 1, seed: int = 1) -> ph.linear.StateSpace:
    random = np.random.default_rng(seed)
    n = sum(2 if pole.imag else 1 for pole in poles)
    A, k = np.zeros((n, n)), 0
    for pole in poles:
        A[k, k] = pole.real
        if pole.imag:
            A[k : k + 2, k : k + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
        k += 2 if pole.imag else 1
    return ph.linear.StateSpace(A, random.normal(size=(n, m)), random.normal(size=(p, n)))


def test_it_finds_what_estimate_finds() -> None:
    """The same likelihood by collocation, from there in a few steps, and the truth within its standard errors."""
    truth = system((-0.3 + 6.0j, -0.5 + 14.0j))
    data = run(truth, noise=0.05)
    found = ph.linear.fit_linear(ph.linear.subspace(data, 4, feedthrough=False), data, offset=False)
    fit = ph.estimate(ph.models.modal(start=found), data, transcription=ph.Collocation(order=6))
    assert fit.converged and fit.iterations <= 6
    assert found.log_likelihood == pytest.approx(fit.log_likelihood, abs=1e-4)
    for a, b, c in zip(found.modes, ph.linear.modes(fit), truth.modes, strict=True):
        assert a.frequency.value == pytest.approx(b.frequency.value, abs=1e-3 * b.frequency.std_error)
        assert abs(b.frequency.value - c.frequency.value) < 3.5 * b.frequency.std_error
        assert abs(b.damping.value - c.damping.value) < 3.5 * b.damping.std_error


def test_it_betters_the_subspace_method_on_several_outputs_experiments_and_gaps() -> None:
    truth = system((-0.3 + 6.0j, -0.5 + 14.0j, -4.0), m=2, p=3)
    runs = [run(truth, 900, 0.2, seed=1, name="a", offset=2.0), run(truth, 700, 0.2, seed=2, name="b", offset=-1.0)]
    start = ph.linear.subspace(runs, 5, feedthrough=False)
    full = ph.linear.fit_linear(start, runs)
    assert full.log_likelihood > -1600.0 * sum(np.log(rms) + 0.5 for rms in start.residual_rms.values()) + 1.0
    gapped = [runs[0].output(y).copy() for y in truth.outputs]
    gapped[1][200:300] = np.nan
    holed = ph.Experiment(
        runs[0].t,
        {u: runs[0].input(u) for u in truth.inputs},
        dict(zip(truth.outputs, gapped, strict=True)),
        name="a",
    )
    found = ph.linear.fit_linear(start, [holed, runs[1]])
    assert found.order == start.order
    model = ph.models.modal(start=found, bias=True)
    data = [holed, runs[1]]
    fit = ph.estimate(model, data, transcription=ph.Collocation(order=5))
    assert found.log_likelihood == pytest.approx(fit.log_likelihood, abs=1e-4)
    f = np.linspace(0.2, 4.0, 50)
    for each in (full, found):
        for u in truth.inputs:
            for y in truth.outputs:
                G, H = (s.frequency_response(f, u, y).response for s in (truth, each))
                assert np.sqrt(np.mean(np.abs(G - H) ** 2) / np.mean(np.abs(G) ** 2)) < 0.12


@pytest.mark.parametrize(
    "poles", [(-0.3 + 6.0j, -2.0, -5.0, -1.0), (-0.4, -0.41, -3.0 + 0.1j), (0.05 + 4.0j, 0.1, -1.0, -0.2 + 9.0j)]
)
def test_derivatives_are_those_of_the_simulated_outputs(poles: tuple[complex, ...]) -> None:
    """By differences, what B, D, initial states and offsets can do projected out; pairs that are real, and growth."""
    truth = system(poles, m=2, p=2)
    data = run(truth, 120)
    records = Sampled.of(data, truth.inputs, truth.outputs)
    parts = modal_parts(truth.A, truth.B, truth.C)
    blocks = ModalBlocks.of(parts.values, parts.outputs, records.y_size)
    assert blocks.sizes.size == 3 * truth.order  # eigenvalues and C of two outputs

    found, C, _ = blocks.modal()
    solved = regression([records.driven[0].answers(found)], C, truth.outputs, (False, False), True)
    weights = np.repeat(1.0 / solved.rms, data.n)
    z = weights * np.concatenate([data.output(y) for y in truth.outputs])

    def basis(at: ModalBlocks) -> np.ndarray:
        """What initial states, B and offsets can do: orthonormal columns (2 N, k)."""
        found, C, _ = at.modal()
        driven = records.driven[0]
        seen = list(np.kron(np.eye(2), np.ones((1, data.n))))
        for modes in (driven.free(found), *driven.forced(found)):
            for i, xi in enumerate(modes):
                both = (C[:, i, None] * xi).ravel()
                seen += [both.real, both.imag] if found[i].imag else [both.real]
        columns = np.array([column / np.linalg.norm(column) for column in seen]).T
        return np.linalg.qr(weights[:, None] * columns)[0]

    def residual(at: ModalBlocks) -> np.ndarray:
        q = basis(at)
        return z - q @ (q.T @ z)

    slopes = np.zeros((2, data.n, blocks.sizes.size))
    for j, (which, rows) in enumerate(blocks.slopes(records.driven[0].answers(found), solved)):
        slopes[j][:, which] = rows.T
    q = basis(blocks)
    flat = weights[:, None] * slopes.reshape(-1, blocks.sizes.size)
    projected = flat - q @ (q.T @ flat)
    # The term that Kaufman leaves out lies in the span of the columns.
    for i, size in enumerate(blocks.sizes):
        step = np.zeros(blocks.sizes.size)
        step[i] = 1e-5 * size
        difference = (residual(blocks.moved(-step)) - residual(blocks.moved(step))) / 2e-5
        difference -= q @ (q.T @ difference)
        # The weights are those of the pass before.
        assert np.linalg.norm(projected[:, i] * size - difference) < 1e-3 * np.linalg.norm(difference) + 1e-5


def test_where_a_search_leads_is_told_by_the_linearised_outputs() -> None:
    """``apart``, by projections written out: the known outputs outside of the tangent space, and what is left of the
    data inside of it."""
    truth = system((-0.3 + 6.0j, -0.5 + 14.0j), p=2)
    data = run(truth, 300)
    records = Sampled.of(data, truth.inputs, truth.outputs)
    task = linear_fit._Task(records, (False, False), True, False, 50)
    parts = modal_parts(truth.A, truth.B, truth.C)
    start = task.point(ModalBlocks.of(parts.values, parts.outputs, records.y_size))
    optimum = task.search(start, 1e-9)
    known = linear_fit._Known.of(optimum)
    np.testing.assert_allclose(known.log_likelihood, optimum.log_likelihood)
    residual = [(data.output(y) - each) for y, each in zip(truth.outputs, known.paths[0], strict=True)]
    np.testing.assert_allclose([np.sqrt(np.mean(r**2)) for r in residual], optimum.regression.rms, rtol=1e-8)

    here = task.point(optimum.blocks.moved(0.005 * optimum.blocks.sizes))
    columns: list[np.ndarray] = []
    _, C, _ = here.blocks.modal()
    for j, (which, slopes) in enumerate(here.blocks.slopes(here.answers[0], here.regression)):
        block = np.zeros((2 * data.n, 2 * 2 * truth.order // 2 + 2 + here.blocks.sizes.size))
        rows = slice(j * data.n, (j + 1) * data.n)
        k = 0
        for xi in (here.answers[0].free, *here.answers[0].forced):
            for c, each in zip(C[j], xi, strict=True):
                block[rows, k], block[rows, k + 1] = (c * each).real, (c * each).imag
                k += 2
        block[rows, k + j] = 1.0
        block[rows, k + 2 :][:, which] = slopes.T
        columns.append(block / here.regression.rms[j])
    whole = sum(columns)
    whole = whole / np.linalg.norm(whole, axis=0)
    U, s, _ = np.linalg.svd(whole, full_matrices=False)
    q = U[:, s > 1e-9 * s[0]]
    weights = np.repeat(1.0 / here.regression.rms, data.n)
    path, left = weights * known.paths[0].ravel(), weights * np.concatenate(residual)
    inside = q.T @ left
    expected = np.sum((path - q @ (q.T @ path)) ** 2) + inside @ inside
    expected /= np.min(optimum.regression.rms / here.regression.rms) ** 2
    assert expected > 0.05
    assert task._linearised(here, known).apart == pytest.approx(expected, rel=1e-3)
    assert task._linearised(optimum, known).apart < 1e-6
    assert task._linearised(here, None).apart == np.inf
    far = task.point(ModalBlocks.of(np.array([-0.3 + 3.0j, -0.5 + 25.0j]), parts.outputs, records.y_size))
    assert task._linearised(far, known).apart > 100.0


def test_a_mode_at_a_wrong_place_is_moved_and_searches_back_to_a_known_optimum_end(monkeypatch: Any) -> None:
    """The optimum is that of searches run to their ends, with fewer iterations."""
    poles = (-0.1 + 5.0j, -0.1 + 12.0j, -0.15 + 30.0j, -0.05 + 41.0j)
    data = run(system(poles), 1000)
    start = system((-0.1 + 5.0j, -0.1 + 5.3j, -0.15 + 30.0j, -0.05 + 60.0j))

    def found() -> tuple[ph.linear.StateSpace, int]:
        lines: list[ph.results.Iteration] = []
        best = ph.linear.fit_linear(start, data, progress=lines.append)
        return best, len(lines)

    quick, few = found()
    monkeypatch.setattr(linear_fit, "_BACK", 0.0)
    thorough, many = found()
    assert quick.log_likelihood == pytest.approx(thorough.log_likelihood, abs=1e-5)
    np.testing.assert_allclose(quick.modes.frequencies_hz, system(poles).modes.frequencies_hz, rtol=2e-3)
    assert few < many


def test_a_pair_becomes_two_real_eigenvalues_and_the_other_way_round() -> None:
    lags, pair = (-0.7, -5.0), (-0.8 + 3.0j,)
    for truth_poles, start_poles in ((lags, pair), (pair, lags)):
        truth = system(truth_poles)
        data = run(truth, noise=0.01)
        found = ph.linear.fit_linear(system(start_poles), data, moves=0)
        got, want = (np.sort_complex(np.linalg.eigvals(s.A)) for s in (found, truth))
        np.testing.assert_allclose(got, want, rtol=0.05)


@pytest.mark.parametrize("seed", range(4))
def test_it_converges_from_frequencies_drawn_at_random(seed: int) -> None:
    poles = (-0.1 + 5.0j, -0.1 + 12.0j, -0.15 + 30.0j, -0.2 + 40.0j, -0.05 + 41.0j)
    truth = system(poles)
    start = system(tuple(complex(-0.1, w) for w in np.random.default_rng(seed).uniform(2.0, 60.0, 5)))
    found = ph.linear.fit_linear(start, run(truth, 2000), moves=0)
    np.testing.assert_allclose(found.modes.frequencies_hz, truth.modes.frequencies_hz, rtol=2e-3)


def test_unstable_systems_are_found_from_unstable_starts() -> None:
    truth = system((0.12 + 3.0j, -0.4 + 9.0j))
    data = run(truth, 1000, noise=0.001)
    found = ph.linear.fit_linear(system((0.05 + 2.7j, -0.3 + 8.0j)), data)
    np.testing.assert_allclose(found.modes.eigenvalues, (0.12 + 3.0j, -0.4 + 9.0j), rtol=5e-3)


def test_modes_that_decay_at_the_start_do_not_come_to_grow() -> None:
    truth = system((0.12 + 3.0j,))
    found = ph.linear.fit_linear(system((-0.05 + 2.7j,)), run(truth, 400))
    assert np.linalg.eigvals(found.A).real.max() <= 0.0


def test_outputs_without_noise_are_fitted_to_rounding() -> None:
    truth = system((-0.3 + 6.0j, -0.5 + 14.0j), p=2)
    found = ph.linear.fit_linear(system((-0.2 + 5.0j, -0.5 + 16.0j), p=2), run(truth, 400, noise=0.0), offset=False)
    np.testing.assert_allclose(found.modes.eigenvalues, (-0.3 + 6.0j, -0.5 + 14.0j), rtol=1e-6)


def test_ctrl_c_gives_the_best_so_far() -> None:
    truth = system((-0.3 + 6.0j, -0.5 + 14.0j))
    seen: list[float] = []

    def watch(line: ph.results.Iteration) -> None:
        seen.append(line.log_likelihood)
        if len(seen) == 2:
            raise KeyboardInterrupt

    found = ph.linear.fit_linear(system((-0.1 + 5.0j, -0.5 + 17.0j)), run(truth), progress=watch)
    assert found.log_likelihood == max(seen)
    assert "interrupted" in found.warnings[0]


def test_bad_input_is_named() -> None:
    truth = system((-0.3 + 6.0j,))
    data = run(truth)
    with pytest.raises(ph.OptionError, match="moves is a whole number from 0, not -1"):
        ph.linear.fit_linear(truth, data, moves=-1)
    with pytest.raises(ph.OptionError, match="feedthrough: 'z' is not an output"):
        ph.linear.fit_linear(truth, data, feedthrough="z")
    with pytest.raises(ph.OptionError, match="progress is True, False or a function"):
        ph.linear.fit_linear(truth, data, progress=1)  # type: ignore[arg-type]
    with pytest.raises(ph.ModelError, match="start is a StateSpace"):
        ph.linear.fit_linear("x", data)  # type: ignore[arg-type]
    with pytest.raises(ph.ModelError, match="cannot be distinguished"):
        ph.linear.fit_linear(([[-1.0, 1.0], [0.0, -1.0]], [[0.0], [1.0]], [[1.0, 0.0]]), data)
    with pytest.raises(ph.DataError, match="too short for 2 states"):
        ph.linear.fit_linear(truth, data.window(0, 0.08))
    t = np.append(data.t[:-1], data.t[-1] + 5.0)
    uneven = ph.Experiment(t, {"u": data.input("u")}, {"y": data.output("y")})
    with pytest.raises(ph.DataError, match="fit_linear: needs evenly spaced samples"):
        ph.linear.fit_linear(truth, uneven)
