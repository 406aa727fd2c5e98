"""What the table ``[tariff]`` of a study asks for."""

from __future__ import annotations

from fastcoil.base.errors import InputError, nearest, shown
from fastcoil.loops.scenarios import Layout
from fastcoil.study.analysis.cost import TAKEN
from fastcoil.study.analysis.cost_summary import Billing
from fastcoil.study.analysis.tariff import tariff_of
from fastcoil.study.file.tables import TariffTable

_MOST_LABELS = 10


def billing_of(table: TariffTable, layout: Layout | None) -> Billing:
    """The prices, and the labels with which costs are compared.

    layout: of the study, None where it could not be planned; the labels are then not checked.

    Raises
    ------
    InputError
        With a sentence for each price that cannot be, and each dimension or label that the study does not have.
    """
    tariff = tariff_of(table.model_dump(exclude={"baseline"}))
    baseline = dict(table.baseline)
    if len(baseline) > 1:
        raise InputError(f"baseline = {shown(baseline)}: give one dimension and one of its labels")
    problems: list[str] = []
    if layout is not None:
        named = [f"the costs have a dimension or number {dim}, too: rename it" for dim in layout.sizes if dim in TAKEN]
        problems = named + [p for dim, label in baseline.items() for p in _problems(layout, dim, label)]
    if problems:
        raise InputError(problems)
    return Billing(tariff, baseline)


def _problems(layout: Layout, dim: str, label: float | str) -> list[str]:
    """A sentence if a study does not have a label."""
    dims = [name for name in layout.loop.sizes if name != "sample"]
    if dim not in dims:
        known = f"choose one of {', '.join(dims)}" if dims else "the study has no dimension of its own"
        return [f"baseline: {shown(dim)} is no dimension of the loops{nearest(dim, dims)}: {known}"]
    labels = layout.coordinates()[dim].values.tolist()
    if label not in labels:
        listed = ", ".join(map(str, labels[:_MOST_LABELS]))
        return [f"baseline: {dim} has no label {shown(label)}: choose one of {listed}"]
    return []
