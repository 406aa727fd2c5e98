"""The function block as XML of PLCopen (TC6 2.01, IEC 61131-10): interfaces as elements, bodies in Structured Text."""

from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

from fastcoil.base.machine import VERSION
from fastcoil.deliver.export.languages import InST, Unit
from fastcoil.deliver.export.printer import Named

_LISTS = {"VAR_INPUT": "inputVars", "VAR_OUTPUT": "outputVars"}
"""Elements of variables, by what their declaration begins with; all others are localVars."""


def plcopen(block: InST, name: str) -> str:
    """The file.  name: of the project in it."""
    project = Element("project", xmlns="http://www.plcopen.org/xml/tc6_0201")
    project.append(Comment(f" Written by fastcoil {VERSION}.  The date is fixed: the same controller, the same file. "))
    product = {"companyName": "fastcoil", "productName": "fastcoil", "productVersion": VERSION}
    SubElement(project, "fileHeader", product, creationDateTime="1980-01-01T00:00:00")
    coordinates = SubElement(SubElement(project, "contentHeader", name=name), "coordinateInfo")
    for language in ("fbd", "ld", "sfc"):
        SubElement(SubElement(coordinates, language), "scaling", x="1", y="1")
    types = SubElement(project, "types")
    SubElement(types, "dataTypes")
    units = SubElement(types, "pous")
    for unit in block.units():
        _add_unit(units, unit, block)
    SubElement(SubElement(project, "instances"), "configurations")
    indent(project)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{tostring(project, encoding="unicode")}\n'


def _add_unit(units: Element, unit: Unit, block: InST) -> None:
    pou = SubElement(units, "pou", name=unit.name, pouType="function" if unit.returns else "functionBlock")
    interface = SubElement(pou, "interface")
    if unit.returns:
        SubElement(SubElement(interface, "returnType"), block.TYPES[unit.returns])
    for opening, variables in unit.variables.items():
        is_constant = opening == "VAR CONSTANT"
        group = SubElement(interface, _LISTS.get(opening, "localVars"), {"constant": "true"} if is_constant else {})
        for one in variables:
            _add_variable(group, one, block, has_value=is_constant)
    _add_text(SubElement(pou, "body"), "ST", "\n".join(unit.body))
    _add_text(pou, "documentation", unit.text)


def _add_variable(group: Element, one: Named, block: InST, *, has_value: bool) -> None:
    variable = SubElement(group, "variable", name=one.name)
    kind = SubElement(variable, "type")
    values = one.value if isinstance(one.value, list) else [one.value]
    size = one.size or (len(values) if isinstance(one.value, list) else 0)
    if size:
        array = SubElement(kind, "array")
        SubElement(array, "dimension", lower="0", upper=str(size - 1))
        kind = SubElement(array, "baseType")
    SubElement(kind, block.TYPES[one.kind])
    if has_value:
        initial = SubElement(variable, "initialValue")
        array = SubElement(initial, "arrayValue") if size else initial
        for value in values:
            place = SubElement(array, "value") if size else initial
            SubElement(place, "simpleValue", value=block.constant(value))
    if one.said:
        _add_text(variable, "documentation", one.said)


def _add_text(parent: Element, tag: str, text: str) -> None:
    SubElement(SubElement(parent, tag), "xhtml", xmlns="http://www.w3.org/1999/xhtml").text = text
