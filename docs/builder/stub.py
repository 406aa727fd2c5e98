"""Write presets and parameters into the type stub of ``Loop``: ``python docs/builder/stub.py``, or ``make pages``."""

import re
from pathlib import Path

import fastcoil as fc
from fastcoil.model.parameter_table import PARAMETERS

STUB = Path(fc.__file__).parent / "loops" / "keywords.pyi"


def literal(words):
    """Return the type of some words."""
    return "Literal[" + ", ".join(f'"{word}"' for word in words) + "]"


def filled(text):
    """Return the stub with the presets and parameters of today."""
    fields = [f"    {p.name}: {f'{literal(p.choices)} | ' if p.is_word else ''}Value\n" for p in PARAMETERS.values()]
    text = re.sub(r"(?<=PresetName: TypeAlias = )Literal\[.*?\]", literal(fc.presets()), text, flags=re.DOTALL)
    return re.sub(r"(?<=    converged: bool \| Value\n)(    \w+: .*\n)*", "".join(fields), text)


if __name__ == "__main__":
    STUB.write_text(filled(STUB.read_text()))
