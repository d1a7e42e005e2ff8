"""What comes with a diagnosis: the extended model and its gain, words, figures, the page, progress and Ctrl-C."""

from __future__ import annotations

import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hidden import Case, make
from matplotlib.figure import Figure

import phugoid as ph


@pytest.fixture(scope="module")
def case() -> Case:
    """A spring that hardens, with dry friction besides."""
    return make("duffing", ("f:x^3", "f:sign(v)"), "strong", "white", 1)


@pytest.fixture(scope="module")
def fit(case: Case) -> ph.Fit:
    return ph.estimate(case.model, case.data)


@pytest.fixture(scope="module")
def diagnosis(case: Case, fit: ph.Fit) -> ph.results.Diagnosis:
    return ph.diagnose(fit, validation=case.validation)


def test_the_extended_model_is_a_model_like_any_other(
    diagnosis: ph.results.Diagnosis, case: Case, tmp_path: Path
) -> None:
    ext = diagnosis.extend()
    assert ext is diagnosis.extend()  # worked out once
    assert ext.added == tuple(f.cause for f in diagnosis.findings)
    new = {*ext.model.parameter_names} - {*case.model.parameter_names}
    assert new == {name for f in diagnosis.findings for name in f.parameters}
    for name in new:
        assert name in str(ext.model) and name in str(ext.model.equations["f"])
    assert ext.model.latex()
    ext.model.save(tmp_path / "model.json")
    again = ph.Model.load(tmp_path / "model.json")
    assert str(again) == str(ext.model)
    for model in (ext.model, again, pickle.loads(pickle.dumps(ext.model))):
        simulated = ph.simulate(model, ext.fit, case.data)
        for name, y in ext.fit.records[0].outputs.items():
            sigma = ext.fit.parameters[f"sigma_{name}"].value
            np.testing.assert_allclose(simulated.outputs[name], y, rtol=0, atol=0.05 * sigma)


def test_a_model_with_quantities_is_not_advised_to_declare_them(diagnosis: ph.results.Diagnosis) -> None:
    assert diagnosis.fit.model.quantity_names and not any("declares no quantities" in note for note in diagnosis.notes)


def test_the_extended_fit_is_saved_and_validated_like_any_other(
    diagnosis: ph.results.Diagnosis, case: Case, tmp_path: Path
) -> None:
    ext = diagnosis.extend()
    assert ext.fit.converged
    ext.fit.save(tmp_path / "fit.json")
    loaded = ph.load(tmp_path / "fit.json")
    assert {n: e.value for n, e in loaded.parameters.items()} == {n: e.value for n, e in ext.fit.parameters.items()}
    before, after = (f.validate(case.validation).log_likelihood for f in (diagnosis.fit, ext.fit))
    assert after - before > 0.5 * ext.gain.held_out


def test_the_truth_lies_near_what_is_estimated(diagnosis: ph.results.Diagnosis, case: Case) -> None:
    for f in diagnosis.findings:
        true = case.coefficients[f.cause]
        assert abs(f.coefficient - true) < 4 * f.std_error < abs(true)


def test_the_gain_is_what_both_fits_say(diagnosis: ph.results.Diagnosis, fit: ph.Fit, case: Case) -> None:
    ext = diagnosis.extend()
    gain, new = ext.gain, len(ext.model.parameter_names) - len(fit.model.parameter_names)
    white = ext.fit.log_likelihood - fit.log_likelihood
    assert gain.log_likelihood == pytest.approx(white)
    n = sum(np.isfinite(z).sum() for z in case.data.outputs.values())
    assert gain.bic == pytest.approx(-2 * white + new * np.log(n))
    assert gain.bic < 0 < gain.held_out
    # Coloured noise would explain a part of the misfit; to pass, it may not be all.
    assert max(f.threshold for f in diagnosis.findings) < gain.log_likelihood_whitened < white
    assert all(f.gain < gain.log_likelihood_whitened for f in diagnosis.findings)
    for name in fit.model.output_names:
        assert gain.rms_before[name] == pytest.approx(fit.records[0].rms()[name])
        assert gain.rms_after[name] == pytest.approx(ext.fit.records[0].rms()[name])
        assert gain.change(name) < 0 and gain.change(name, held_out=True) < 0


def test_the_ranking_is_complete_and_in_order(diagnosis: ph.results.Diagnosis, case: Case) -> None:
    values = [s.ranking for s in diagnosis.ranking]
    assert values == sorted(values, reverse=True)
    names = [s.name for s in diagnosis.ranking]
    # The inputs of this record add up to nothing, and what may decay with a position needs a positive one.
    absent = ("integral", "decay", "exponent")
    first = [c for c in ph.candidates(case.model) if not c.beside and getattr(c, "family", "") not in absent]
    assert len(names) == len({*names}) >= len(first)
    assert {*case.truth} <= {*names[:10]}
    assert all(0 <= s.distinct <= 1.001 for s in diagnosis.ranking)
    best = diagnosis.ranking[0]
    assert best.explanation and best.estimate and best.ranking > diagnosis.threshold


def test_words(diagnosis: ph.results.Diagnosis) -> None:
    text = diagnosis.summary()
    assert str(diagnosis) == text and "nan" not in text and "inf" not in text
    for f in diagnosis.findings:
        assert f.cause in text and f.explanation in " ".join(text.split())
        assert f"{f.gain:+.1f}" in text and f"{f.held_out_gain:+.1f}" in text
        assert all(alias in text for alias in f.aliases)
        assert f.cause in repr(diagnosis)
    assert "The model misses" in text and "Residuals of the model as it was" in text
    assert max(map(len, text.split("\n"))) <= 110


def test_figures(diagnosis: ph.results.Diagnosis) -> None:
    figures = diagnosis.figures()
    assert len(figures) == 5  # what is explained, misfit, ranking, findings, gain
    labels = [t.get_text() for t in figures[2].axes[0].get_yticklabels()]
    assert diagnosis.ranking[0].name in labels


def test_every_plot_returns_a_figure_and_axes_by_name(diagnosis: ph.results.Diagnosis) -> None:
    names = {
        "plot": {"explained", "outputs"},
        "plot_explained": {"explained", "outputs"},
        "plot_ranking": {"ranking"},
        "plot_gain": {"gain"},
    }
    for method, panels in names.items():
        figure, axes = getattr(diagnosis, method)()
        assert isinstance(figure, Figure) and set(axes) == panels
        assert all(axis.figure is figure for axis in axes.values())
    channel = diagnosis.misfit.worst[0]
    assert f"{channel} spectrum" in diagnosis.plot_misfit([channel])[1]
    assert set(diagnosis.plot_extension([channel])[1]) == {channel, f"{channel} change"}
    (error,) = diagnosis.fit.integration_error()[:1]
    figure, axes = error.plot()
    assert isinstance(figure, Figure) and set(axes) == {"error"}
    assert error.plot(axes["error"], 1e-3)[0] is figure


def test_a_diagnosis_without_a_cause_has_no_gain_to_plot(diagnosis: ph.results.Diagnosis) -> None:
    nothing = replace(diagnosis, findings=(), _extension=None)
    assert set(nothing.plot()[1]) == {"ranking"}
    assert set(replace(nothing, ranking=()).plot()[1]) >= {f"{diagnosis.misfit.worst[0]} spectrum"}
    for method in ("plot_gain", "plot_extension"):
        with pytest.raises(ph.DataError, match="no extended model to compare with"):
            getattr(nothing, method)()


def test_page(diagnosis: ph.results.Diagnosis, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    diagnosis.report(path)
    text = path.read_text(encoding="utf-8")
    shown = re.sub(r"base64,[^']*", "", text)
    # What is explained, one a channel of the misfit, ranking, gain, findings.
    assert shown.count("<img") == len(diagnosis.misfit.worst[:3]) + 4 and not re.search(r"\b(nan|inf)\b", shown)
    for f in diagnosis.findings:
        assert f.cause in text
    assert "The new equations" in text and "The gain" in text


def stopped_at(step: int) -> tuple[Callable[[str], None], list[str]]:
    """A progress function that is Ctrl-C at a step, and what it was told."""
    told: list[str] = []

    def progress(text: str) -> None:
        told.append(text)
        if len(told) == step:
            raise KeyboardInterrupt

    return progress, told


@pytest.fixture(scope="module")
def uninterrupted(fit: ph.Fit) -> tuple[ph.results.Diagnosis, list[str]]:
    """A diagnosis without data held out, and what was told of its progress."""
    progress, told = stopped_at(0)
    return ph.diagnose(fit, progress=progress), told


def test_progress_is_told(
    capsys: pytest.CaptureFixture[str], uninterrupted: tuple[ph.results.Diagnosis, list[str]]
) -> None:
    d, told = uninterrupted
    assert told[0] == "scanning all candidates" and any(t.startswith("fitting with ") for t in told)
    assert all(any(f.cause in t for t in told) for f in d.findings)
    quiet = capsys.readouterr()
    assert quiet.out == quiet.err == ""


@pytest.mark.parametrize("when", ["at once", "in the first round", "in the second round"])
def test_ctrl_c_leaves_what_was_found(
    when: str,
    fit: ph.Fit,
    diagnosis: ph.results.Diagnosis,
    uninterrupted: tuple[ph.results.Diagnosis, list[str]],
    tmp_path: Path,
) -> None:
    told = uninterrupted[1]
    second = next(i for i, t in enumerate(told) if t.startswith("scanning all candidates beside"))
    step = {"at once": 1, "in the first round": 4, "in the second round": second + 3}[when]
    progress, told = stopped_at(step)
    d = ph.diagnose(fit, progress=progress)
    assert any("interrupted" in note for note in d.notes)
    found = {f.cause for f in d.findings}
    if when == "in the second round":
        assert found and found <= {*diagnosis.extend().added}
        assert d.extend().gain.log_likelihood > 0
        # With the evidence by which they were accepted.
        assert all(np.isfinite([f.coefficient, f.std_error, f.gain, f.explained]).all() for f in d.findings)
    else:
        assert not found and d.extend().added == ()
    text = d.summary()
    assert "interrupted" in text and "nan" not in text
    d.report(tmp_path / "page.html")
    assert d.ranking and d.figures()
