"""A scan of candidates against the same by whole matrices: whitened columns, projected one by one."""

from __future__ import annotations

from functools import cache

import hidden
import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.search import refit_cache
from phugoid.discrepancy.search import scan as module
from phugoid.discrepancy.search.refit import Refit
from phugoid.discrepancy.search.refit_cache import RefitCache
from phugoid.discrepancy.search.scan import CONFOUNDED, Groups, Scan, Statistics
from phugoid.residual_noise.whitening import Whitening
from phugoid.sensitivities.linearised import Linearised
from phugoid.sensitivities.whitened import Whitened, own_whitening


@cache
def scanned() -> Scan:
    """Coloured noise, a gap in one channel, candidates with one and two coefficients, shapes, and some that the
    parameters imitate."""
    case = hidden.make("hfb320", ("CL:lag_de",), "medium", "coloured", 1)
    outputs = {name: case.data.output(name).copy() for name in case.model.output_names}
    outputs["q"][100:112] = np.nan
    data = ph.Experiment(case.data.t, dict(case.data.inputs), outputs)
    linear = Linearised(ph.estimate(case.model, data))
    library = ph.candidates(case.model, points=linear.points)
    return Scan(linear, [*[*library][::9], *(library[name] for name in ("Cm:periodic", "CL:lag_de", "de:delay"))])


@cache
def filters() -> dict[str, Whitening]:
    scan = scanned()
    own, n = own_whitening(scan.linear).filter, len(scan.linear.rows)
    assert isinstance(own, Whitening) and max(c.order for c in own.channels) > 1
    own = Whitening(own.channels, own.rows, 0.6 * np.eye(n) + 0.4)  # and errors that go together
    return {"white": scan.white.filter, "own": own, "clean": scan.clean()}  # type: ignore[dict-item]


def beside(seen: Whitened) -> list[np.ndarray]:
    """Of each effect its whitened columns without what tangents imitate, (n_rows, k)."""
    columns, _, groups = scanned().linear.columns(scanned().effects)
    c = seen.filter(columns)
    c = c - (c @ seen.basis) @ seen.basis.T
    return [c[g].T for g in groups]


@pytest.mark.parametrize("which", ["white", "own", "clean"])
def test_statistics_are_those_of_the_columns(which: str) -> None:
    scan, filter = scanned(), filters()[which]
    statistics = scan.through(filter)
    e = statistics.seen.errors
    variance = min(float(e @ e) / (e.size - statistics.seen.basis.shape[1]), 1.0)
    columns = beside(statistics.seen)
    assert {b.shape[1] for b in columns} == {1, 2}
    for b, value, amplitude in zip(columns, statistics.values, statistics.amplitudes, strict=True):
        c = np.linalg.lstsq(b, e, rcond=None)[0]
        assert amplitude == pytest.approx(c, rel=1e-6, abs=1e-9 * np.abs(c).max())
        assert value == pytest.approx(float((b.T @ e) @ c) / variance, rel=1e-7, abs=1e-9)


def test_what_tangents_imitate_cancels_in_no_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where subtraction would lose digits columns are projected one by one: the same where it would not."""
    scan, filter = scanned(), filters()["own"]
    usual = scan.through(filter)
    monkeypatch.setattr(module, "_CANCELLED", 2.0)
    projected: Statistics = scan._statistics(usual.seen)
    assert projected.values == pytest.approx(usual.values, rel=1e-8, abs=1e-9)


def test_distinct_is_the_part_beside_the_tangents() -> None:
    linear = scanned().linear
    candidates = [c for c in ph.candidates(linear.model, points=linear.points) if len(c.shapes) == 1]
    scan = Scan(linear, candidates)
    columns, parameters, groups = linear.columns([(c, c.shapes[0]) for c in candidates])
    whole = linear.without_states(columns / linear.scale(), parameters)
    own = scan.white.beside(columns)
    norm = np.linalg.norm
    parts = {c.name: norm(own[g]) / norm(whole[g]) for c, g in zip(candidates, groups, strict=True) if whole[g].any()}
    for (c, _), distinct in zip(scan.effects, scan.distinct.tolist(), strict=True):
        assert distinct == pytest.approx(parts[c.name], rel=1e-7) and distinct > CONFOUNDED
    assert {*scan.lost} >= {name for name, part in parts.items() if part < CONFOUNDED}
    assert scan.lost


def test_the_greedy_choice_is_that_of_whole_matrices() -> None:
    scan, filter = scanned(), filters()["own"]
    statistics = scan.through(filter)
    columns, errors, taken = beside(statistics.seen), statistics.seen.errors.copy(), []
    for _ in range(4):
        explained = []
        for b in columns:
            u, s, _ = np.linalg.svd(b, full_matrices=False)
            u = u[:, s > 1e-6]
            explained.append(float(np.sum((u.T @ errors) ** 2)))
        taken.append(int(np.argmax(explained)))
        q = np.linalg.qr(columns[taken[-1]])[0]
        errors -= q @ (q.T @ errors)
        columns = [b - q @ (q.T @ b) for b in columns]
    assert scan.different(statistics, 4) == taken


def test_cosines_are_those_of_the_angles_between_effects() -> None:
    scan, filter = scanned(), filters()["own"]
    statistics = scan.through(filter)
    bases = [np.linalg.qr(b)[0] for b in beside(statistics.seen)]
    two = next(i for i, b in enumerate(bases) if b.shape[1] == 2)
    for i in (0, two):
        q = scan.basis(statistics, i)
        expected = [float(np.linalg.svd(q.T @ b, compute_uv=False).min()) for b in bases]
        assert scan.cosines(statistics, q) == pytest.approx(expected, abs=1e-7)


def test_columns_that_were_dropped_are_made_again() -> None:
    scan, filter = scanned(), filters()["own"]
    before = scan.columns.copy()
    assert scan.size == before.size
    scan.forget()
    assert scan.size == 0
    assert not {"_along", "_derivatives", "_problem"}.intersection(vars(scan.linear))
    assert np.allclose(scan.columns, before, rtol=1e-9, atol=1e-12 * np.abs(before).max())
    assert scan.through(filter).values.size == len(scan.effects)


def test_scans_keep_no_more_numbers_together_than_there_is_room_for(monkeypatch: pytest.MonkeyPatch) -> None:
    base = Refit((), scanned().linear.fit)
    scans = RefitCache(base, [c for c, _ in scanned().effects][:12])
    first = scans.scan(base)
    more = scans.refit([next(c for c, _ in first.effects if not c.shape_names)])
    assert more is not None
    second = scans.scan(more)
    assert first.size and second.size
    monkeypatch.setattr(refit_cache, "_NUMBERS", second.size)
    assert scans.scan(more) is second
    assert second.size and not first.size


def test_a_group_of_columns_that_depend_on_each_other_counts_once() -> None:
    rng = np.random.default_rng(0)
    a, e = rng.standard_normal(50), rng.standard_normal(50)
    columns = np.array([a, a, 1e3 * a, np.zeros(50), a])
    groups = Groups([2, 2, 1])
    squares = np.concatenate([(columns[g] @ columns[g].T).ravel() for g in groups.slices])
    explained, c = groups.solved(groups.grams(squares), columns @ e)
    assert explained == pytest.approx(np.full(3, (a @ e) ** 2 / (a @ a)))
    assert c[:2].sum() == pytest.approx((a @ e) / (a @ a)) and c[3] == 0.0
