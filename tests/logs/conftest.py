"""What several tests of logs share."""

import pytest
from helpers.exports import HEADER, WANTED, save_text, table_text

from fastcoil.logs import ReadingOptions, read_checked_log


@pytest.fixture
def read_export(tmp_path):
    """Return a function that reads cells or a text, as a building system writes them, as a log."""

    def read(content, header=HEADER, *, encoding="utf-8", separator=",", before="", after="", **options):
        text = content if isinstance(content, str) else table_text(content, header, separator, before, after)
        path = save_text(tmp_path, text, encoding)
        return read_checked_log(path, WANTED, ReadingOptions(reader="read_log", **options))

    return read
