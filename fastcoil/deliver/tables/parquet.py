"""Parquet: plain names, units and meanings in the fields' metadata, the study in that of the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fastcoil.base.errors import missing_extra
from fastcoil.base.files import commit_written
from fastcoil.deliver.tables.tidy import Tidy, facts_of

_MORE = ("parameters", "study_toml")
"""Attributes of a result, too long for other formats."""


def write_parquet(table: Tidy, path: Path) -> None:
    """Write a table as Parquet; words are categories.

    Raises
    ------
    InputError
        If pyarrow is not installed.
    StorageError
        If it cannot be written; nothing half-written is left behind.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise missing_extra("Parquet", "pyarrow", "parquet") from None

    more = {name: str(table.ds.attrs[name]) for name in _MORE if name in table.ds.attrs}

    def write(unfinished: Path) -> None:
        writer: Any = None
        try:
            for piece in table.pieces():
                if writer is None:
                    schema = _described(pa.Schema.from_pandas(piece, preserve_index=False), table)
                    schema = schema.with_metadata({**(schema.metadata or {}), **facts_of(table.ds), **more})
                    writer = parquet.ParquetWriter(unfinished, schema)
                writer.write_table(pa.Table.from_pandas(piece, schema, preserve_index=False))
        finally:
            if writer is not None:
                writer.close()

    commit_written(path, write)


def _described(schema: Any, table: Tidy) -> Any:
    """The schema with units and meanings of its fields."""
    for k, column in enumerate(table.columns):
        known = {"units": column.unit, "long_name": column.meaning}
        schema = schema.set(k, schema.field(k).with_metadata({name: text for name, text in known.items() if text}))
    return schema
