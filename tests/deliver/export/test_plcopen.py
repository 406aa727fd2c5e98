"""The exported XML of PLCopen: the elements of the standard in its order, and together the Structured Text."""

import re
import xml.etree.ElementTree as ET
from functools import cache

import pytest
from helpers.commands import assert_command_refused, fastcoil
from helpers.exported import has_differences, structured_text_runner
from test_same_controller import loop_of

import fastcoil as fc
from fastcoil.deliver.export.words import IEC_KEYWORDS

pytestmark = pytest.mark.kernel

TC6 = "{http://www.plcopen.org/xml/tc6_0201}"
XHTML = "{http://www.w3.org/1999/xhtml}xhtml"
CHILDREN = {
    "project": "fileHeader contentHeader types instances",
    "contentHeader": "coordinateInfo", "coordinateInfo": "fbd ld sfc", "fbd": "scaling", "ld": "scaling",
    "sfc": "scaling", "types": "dataTypes pous", "instances": "configurations", "pous": "(pou )+",
    "pou": "interface body documentation",
    "interface": "(returnType )?inputVars (outputVars )?(localVars )*", "returnType": "LREAL",
    "inputVars": "(variable )+", "outputVars": "(variable )+", "localVars": "(variable )+",
    "variable": "type (initialValue )?(documentation )?", "type": "(LREAL|BOOL|INT|array)",
    "array": "dimension baseType", "baseType": "LREAL", "initialValue": "(simpleValue|arrayValue)",
    "arrayValue": "(value )+", "value": "simpleValue", "body": "ST", "ST": "xhtml", "documentation": "xhtml",
}  # fmt: skip
"""What an element holds, in the order of the standard, for the elements that a controller needs."""
ATTRIBUTES = {
    "fileHeader": "companyName productName productVersion creationDateTime", "contentHeader": "name", "scaling": "x y",
    "pou": "name pouType", "variable": "name", "dimension": "lower upper", "simpleValue": "value",
}  # fmt: skip


@pytest.fixture(scope="module")
def export_files(tmp_path_factory):
    """name → the project as an element, the Structured Text of the same controller, and the vectors."""

    @cache
    def files(name):
        test = fc.ValveTest() if name == "identify" else None
        folder = tmp_path_factory.mktemp(name)
        xml, stored = fc.export_controller(loop_of(name), folder / "valve.xml", "plcopen", test=test)
        text = fc.export_controller(loop_of(name), folder / "valve.st", "st", test=test)[0].read_text()
        return ET.parse(xml).getroot(), text, stored

    return files


each_loop = pytest.mark.parametrize("name", ["inverse", "identify", pytest.param("smooth", marks=pytest.mark.full)])


def type_of(element):
    (kind,) = element
    if kind.tag != f"{TC6}array":
        return kind.tag.removeprefix(TC6)
    ends = kind.find(f"{TC6}dimension")
    return f"ARRAY[{ends.get('lower')}..{ends.get('upper')}] OF {type_of(kind.find(f'{TC6}baseType'))}"


def recombine(project):
    """Structured Text of the units of a project, a declaration a line."""
    lines = []
    for pou in project.iter(f"{TC6}pou"):
        kind = {"function": "FUNCTION", "functionBlock": "FUNCTION_BLOCK"}[pou.get("pouType")]
        returns = pou.find(f"{TC6}interface/{TC6}returnType")
        lines.append(f"{kind} {pou.get('name')}{'' if returns is None else f' : {type_of(returns)}'}")
        for group in pou.find(f"{TC6}interface"):
            if group is returns:
                continue
            opening = {"inputVars": "VAR_INPUT", "outputVars": "VAR_OUTPUT"}.get(group.tag.removeprefix(TC6), "VAR")
            lines.append(f"{opening} CONSTANT" if group.get("constant") else opening)
            for variable in group:
                values = [element.get("value") for element in variable.iter(f"{TC6}simpleValue")]
                kind_of = type_of(variable.find(f"{TC6}type"))
                value = f"[{', '.join(values)}]" if kind_of.startswith("ARRAY") else "".join(values)
                lines.append(f"{variable.get('name')} : {kind_of}{f' := {value}' if values else ''};")
            lines.append("END_VAR")
        lines += [pou.find(f"{TC6}body/{TC6}ST/{XHTML}").text, f"END_{kind}"]
    return "\n".join(lines) + "\n"


def parts_of(text):
    """Of each unit: its head, its declarations, and its body to the last byte."""
    for kind, head, inner in re.findall(r"^(FUNCTION(?:_BLOCK)?) (.*?)\n(.*?)^END_\1$", text, re.MULTILINE | re.DOTALL):
        declarations, _, body = inner.rpartition("END_VAR\n")
        variables = []
        for section in f"{declarations}END_VAR\n".split("END_VAR\n")[:-1]:
            section_text = re.sub(r"\(\*.*?\*\)", "", section, flags=re.DOTALL).strip()
            opening, _, names = section_text.partition("\n")
            for variable_names, rest in re.findall(r"([\w,\s]+) : ([^;]+);", names):
                kind_of = re.sub(r"\s+", " ", rest).replace("[ ", "[").replace(" ]", "]")
                variables += [(opening.strip(), name.strip(), kind_of) for name in variable_names.split(",")]
        yield kind, head, sorted(variables), body.removeprefix("\n")


@each_loop
def test_its_elements_are_those_of_the_standard_in_their_order(export_files, name):
    """Names, order, attributes and types; the schema itself is not ours to copy."""
    project, *_ = export_files(name)
    assert project.tag == f"{TC6}project"
    for element in project.iter():
        assert element.tag == XHTML or element.tag.startswith(TC6)
        tag = element.tag.removeprefix(TC6)
        inside = " ".join(child.tag.rpartition("}")[2] for child in element)
        assert re.fullmatch(CHILDREN.get(tag, ""), inside) or re.fullmatch(CHILDREN.get(tag, ""), f"{inside} "), tag
        optional = {"constant"} & set(element.attrib) if tag == "localVars" else set()
        assert set(element.attrib) == set(ATTRIBUTES.get(tag, "").split()) | optional
        assert not (element.text or "").strip() or tag == XHTML
    names = [element.get("name") for element in project.iter() if element.tag in (f"{TC6}pou", f"{TC6}variable")]
    assert all(re.fullmatch(r"[A-Za-z]\w*", element) for element in names)
    assert not {element.casefold() for element in names} & IEC_KEYWORDS


@each_loop
def test_the_class_model_of_the_schema_reads_it(tmp_path, export_files, name):
    """Names, attributes and values that are not in the schema are errors; order is checked above."""
    plcopen = pytest.importorskip("plcopen", reason="plcopen is not installed: pip install --group test")
    from xsdata.formats.dataclass.parsers import XmlParser

    project, *_ = export_files(name)
    parsed_project = XmlParser().from_string(ET.tostring(project, encoding="unicode"), plcopen.Project)
    assert [pou.name for pou in parsed_project.types.pous.pou][-1] == "FB_valve"
    assert len(parsed_project.types.pous.pou) == len(project.findall(f".//{TC6}pou"))


@each_loop
def test_interface_and_body_are_the_structured_text(export_files, name):
    """Declarations one by one, bodies byte by byte; and the whole of it gives the kernel's numbers."""
    project, text, stored = export_files(name)
    structured_text = recombine(project)
    assert list(parts_of(structured_text)) == list(parts_of(text))
    assert len(list(parts_of(text))) == text.count("END_FUNCTION")
    if name == "inverse":
        assert not has_differences(structured_text_runner(structured_text), stored)
        broken = structured_text.replace("u > u_ext ", "u > u_ext + 0.1 ")
        assert has_differences(structured_text_runner(broken), stored)


def test_what_the_code_says_of_a_variable_is_its_documentation(export_files):
    project, text, _ = export_files("inverse")
    documentation = {
        variable.get("name"): variable.find(f"{TC6}documentation/{XHTML}").text
        for variable in project.iter(f"{TC6}variable")
        if variable.find(f"{TC6}documentation") is not None
    }
    assert "kelvin" in documentation["KP"]
    assert f"(* {documentation['T_sup']} *)" in text


def test_the_command_finds_it_by_its_suffix_and_it_has_the_same_bytes_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop.toml").write_text("[loop]\nbacklash_estimate = 0.05\n")
    contents = []
    for _ in range(2):
        result = fastcoil("export", "loop.toml", "-o", "valve.xml")
        assert result.exit_code == 0, result.output
        assert result.output.splitlines()[-2:] == ["Written: valve.xml", "Written: valve_vectors.csv"]
        contents.append((tmp_path / "valve.xml").read_bytes())
    assert contents[0] == contents[1]
    (tmp_path / "other.xml").write_text("<project/>")
    assert_command_refused("export", "loop.toml", "-o", "other.xml")
