"""``export_controller``: the controller of a loop as code for the field, with vectors that prove a port of it."""

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

from fastcoil.base.arguments import checking, choice_of, instance_of, path_of, refuse
from fastcoil.base.errors import InputError, shown
from fastcoil.base.files import commit, exists, has_mark, require_file
from fastcoil.base.machine import VERSION
from fastcoil.deliver.export.controller import Controller, templates
from fastcoil.deliver.export.languages import InC, InST, st_number
from fastcoil.deliver.export.printer import Laws
from fastcoil.deliver.export.vectors import FLAGS, Vectors, cycles, vectors_of
from fastcoil.deliver.export.words import number, plain_text
from fastcoil.loops.loop import Loop
from fastcoil.loops.valve_test import ValveTest

SUFFIXES = {"c": ".c", "st": ".st", "python": ".py", "fmu": ".fmu", "plcopen": ".xml"}  # by language
FIRST_VECTORS = 400  # that a program in Structured Text holds, which cannot read files
_MARK = b"ritten by fastcoil "  # in the head of every file
_TOLERANCE = 1e-12


def export_controller(
    loop: Loop, path: str | os.PathLike[str], language: str = "c", *, test: ValveTest | None = None
) -> list[Path]:
    """Write the controller of a loop as code for the field: PI, backlash inverse and estimator.

    Beside the code, ``NAME_vectors.csv`` gives what it must answer, cycle by cycle, as fastcoil's own kernel does; with
    Structured Text, ``NAME_check.st`` is a program that holds the first of them.  Earlier files of these names are
    replaced, files that fastcoil did not write are not.

    Parameters
    ----------
    loop
        One loop, no sweep: parameters of its controller, inverse and estimator are in the code.  Its plant is only that
        of the simulated day among the vectors.
    path
        File of the code: ``NAME.c``, ``NAME.st``, ``NAME.py``, ``NAME.fmu`` or ``NAME.xml``.  NAME is in the names that
        other code sees.
    language
        ``"c"`` (C99), ``"st"`` (Structured Text of IEC 61131-3), ``"python"``, ``"fmu"`` (the C for co-simulation by
        FMI 2.0, compiled where this machine has a C compiler) or ``"plcopen"`` (the Structured Text as XML of PLCopen,
        TC6 2.01).
    test
        A valve test that the controller runs when its input ``start_test`` turns true; ``start`` and ``every`` play no
        part.  A loop with ``test_start`` has one without this.

    Returns
    -------
    list of pathlib.Path
        The files, the code first.

    Raises
    ------
    InputError
        With one sentence for each mistake, before anything is written.
    """
    with checking() as check:
        check(instance_of, "loop", loop, Loop, "give a fastcoil.Loop")
        path = check(path_of, "path", path, "give a file such as inverse.c")
        language = check(choice_of, "language", language, SUFFIXES)
        test = check.unless_none(instance_of, "test", test, ValveTest, "give a fastcoil.ValveTest")
    require_file("path", path, SUFFIXES[language])
    if not _name_of(path) or not re.fullmatch(r"[A-Za-z0-9 _.,()+-]+", path.name):
        cure = "give it a name of letters a to z, digits, spaces and _ . , ( ) + -, which the code and comments contain"
        raise InputError(f"path = {shown(str(path))}: {cure}")
    loop = loop if test is None else loop.assign(**test.parameters())
    controller = Controller(loop)
    text = controller.text()
    try:
        vectors = vectors_of(loop, controller, text)
        fault = _difference(text, vectors) if controller.own else ""
    except ArithmeticError as error:
        fault = f"a cycle of its vectors has a {error}"
    if fault:
        cure = "leave out what a number may overflow or be divided by 0 in, or port its Python by hand"
        raise InputError(f"{' and '.join(controller.own)} cannot be exported: {fault}: {cure}")
    files = _files(path, language, text, vectors, controller)
    # somebody else's, such as a rule in mine.py beside the loop in mine.toml
    others = [each for each in map(path.with_name, files) if exists(each) and not has_mark(each, _MARK)]
    refuse([f"{each} exists, and fastcoil did not write it: choose another name, or delete it" for each in others])
    for name, content in files.items():
        commit(path.with_name(name), content if isinstance(content, bytes) else content.encode())
    return [path.with_name(name) for name in files]


def _name_of(path: Path) -> str:
    """The file's name as part of names in a program."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", path.stem).strip("_")
    return f"c_{name}" if name[:1].isdigit() else name


def _files(path: Path, language: str, text: str, vectors: Vectors, controller: Controller) -> dict[str, str | bytes]:
    name, stored = _name_of(path), f"{path.stem}_vectors.csv"
    words = {
        "name": name, "file": path.name, "vectors": stored, "inputs": vectors.inputs, "outputs": vectors.outputs,
        "size": vectors.size, "checksum": f"{vectors.checksum:08x}",
    }  # fmt: skip
    files: dict[str, str | bytes] = {stored: vectors.csv(path.name, controller.number["sample_time"])}
    code: str | bytes
    if language == "c":
        code = InC(Laws(text), name).text() + _check("c", words | {"columns": len(vectors.columns)})
    elif language == "python":
        code = text.rstrip() + "\n" + _check("py", words | {"zeros": "zeros(" in text})
    elif language == "fmu":
        code = fmu(controller, text, name, vectors)
    elif language == "plcopen":
        template = templates().get_template("plcopen.xml.jinja")
        code = template.render(name=name, block=InST(Laws(text), name), escape=escape, version=VERSION)
    else:
        code = InST(Laws(text), name).text()
        n = min(FIRST_VECTORS, vectors.size)
        # no number has a literal; far beyond the limits does the same
        columns = {
            one: "\n        ".join(
                wrap(", ".join(map(st_number, np.nan_to_num(values[:n], True, -1e30, 1e30, -1e30))), 92)
            )
            for one, values in vectors.columns.items()
        }
        files[f"{path.stem}_check.st"] = _check("st", words | {"n": n, "columns": columns})
    return {path.name: code, **files}


def _difference(text: str, vectors: Vectors) -> str:
    """Where the translation of a rule of the user does something else than the kernel; empty where it does the same."""
    given = {name: vectors.columns[name] for name in vectors.inputs}
    expected = np.array([vectors.columns[name] for name in vectors.outputs])
    found = np.array(list(cycles(text, given, vectors.outputs))).T
    off = np.abs(found - expected).max(axis=0)
    wrong = np.flatnonzero(~(off <= _TOLERANCE))
    return f"cycle {wrong[0]} of its vectors is off by {off[wrong[0]]:.2g}" if wrong.size else ""


def _check(kind: str, words: dict[str, object]) -> str:
    return templates().get_template(f"check.{kind}.jinja").render(words, version=VERSION)


_OPTIONS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden", "-s")
_UNITS = {"T_sup": "degC", "T_set": "degC", "m_a": "kg s-1"}
_BASE_UNITS = {
    "degC": 'K="1" offset="273.15"', "K": 'K="1"', "K-1": 'K="-1"', "s": 's="1"', "s-1": 's="-1"',
    "min": 's="1" factor="60"', "kg s-1": 'kg="1" s="-1"', "K-1 s-1": 'K="-1" s="-1"', "1": "",
}  # fmt: skip


class _Variable(NamedTuple):
    """A variable as the description has it: texts fit for XML; start: empty where it is calculated."""

    name: str
    causality: str
    text: str
    unit: str
    start: str = ""
    is_flag: bool = False


def fmu(controller: Controller, text: str, name: str, vectors: Vectors) -> bytes:
    """The file, with the same bytes whenever the same compiler makes it; warns where there is no binary in it."""
    laws = Laws(text)
    variables = _variables(controller, laws, vectors)
    words = {
        "controller": controller, "name": name, "version": VERSION, "text": _attribute(controller.words()),
        "inputs": vectors.inputs, "outputs": vectors.outputs, "flags": FLAGS, "variables": variables,
        "units": {one.unit: _BASE_UNITS.get(one.unit) for one in variables if not one.is_flag},
    }  # fmt: skip
    files = {
        "modelDescription.xml": b"",
        "sources/fmi2.c": b"",
        "sources/controller.c": InC(laws, name).text().encode(),
    }
    guid = ""
    for _ in range(2):  # the second time with what identifies the first
        for path in list(files)[:2]:
            template = templates().get_template(f"{Path(path).name}.jinja")
            files[path] = template.render(words, guid=guid).encode()
        guid = str(uuid.UUID(bytes=hashlib.sha256(b"".join(files.values())).digest()[:16]))
    files |= {f"binaries/linux64/{name}.so": binary for binary in _compiled(files)}
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for path, content in files.items():
            info = zipfile.ZipInfo(path)  # of 1980, whenever it is written
            info.external_attr = 0o644 << 16
            # the description begins with the mark of what fastcoil wrote
            info.compress_type = zipfile.ZIP_STORED if path.endswith("xml") else zipfile.ZIP_DEFLATED
            archive.writestr(info, content)
    return stream.getvalue()


def _variables(controller: Controller, laws: Laws, vectors: Vectors) -> list[_Variable]:
    """Inputs and outputs as the vectors have them, then the parameters of the controller, which are in its code."""
    middle = 24.0 if controller.heats else 14.0
    start = {"T_sup": middle, "T_set": middle, "m_a": -1.0, "enabled": 1.0}
    said = {one.name: one.said for one in (*laws.fields, *laws.functions["step"].arguments)}
    columns = [*vectors.inputs, *vectors.outputs]
    used = {one.name for one in laws.constants}
    return [
        *(
            _Variable(
                one, "input", _attribute(said[one]), _UNITS.get(one, "1"), number(start.get(one, 0.0)), one in FLAGS
            )
            for one in vectors.inputs
        ),
        *(_Variable(one, "output", _attribute(said[one]), "1", "", one == "rising") for one in vectors.outputs),
        *(
            _Variable(one, "local", _attribute(p.text), _attribute(p.unit or "1"), number(controller.number[one]))
            for one, p in controller.parameters.items()
            if one.upper() in used and one not in columns
        ),
    ]


def _attribute(text: str) -> str:
    return escape(plain_text(text))


def _compiled(files: dict[str, bytes]) -> list[bytes]:
    """The sources as a shared library; none, with a warning, where this machine does not compile them."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if (platform.system(), platform.machine()) != ("Linux", "x86_64"):
        reason = "binaries are for Linux on x86-64"
    elif compiler is None:
        reason = "no C compiler was found"
    else:
        with tempfile.TemporaryDirectory() as folder:
            for path, content in files.items():
                Path(folder, Path(path).name).write_bytes(content)
            call = [compiler, *_OPTIONS, "fmi2.c", "-o", "fmu.so", "-lm"]
            done = subprocess.run(call, cwd=folder, check=False, capture_output=True, text=True)
            if done.returncode == 0:
                return [Path(folder, "fmu.so").read_bytes()]
            reason = " ".join(f"{compiler} failed {done.stderr}".split())[:200]
    warnings.warn(f"the FMU has sources and no binary, which a simulator has to compile: {reason}", stacklevel=4)
    return []
