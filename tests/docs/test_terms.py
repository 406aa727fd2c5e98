"""Links to the glossary: at the first use of a term, and nowhere that it would spoil."""

from pathlib import Path

import pytest
from builder.terms import linked, terms

ROOT = Path(__file__).parents[2]
GLOSSARY = """# Glossary

## Loop

### Limit cycle

A swing.

### Buffer

### Wet, stem travel

### PI

A law.
"""


def test_terms_are_the_headings_but_for_words_with_more_meanings():
    assert terms(GLOSSARY) == {"limit cycle": "limit-cycle", "buffer": "buffer", "stem travel": "wet-stem-travel"}


@pytest.mark.parametrize(
    ("text", "after"),
    [
        ("A buffer, and a buffer.", "A [buffer](g.md#buffer), and a buffer."),
        ("Buffers of limit\ncycles", "[Buffers](g.md#buffer) of [limit\ncycles](g.md#limit-cycle)"),
        ("[the buffer](buffer.md)", "[the buffer](buffer.md)"),
        ("[the buffer][b] and its limit cycle", "[the buffer][b] and its [limit cycle](g.md#limit-cycle)"),
        ("`buffer` and $buffer$", "`buffer` and $buffer$"),
        ("# A buffer\n| buffer |\n", "# A buffer\n| buffer |\n"),
        ("rebuffered, buffer-free", "rebuffered, buffer-free"),
        ("<!-- code x: buffer -->", "<!-- code x: buffer -->"),
    ],
)
def test_the_first_use_is_linked(text, after):
    assert linked(text, terms(GLOSSARY), "g.md") == after


def test_the_glossary_explains_what_the_pages_are_about():
    wanted = {"stroke", "backlash", "buffer", "describing function", "limit cycle", "lane", "shard", "substeps"}
    assert wanted <= set(terms((ROOT / "docs" / "glossary.md").read_text()))
