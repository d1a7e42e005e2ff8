"""A model as a functional mock-up unit (FMI 2.0, model exchange and co-simulation).

It is the model's C source, wrapped as the standard asks by ``fmi2.c`` beside this file. The standard's headers, with
which it is compiled, come with the package FMPy.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._core import Expr, __version__
from ..errors import DataError, MissingDependency, positive
from ..fit_result import FitResult
from ..modelling.model import Model
from ..writing import write
from . import Code, Contents, contents_of, identifier, renamed, source
from .graph import number

__all__ = ["export_fmu"]

_WRAPPER = "fmi2.c"
_STEP = 0.01  # s; of co-simulation where there is no record with a sampling interval
_PARTS = 10  # of the shortest sampling interval
# The archive does not depend on the time of its creation.
_LONG_AGO = (1980, 1, 1, 0, 0, 0)


def export_fmu(
    fit: FitResult | Model,
    path: str | os.PathLike[str],
    parameters: Mapping[str, Any] | None = None,
    *,
    experiment: str | None = None,
    step: float | None = None,
    binary: bool = True,
    delayed_inputs: bool = False,
    late_inputs: bool = False,
) -> Path:
    """Write a functional mock-up unit (FMI 2.0) for model exchange and co-simulation, with its C source; return the
    path.

    Variables are inputs, parameters (tunable) and outputs by their names, states as ``state.<name>`` and their
    derivatives as ``der(state.<name>)``, with units; an output with the name of an input or a parameter is
    ``output.<name>``. Start values are those of the fit: its estimates, initial states, and inputs of the experiment.
    An input that is held between samples in the data of the fit is discrete, and the others are continuous. Directional
    derivatives are exact; the state can be saved and restored.

    ``parameters``, ``experiment``  as in `linearise`.
    ``step``    longest Runge-Kutta step (order 4) of co-simulation; else a tenth of the shortest sampling
                interval, 0.01 without a fit. The unit's time is that of the model: 1 is 1 h where the model has time in
                h, though importing programs write s.
    ``delayed_inputs``  of a model with delays: take each delayed input, u(t - tau), as an input of its own, which the
                importing program delays (a transport delay before the input), and leave delays of sensors to it too;
                the descriptions of these variables say so.
    ``binary``  compile for this platform, by the compiler ``cc``, ``gcc`` or ``clang`` or that named by the environment
                variable CC. Without, the unit holds source alone, for tools that compile.

    Raises ModelError for a model with delays otherwise, and where values are missing or each experiment has its own;
    OptionError for a step that is not positive; MissingDependency without FMPy, which has the standard's headers, or a
    compiler; DataError where the file cannot be written.
    """
    import uuid

    contents = contents_of(
        "export_fmu", fit, parameters, experiment, delayed_inputs or renamed("export_fmu", late_inputs)
    )
    if step is None:
        gaps = [float(np.diff(r.t).min()) for r in fit.records] if isinstance(fit, FitResult) else []
        step = min(gaps) / _PARTS if gaps else _STEP
    step = positive("export_fmu: step", step)
    name = identifier(contents.model.name)
    name = f"{name}_" if name.startswith("fmi2") else name  # as the wrapper's files are called
    code = source(contents, name)
    wrapper = (Path(__file__).parent / _WRAPPER).read_text(encoding="utf-8")
    guid = f"{{{uuid.uuid5(uuid.NAMESPACE_URL, code.header + code.source + wrapper + repr(step))}}}"
    files = {
        f"{name}.h": code.header,
        f"{name}.c": code.source,
        "fmi2_model.h": _glue(contents, code, guid, float(step)),
        _WRAPPER: wrapper,
    }
    members: dict[str, bytes] = {"modelDescription.xml": _description(contents, name, guid)}
    members |= {f"sources/{file}": text.encode("utf-8") for file, text in files.items()}
    if binary:
        folder, suffix = _platform()
        members[f"binaries/{folder}/{name}{suffix}"] = _compiled(name, files, suffix)
    target = Path(path)
    _archive(target, members)
    return target


def _archive(target: Path, members: Mapping[str, bytes]) -> None:
    import zipfile
    from io import BytesIO

    content = BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for member, data in members.items():
            info = zipfile.ZipInfo(member, _LONG_AGO)
            info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(info, data)
    write(target, content.getvalue(), "the FMU")


def _glue(contents: Contents, code: Code, guid: str, step: float) -> str:
    """Return the header by which the wrapper finds the functions and sizes of the model."""
    name, big = code.name, code.name.upper()
    sizes = "\n".join(f"#define N_{k} {big}_N_{k}" for k in "XUPY")
    functions = "\n".join(
        f"#define model_{f} {name}_{f}" for f in ("dynamics", "outputs", "jacobians", "step", "p", "x0")
    )
    values = {
        "u0": list(contents.inputs.values()),
        "nominal": [abs(v) if v else 1.0 for v in contents.states.values()],
    }
    arrays = "\n".join(
        f"static const double model_{k}[{max(len(v), 1)}] = {{{', '.join(map(number, v)) or '0.0'}}};"
        for k, v in values.items()
    )
    return (
        f'/* The model of this unit. */\n#ifndef FMI2_MODEL_H\n#define FMI2_MODEL_H\n\n#include "{name}.h"\n\n'
        f'#define MODEL_GUID "{guid}"\n/* Longest step of co-simulation, s */\n#define MODEL_STEP {number(step)}\n\n'
        f"{sizes}\n\n{functions}\n\n{arrays}\n\n#endif\n"
    )


def _description(contents: Contents, name: str, guid: str) -> bytes:
    """Return the content of modelDescription.xml."""
    from xml.etree import ElementTree

    model, units = contents.model, contents.model.units
    of_outputs = {n: units.get(n, "") for n in model.output_names}
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=model.name or name,
        guid=guid,
        description="; ".join(contents.facts),
        generationTool=f"phugoid {__version__}",
        variableNamingConvention="flat",
        numberOfEventIndicators="0",
    )
    can = {
        "modelIdentifier": name,
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "true",
    }
    steps = {"canHandleVariableCommunicationStepSize": "true", "canInterpolateInputs": "true"}
    kinds: dict[str, dict[str, str]] = {"ModelExchange": can, "CoSimulation": {**can, **steps}}
    for kind, attributes in kinds.items():
        files = ElementTree.SubElement(ElementTree.SubElement(root, kind, attributes), "SourceFiles")
        for file in (f"{name}.c", _WRAPPER):
            ElementTree.SubElement(files, "File", name=file)
    used = sorted({u for u in (*units.values(), *of_outputs.values()) if u})
    if used:
        definitions = ElementTree.SubElement(root, "UnitDefinitions")
        for unit in used:
            ElementTree.SubElement(definitions, "Unit", name=unit)
    variables = ElementTree.SubElement(root, "ModelVariables")
    places: dict[str, int] = {}  # the number of each variable, from 1

    def add(reference: int, title: str, unit: str, real: Mapping[str, str], **attributes: str) -> None:
        places[title] = len(places) + 1
        attributes |= {"name": title, "valueReference": str(reference)}
        if title in late:
            attributes["description"] = late[title]
        one = ElementTree.SubElement(variables, "ScalarVariable", attributes)
        ElementTree.SubElement(one, "Real", {**({"unit": unit} if unit else {}), **real})

    delays = model.delays
    late = {n: f"{of}(t - {tau}): to be delayed outside" for n, (of, tau) in delays.inputs.items()}
    n_x, n_u, n_p = len(contents.states), len(contents.inputs), len(contents.values)
    taken = {*contents.inputs, *contents.values}
    late |= {
        f"output.{n}" if n in taken else n: f"without its delay, by {tau}: to be delayed outside"
        for n, tau in delays.outputs.items()
    }
    for k, (n, value) in enumerate(contents.inputs.items()):
        kind = "discrete" if n in contents.held else "continuous"
        add(2 * n_x + k, n, units.get(n, ""), {"start": number(value)}, causality="input", variability=kind)
    for k, n in enumerate(model.output_names):
        title = f"output.{n}" if n in taken else n
        add(2 * n_x + n_u + n_p + k, title, of_outputs[n], {}, causality="output", variability="continuous",
            initial="calculated")  # fmt: skip
    for k, (n, value) in enumerate(contents.values.items()):
        add(2 * n_x + n_u + k, n, units.get(n, ""), {"start": number(value)}, causality="parameter",
            variability="tunable", initial="exact")  # fmt: skip
    for k, (n, value) in enumerate(contents.states.items()):
        add(k, f"state.{n}", units.get(n, ""), {"start": number(value)}, causality="local", variability="continuous",
            initial="exact")  # fmt: skip
    for k, n in enumerate(contents.states):
        derivative = {"derivative": str(places[f"state.{n}"])}
        add(n_x + k, f"der(state.{n})", "", derivative, causality="local", variability="continuous",
            initial="calculated")  # fmt: skip
    _structure(root, contents, places, taken)
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text


def _structure(root: Any, contents: Contents, places: Mapping[str, int], taken: set[str]) -> None:
    """Add the model structure: the states and inputs that each equation depends on."""
    from xml.etree import ElementTree

    model = contents.model
    f = model.state_expressions()
    sides = {f"output.{n}" if n in taken else n: Expr(e) for n, e in model.output_expressions().items()}
    rates = {f"der(state.{n})": f[n] for n in contents.states}
    structure = ElementTree.SubElement(root, "ModelStructure")
    of = {**{n: places[f"state.{n}"] for n in contents.states}, **{n: places[n] for n in contents.inputs}}
    for kind, group in (("Outputs", sides), ("Derivatives", rates)):
        listed = ElementTree.SubElement(structure, kind)
        for title, e in group.items():
            depends = " ".join(str(of[n]) for n in sorted(e.symbols, key=lambda n: of.get(n, 0)) if n in of)
            ElementTree.SubElement(listed, "Unknown", index=str(places[title]), dependencies=depends)
    listed = ElementTree.SubElement(structure, "InitialUnknowns")
    for title in sorted([*sides, *rates], key=lambda title: places[title]):
        ElementTree.SubElement(listed, "Unknown", index=str(places[title]))


def _platform() -> tuple[str, str]:
    """Return the folder of binaries for this machine, as the standard names it, and the suffix of a library."""
    bits = "64" if sys.maxsize > 2**32 else "32"
    if sys.platform == "win32":
        return f"win{bits}", ".dll"
    return (f"darwin{bits}", ".dylib") if sys.platform == "darwin" else (f"linux{bits}", ".so")


def _compiled(name: str, files: Mapping[str, str], suffix: str) -> bytes:
    import subprocess
    from tempfile import TemporaryDirectory

    try:
        import fmpy
    except ImportError as error:
        raise MissingDependency(
            f'export_fmu needs FMPy, which has the headers of the FMI standard ({error}): pip install "phugoid[fmu]", '
            "or binary=False for a unit with source alone"
        ) from error
    compiler = os.environ.get("CC") or next(filter(shutil.which, ("cc", "gcc", "clang")), None)
    if compiler is None:
        raise MissingDependency(
            "export_fmu needs a C compiler (cc, gcc or clang): install one, name it in the environment variable CC, or "
            "take binary=False for a unit with source alone"
        )
    with TemporaryDirectory() as folder:
        for file, text in files.items():
            (Path(folder) / file).write_text(text, encoding="utf-8")
        library = f"{name}{suffix}"
        hidden = [] if suffix == ".dll" else ["-fPIC", "-fvisibility=hidden"]
        headers = Path(fmpy.__file__).parent / "c-code"
        command = [*compiler.split(), "-std=c99", "-O2", "-shared", *hidden, f"-I{headers}", f"{name}.c", _WRAPPER]
        done = subprocess.run([*command, "-o", library, "-lm"], cwd=folder, capture_output=True, text=True)
        if done.returncode != 0:
            raise DataError(f"export_fmu: {compiler} failed:\n{done.stderr.strip()}")
        return (Path(folder) / library).read_bytes()
