"""The controller as an FMU of FMI 2.0 for co-simulation: the exported C and a frame of ours, compiled if possible."""

import hashlib
import io
import platform
import shutil
import subprocess
import tempfile
import uuid
import warnings
import zipfile
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape

from fastcoil.base.machine import VERSION
from fastcoil.deliver.export.controller import Controller, templates
from fastcoil.deliver.export.languages import InC
from fastcoil.deliver.export.printer import Laws
from fastcoil.deliver.export.vectors import FLAGS, Vectors
from fastcoil.deliver.export.words import number, plain_text

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
