"""``export_controller``: the controller of a loop as code for the field, with test vectors to verify a port."""

import hashlib
import io
import os
import platform
import re
import shutil
import subprocess
import tempfile
import uuid
import warnings
import zipfile
from pathlib import Path
from textwrap import wrap
from typing import NamedTuple
from xml.sax.saxutils import escape

import numpy as np

from fastcoil.base.arguments import argument_checks, raise_problems, require_choice, require_instance, require_path
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.base.files import exists, has_mark, require_output_file, write_atomically
from fastcoil.base.machine import VERSION
from fastcoil.deliver.export.controller import Controller, templates
from fastcoil.deliver.export.languages import CPrinter, StructuredTextPrinter, structured_text_literal
from fastcoil.deliver.export.printer import Laws
from fastcoil.deliver.export.vectors import FLAG_INPUTS, Vectors, make_vectors, run_cycles
from fastcoil.deliver.export.words import number_literal, plain_text
from fastcoil.loops.loop import Loop
from fastcoil.loops.valve_test import ValveTest

SUFFIXES = {"c": ".c", "st": ".st", "python": ".py", "fmu": ".fmu", "plcopen": ".xml"}  # by language
_FILE_MARK = b"ritten by fastcoil "  # in the head of every exported file, which may be overwritten


def export_controller(
    loop: Loop, path: str | os.PathLike[str], language: str = "c", *, test: ValveTest | None = None
) -> list[Path]:
    """Write the controller of a loop as code for the field: PI, backlash inverse and estimator.

    Beside the code, ``NAME_vectors.csv`` has the expected answers of fastcoil's kernel, cycle by cycle; with Structured
    Text, the program ``NAME_check.st`` holds the first 400 of them.  Earlier exports of these names are replaced, other
    files are not.

    Parameters
    ----------
    loop
        One loop, no sweep: the code has the parameters of its controller, inverse and estimator.  Its plant appears
        only in the simulated day among the vectors.
    path
        File of the code: ``NAME.c``, ``NAME.st``, ``NAME.py``, ``NAME.fmu`` or ``NAME.xml``.  NAME is part of the
        public names in the code.
    language
        ``"c"`` (C99), ``"st"`` (Structured Text of IEC 61131-3), ``"python"``, ``"fmu"`` (the C for co-simulation by
        FMI 2.0, compiled where this machine has a C compiler) or ``"plcopen"`` (the Structured Text as XML of PLCopen,
        TC6 2.01).
    test
        A valve test that the controller runs when its input ``start_test`` turns true; its ``start`` and ``every`` are
        ignored.  Not needed for a loop with ``test_start``.

    Returns
    -------
    list of pathlib.Path
        The files, the code first.

    Raises
    ------
    InputError
        With one sentence for each mistake, before anything is written.
    StorageError
        If a file cannot be written.

    Examples
    --------
    >>> loop = fc.Loop.preset("lbnl").assign(backlash_estimate=0.05)
    >>> [path.name for path in fc.export_controller(loop, "inverse.c")]
    ['inverse.c', 'inverse_vectors.csv']
    """
    with argument_checks() as check:
        check(require_instance, "loop", loop, Loop, "give a fastcoil.Loop")
        path = check(require_path, "path", path, "give a file such as inverse.c")
        language = check(require_choice, "language", language, SUFFIXES)
        test = check.unless_none(require_instance, "test", test, ValveTest, "give a fastcoil.ValveTest")
    require_output_file("path", path, SUFFIXES[language])
    if not _program_name(path) or not re.fullmatch(r"[A-Za-z0-9 _.,()+-]+", path.name):
        cure = "give it a name of letters a to z, digits, spaces and _ . , ( ) + -, which the code and comments contain"
        raise InputError(f"path = {short_repr(str(path))}: {cure}", "path", "path")
    loop = loop if test is None else loop.assign(**test.parameters())
    controller = Controller(loop)
    text = controller.laws_text()
    try:
        vectors = make_vectors(loop, controller, text)
        problem = _describe_translation_error(text, vectors) if controller.user_rules else ""
    except ArithmeticError as error:
        problem = f"a cycle of its vectors has a {error}"
    if problem:
        cure = "leave out what a number may overflow or be divided by 0 in, or port its Python by hand"
        sentence = f"{' and '.join(controller.user_rules.values())} cannot be exported: {problem}: {cure}"
        raise InputError(sentence, next(iter(controller.user_rules), "loop"), "code")
    files = _file_contents(path, language, text, vectors, controller)
    # the user's files, such as a rule in mine.py beside the loop in mine.toml
    foreign_files = [file for file in map(path.with_name, files) if exists(file) and not has_mark(file, _FILE_MARK)]
    cure = "exists, and fastcoil did not write it: choose another name"
    raise_problems([Problem(f"{file} {cure}", "path", "path") for file in foreign_files])
    for name, content in files.items():
        write_atomically(path.with_name(name), content if isinstance(content, bytes) else content.encode())
    return [path.with_name(name) for name in files]


def _program_name(path: Path) -> str:
    """Return the stem of a file in letters that a program may have in its names."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", path.stem).strip("_")
    return f"c_{name}" if name[:1].isdigit() else name


def _file_contents(
    path: Path, language: str, text: str, vectors: Vectors, controller: Controller
) -> dict[str, str | bytes]:
    """Return the content of each file of an export, by its name: code, test vectors, a check in Structured Text."""
    name, vectors_file = _program_name(path), f"{path.stem}_vectors.csv"
    template_values = {
        "name": name, "file": path.name, "vectors": vectors_file, "inputs": vectors.inputs, "outputs": vectors.outputs,
        "size": vectors.n_cycles, "checksum": f"{vectors.checksum:08x}",
    }  # fmt: skip
    files: dict[str, str | bytes] = {vectors_file: vectors.csv_text(path.name, controller.number["sample_time"])}
    code: str | bytes
    if language == "c":
        check = _render_check_program("c", template_values | {"columns": len(vectors.columns)})
        code = CPrinter(Laws(text), name).code_text() + check
    elif language == "python":
        code = text.rstrip() + "\n" + _render_check_program("py", template_values | {"zeros": "zeros(" in text})
    elif language == "fmu":
        code = make_fmu(controller, text, name, vectors)
    elif language == "plcopen":
        template = templates().get_template("plcopen.xml.jinja")
        code = template.render(name=name, block=StructuredTextPrinter(Laws(text), name), escape=escape, version=VERSION)
    else:
        code = StructuredTextPrinter(Laws(text), name).code_text()
        n = min(400, vectors.n_cycles)  # in the program itself, which cannot read files
        columns = {}
        for column, values in vectors.columns.items():
            # NaN has no literal; a number far beyond the limits is refused as well
            literals = map(structured_text_literal, np.nan_to_num(values[:n], True, -1e30, 1e30, -1e30))
            columns[column] = "\n        ".join(wrap(", ".join(literals), 92))
        files[f"{path.stem}_check.st"] = _render_check_program("st", template_values | {"n": n, "columns": columns})
    return {path.name: code, **files}


def _describe_translation_error(text: str, vectors: Vectors) -> str:
    """Describe the first cycle in which a translated rule of the user differs from the kernel; empty if none does."""
    inputs = {name: vectors.columns[name] for name in vectors.inputs}
    expected_outputs = np.array([vectors.columns[name] for name in vectors.outputs])
    deviation = np.abs(np.array(list(run_cycles(text, inputs, vectors.outputs))).T - expected_outputs).max(axis=0)
    for cycle in np.flatnonzero(~(deviation <= 1e-12)):  # exp and log may differ in the last digit
        return f"cycle {cycle} of its vectors is off by {deviation[cycle]:.2g}"
    return ""


def _render_check_program(kind: str, template_values: dict[str, object]) -> str:
    return templates().get_template(f"check.{kind}.jinja").render(template_values, version=VERSION)


_FMI_BASE_UNITS = {
    "degC": 'K="1" offset="273.15"', "K": 'K="1"', "K-1": 'K="-1"', "s": 's="1"', "s-1": 's="-1"',
    "min": 's="1" factor="60"', "kg s-1": 'kg="1" s="-1"', "K-1 s-1": 'K="-1" s="-1"', "1": "",
}  # fmt: skip
"""Attributes of ``BaseUnit`` of FMI 2.0 by unit."""


class _Variable(NamedTuple):
    """A variable of the model description: texts escaped for XML; start: empty for a calculated one."""

    name: str
    causality: str
    text: str
    unit: str
    start: str = ""
    is_flag: bool = False


def make_fmu(controller: Controller, text: str, name: str, vectors: Vectors) -> bytes:
    """Return the content of an FMU, the same bytes with the same compiler; warn if it has no binary."""
    laws = Laws(text)
    variables = _model_variables(controller, laws, vectors)
    template_values = {
        "controller": controller, "name": name, "version": VERSION, "text": _escape_for_xml(controller.describe()),
        "inputs": vectors.inputs, "outputs": vectors.outputs, "flags": FLAG_INPUTS, "variables": variables,
        "units": {variable.unit: _FMI_BASE_UNITS.get(variable.unit) for variable in variables if not variable.is_flag},
    }  # fmt: skip
    code = CPrinter(laws, name).code_text().encode()
    files = {"modelDescription.xml": b"", "sources/fmi2.c": b"", "sources/controller.c": code}
    guid = ""
    for _ in range(2):  # the second time with the identifier of the first
        for path in list(files)[:2]:
            template = templates().get_template(f"{Path(path).name}.jinja")
            files[path] = template.render(template_values, guid=guid).encode()
        guid = str(uuid.UUID(bytes=hashlib.sha256(b"".join(files.values())).digest()[:16]))
    files |= {f"binaries/linux64/{name}.so": binary for binary in _compile_library(files)}
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for path, content in files.items():
            info = zipfile.ZipInfo(path)  # dated 1980, for the same bytes
            info.external_attr = 0o644 << 16
            # the description begins with ``_FILE_MARK``, uncompressed
            info.compress_type = zipfile.ZIP_STORED if path.endswith("xml") else zipfile.ZIP_DEFLATED
            archive.writestr(info, content)
    return stream.getvalue()


def _model_variables(controller: Controller, laws: Laws, vectors: Vectors) -> list[_Variable]:
    """Return inputs and outputs in the order of the vectors, then the parameters that are constants of the code."""
    start = {"T_sup": controller.set_point, "T_set": controller.set_point, "m_a": -1.0, "enabled": 1.0}
    units = {"T_sup": "degC", "T_set": "degC", "m_a": "kg s-1"}
    declarations = (*laws.fields, *laws.functions["step"].arguments)
    texts = {declaration.name: _escape_for_xml(declaration.description) for declaration in declarations}
    variables = []
    for name in vectors.inputs:
        value = number_literal(start.get(name, 0.0))
        variables.append(_Variable(name, "input", texts[name], units.get(name, "1"), value, name in FLAG_INPUTS))
    variables += [_Variable(name, "output", texts[name], "1", "", name == "rising") for name in vectors.outputs]
    constants = {constant.name for constant in laws.constants}
    for name, p in controller.parameters.items():
        if name.upper() in constants and name not in vectors.columns:
            value = number_literal(controller.number[name])
            variables.append(_Variable(name, "local", _escape_for_xml(p.text), _escape_for_xml(p.unit or "1"), value))
    return variables


def _escape_for_xml(text: str) -> str:
    return escape(plain_text(text))


def _compile_library(files: dict[str, bytes]) -> list[bytes]:
    """Compile the sources to a shared library; return none, with a warning, if this machine cannot."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if (platform.system(), platform.machine()) != ("Linux", "x86_64"):
        reason = "binaries are for Linux on x86-64"
    elif compiler is None:
        reason = "no C compiler was found"
    else:
        with tempfile.TemporaryDirectory() as folder:
            for path, content in files.items():
                Path(folder, Path(path).name).write_bytes(content)
            options = ["-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden", "-s"]
            command = [compiler, *options, "fmi2.c", "-o", "fmu.so", "-lm"]
            compiler_run = subprocess.run(command, cwd=folder, check=False, capture_output=True, text=True)
            if compiler_run.returncode == 0:
                return [Path(folder, "fmu.so").read_bytes()]
            reason = " ".join(f"{compiler} failed {compiler_run.stderr}".split())[:200]
    warnings.warn(f"the FMU has sources and no binary, which a simulator has to compile: {reason}", stacklevel=4)
    return []
