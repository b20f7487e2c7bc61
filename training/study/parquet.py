"""Read and write tables as Parquet files, in the smallest types that keep their values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError
from cdcsr.files import write_bytes

if TYPE_CHECKING:
    import pyarrow as pa

Columns = dict[str, NDArray[np.generic]]
"""A table: columns of equal length by their names."""

DECIMALS = 5
"""Distances, in [m], and angles, in [rad], are rounded to this many decimals."""
_ROUNDED = ("distance", "tip_error", "base_position_error", "base_attitude_error")


def write_table(
    path: Path, parts: Iterable[Mapping[str, Sequence[object] | NDArray[np.generic]]]
) -> None:
    """Write the rows of several tables with the same columns as one Parquet file.

    Texts and levels get dictionaries, numbers the smallest fitting types.

    Raises:
        CdcsrError: the file cannot be written.
    """
    import pyarrow as pa

    parts = list(parts)
    if not parts:
        path.unlink(missing_ok=True)
        return
    columns = {
        name: np.concatenate([np.asarray(part[name]) for part in parts]) for name in parts[-1]
    }
    arrays = {name: _small(name, values) for name, values in columns.items()}
    sink = pa.BufferOutputStream()
    parquet = _parquet()
    parquet.write_table(pa.table(arrays), sink, compression="zstd", compression_level=19)
    write_bytes(path, sink.getvalue().to_pybytes())


def _small(name: str, values: NDArray[np.generic]) -> pa.Array:
    """Return a column in the smallest type that holds its values as they are to be kept."""
    import pyarrow as pa

    if values.dtype.kind == "U":
        return pa.array(values.tolist()).dictionary_encode()
    if values.dtype.kind == "f" and np.isnan(values).any():
        return pa.array(values, from_pandas=True)
    if name == "success":
        return pa.array(values.astype(bool))
    if name in _ROUNDED:
        return pa.array(values.astype(np.float32))
    whole = values.astype(np.int64)
    if (whole == values).all():
        return pa.array(whole.astype(np.min_scalar_type(int(whole.max(initial=0)))))
    return pa.array(values)


def read_table(path: Path, wanted: Iterable[str] = ()) -> Columns:
    """Return the columns of a Parquet file; no file, no columns.

    Raises:
        CdcsrError: the file is damaged, or lacks a column that is wanted.
    """
    if not path.is_file():
        return {}
    parquet = _parquet()
    import pyarrow as pa

    try:
        table = parquet.read_table(path)
        columns = {name: _plain(name, table[name].combine_chunks()) for name in table.column_names}
    except (OSError, pa.ArrowException) as error:
        line = next(iter(str(error).splitlines()), type(error).__name__)
        raise CdcsrError(f"{path} is damaged ({line}); restore it from git.") from None
    if missing := [name for name in wanted if name not in columns]:
        raise CdcsrError(f"{path} has no column {', '.join(missing)}; restore it from git.")
    return columns


def _plain(name: str, array: pa.Array) -> NDArray[np.generic]:
    import pyarrow as pa

    if isinstance(array, pa.DictionaryArray):
        words = np.array(array.dictionary.to_pylist(), dtype=np.str_)
        return words[array.indices.to_numpy(zero_copy_only=False)]
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
