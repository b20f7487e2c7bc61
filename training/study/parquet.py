"""Read and write tables as Parquet files, in the smallest types that keep their values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.files import finish_together
from cdcsr.reading import MOST_TABLE, exists, read_bytes, read_text

if TYPE_CHECKING:
    import pyarrow as pa

Columns = dict[str, NDArray[np.generic]]
"""A table: columns of equal length by their names."""
_MOST_CELLS = 200_000_000
SUMS = "SHA256SUMS"
"""This file has a checksum of each other file of a store; `sha256sum -c SHA256SUMS` reads it."""

DECIMALS = 5
"""Distances, in [m], and angles, in [rad], are rounded to this many decimals."""
_ROUNDED = ("distance", "tip_error", "base_position_error", "base_attitude_error")
_DIGITS = 9
"""Rounded values are stored as decimal numbers of so many digits, if they fit: in four bytes."""


def table_bytes(
    parts: Iterable[Mapping[str, Sequence[object] | NDArray[np.generic]]],
) -> bytes | None:
    """Return the rows of several tables with the same columns as one Parquet file.

    Texts are read back as dictionaries, numbers get the smallest fitting types. No tables make no
    file. Dictionaries of Parquet's own would make the files a quarter larger, and rounded and whole
    numbers whose bytes are not split into streams a quarter too.
    """
    import pyarrow as pa

    parts = list(parts)
    if not parts:
        return None
    columns = {
        name: np.concatenate([np.asarray(part[name]) for part in parts]) for name in parts[-1]
    }
    arrays = {name: _small(name, values) for name, values in columns.items()}
    sink = pa.BufferOutputStream()
    parquet = _parquet()
    split = [
        name
        for name, array in arrays.items()
        if pa.types.is_integer(array.type) or pa.types.is_decimal(array.type)
    ]
    parquet.write_table(
        pa.table(arrays),
        sink,
        use_dictionary=False,
        compression="zstd",
        compression_level=19,
        column_encoding=dict.fromkeys(split, "BYTE_STREAM_SPLIT"),
        store_decimal_as_integer=True,
    )
    return sink.getvalue().to_pybytes()


def _small(name: str, values: NDArray[np.generic]) -> pa.Array:
    """Return a column in the smallest type that holds its values as they are to be kept."""
    import pyarrow as pa

    if values.dtype.kind == "U":
        return pa.array(values.tolist()).dictionary_encode()
    if values.dtype.kind == "f" and np.isnan(values).any():
        return pa.array(values, from_pandas=True)
    if name == "success":
        return pa.array(values.astype(bool))
    if name in _ROUNDED and (np.abs(values) < 10 ** (_DIGITS - DECIMALS)).all():
        units = np.rint(values.astype(float) * 10**DECIMALS).astype(np.int32)
        return pa.array(units).view(pa.decimal32(_DIGITS, DECIMALS))
    whole = values.astype(np.int64)
    if (whole == values).all():
        return pa.array(whole.astype(np.min_scalar_type(int(whole.max(initial=0)))))
    return pa.array(values)


def read_table(path: Path, wanted: Iterable[str] = ()) -> Columns:
    """Return the columns of a Parquet file; no file, no columns.

    Raises:
        CdcsrError: the file is damaged, or lacks a column that is wanted.
    """
    finish_together(path.parent)
    if not exists(path) and not is_summed(path):
        return {}
    data = read_summed(path)
    parquet = _parquet()
    import pyarrow as pa

    try:
        file = parquet.ParquetFile(pa.BufferReader(data))
        about = file.metadata
        if about.num_rows * about.num_columns > _MOST_CELLS:
            raise ValueError(f"{about.num_rows:,} rows are more than is allowed")
        table = file.read()
        columns = {name: _plain(name, table[name].combine_chunks()) for name in table.column_names}
    # A damaged file of an older version, without checksums, fails in many ways.
    except Exception as error:
        line = next(iter(str(error).splitlines()), type(error).__name__)
        raise CdcsrError(f"{path} is damaged ({line}); restore it from git.") from None
    if missing := [name for name in wanted if name not in columns]:
        raise CdcsrError(f"{path} has no column {', '.join(missing)}; restore it from git.")
    return columns


def sums(files: Mapping[str, bytes]) -> bytes:
    """Return the content of :data:`SUMS` for files by name."""
    lines = [f"{sha256(files[name]).hexdigest()}  {name}\n" for name in sorted(files)]
    return "".join(lines).encode()


def is_summed(path: Path) -> bool:
    """Return whether the store of a file has a checksum of it."""
    return path.name in (_read_sums(path) or {})


def read_summed(path: Path) -> bytes:
    """Return the content of a file of a store; stores of older versions have no checksums.

    Raises:
        CdcsrError: it cannot be read, or has not its checksum.
    """
    data, expected = read_bytes(path, MOST_TABLE), _read_sums(path)
    if expected is not None and expected.get(path.name) != sha256(data).hexdigest():
        raise CdcsrError(
            f"{path} is damaged: it has not its checksum in {SUMS}; restore both from git, or, if "
            f"you changed it on purpose, run `sha256sum *.parquet *.jsonl > {SUMS}` there."
        )
    return data


def _read_sums(path: Path) -> dict[str, str] | None:
    """Return the checksums of the store that a file is in, or None if it has none."""
    file = path.with_name(SUMS)
    if not exists(file):
        return None
    lines = [line.split(maxsplit=1) for line in read_text(file, "table of checksums").splitlines()]
    return {line[1]: line[0] for line in lines if len(line) == 2}


def _plain(name: str, array: pa.Array) -> NDArray[np.generic]:
    import pyarrow as pa

    if isinstance(array, pa.DictionaryArray):
        words = np.array(array.dictionary.to_pylist(), dtype=np.str_)
        return words[array.indices.to_numpy(zero_copy_only=False)]
    if pa.types.is_decimal(array.type):
        array = array.cast(pa.float64())
    values = array.to_numpy(zero_copy_only=False)
    return np.round(values.astype(float), DECIMALS) if name in _ROUNDED else values


def _parquet() -> ModuleType:
    try:
        import pyarrow.parquet as parquet
    except ModuleNotFoundError:
        raise CdcsrError(
            "pyarrow is not installed; install it with pip install 'cdcsr[study]'."
        ) from None
    return parquet
