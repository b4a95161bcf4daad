"""Results of a study on disk: one small Parquet file a run, a row a phase. Needs pyarrow (extra `study`).

Owns the format: `STUDY/VARIANT/seed7-BODY.parquet` below the results folder. A file is written whole under
another name and then renamed, so what is there is complete. Its schema's metadata tells which experiment and
which code it is of, so that a sweep can be gone on with.
"""

from __future__ import annotations

import json
import resource
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdb_protocol import files
from mdb_protocol.errors import DamageError, MdbError
from mdb_protocol.files import size
from mdb_services.shell.whole_file import write_whole
from mdb_sim.runs.films import Film
from mdb_sim.studies.rows import CURVES, PhaseRow

if TYPE_CHECKING:
    import pyarrow as pa

METADATA = b"mdb"
"""Key of our metadata in the schema's."""
ENDING = ".parquet"
MOST_BYTES = 64 * 2**20
"""Of a result's file, and of what it says that it unpacks to; those of the longest study have 1 MB."""
MOST_ROOM = 160 * 2**20
"""Memory that reading one may take, whatever the file says of itself."""
MOST_PHASES = 100_000


@dataclass(frozen=True, kw_only=True)
class Label:
    """Which run a file holds, and of what it was made."""

    study: str
    variant: str
    order: int
    """The variant's place in its study's table."""
    seed: int
    body: str
    fingerprint: str
    """Of the resolved experiment, the player and the code; see `running.fingerprint`."""
    code: str
    """Of the code alone."""
    overrides: tuple[str, ...] = ()
    """What the variant changes, as `--set` takes it."""
    seconds: float = 0.0
    """What the run took."""

    @property
    def path(self) -> Path:
        """Where it lies below the results folder."""
        body = "".join(letter if letter.isalnum() else "-" for letter in self.body)
        return Path(self.study) / word(self.variant) / f"seed{self.seed}-{body}{ENDING}"


@dataclass(frozen=True, eq=False)
class Result:
    """One run's file, read."""

    label: Label
    rows: tuple[PhaseRow, ...]


def word(name: str) -> str:
    """Return a name as one word of a path."""
    letters = "".join(letter if letter.isalnum() or letter in ".+" else "-" for letter in name.lower())
    return "-".join(part for part in letters.split("-") if part)


def need_pyarrow() -> None:
    """Raise MdbError when pyarrow is missing: to be called before hours of runs, not after."""
    try:
        import pyarrow.parquet  # noqa: F401 - an extra
    except ImportError as error:
        raise MdbError(
            "studies are kept in Parquet, which needs pyarrow; run pip install 'multilevel-darwinist-brain[study]'"
        ) from error


def encode(label: Label, rows: Sequence[PhaseRow]) -> bytes:
    """Return the whole file of a run."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = [field.name for field in fields(PhaseRow)]
    columns: dict[str, list[Any]] = {
        "study": [label.study] * len(rows),
        "variant": [label.variant] * len(rows),
        **{name: [_plain(getattr(row, name)) for row in rows] for name in names},
    }
    table = pa.table(columns, schema=_schema(label))
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    return bytes(sink.getvalue())


def decode(data: bytes) -> Result:
    """Return what a file's bytes hold; ValueError when that is more than any run's."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with _in_room(), pq.ParquetFile(pa.BufferReader(data)) as file:
        said = file.metadata
        unpacked = sum(said.row_group(number).total_byte_size for number in range(said.num_row_groups))
        if not 0 < said.num_rows <= MOST_PHASES or unpacked > MOST_BYTES:
            raise ValueError(f"{said.num_rows} phases in {size(unpacked)}: no run has that many")
        return _result(file.read(use_threads=False))


@contextmanager
def _in_room() -> Iterator[None]:
    """Let nothing within take more than `MOST_ROOM`: ValueError instead. A page that unpacks to a gigabyte need not
    say so before.
    """
    before = resource.getrlimit(resource.RLIMIT_DATA)
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5])
    except OSError:  # no Linux: without a bound
        yield
        return
    most = pages * resource.getpagesize() + MOST_ROOM
    bounds = [bound for bound in before if bound != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_DATA, (min([most, *bounds]), before[1]))
    try:
        yield
    except MemoryError as error:
        raise ValueError(f"reading it takes more than {size(MOST_ROOM)}") from error
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def relabelled(data: bytes, label: Label) -> bytes:
    """Return the same run as another study's: the same experiment need not be run twice."""
    result = decode(data)
    return encode(replace(label, seconds=result.label.seconds), result.rows)


def write(folder: Path, data: bytes, label: Label) -> Path:
    """Write a run's file, whole or not at all."""
    path = folder / label.path
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, data)
    return path


def labels(folder: Path) -> Iterator[tuple[Path, Label]]:
    """Yield what lies in a results folder, by name; a file that is none of ours is passed over."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    for path in sorted(folder.glob(f"*/*/*{ENDING}")):
        try:
            with files.opened(path, MOST_BYTES) as file:
                label = _label(pq.read_schema(file))
        except (pa.ArrowException, DamageError, OSError, KeyError, ValueError, TypeError, OverflowError):
            continue
        yield path, label


def content(path: Path) -> bytes:
    """Return the bytes of a result's file; DamageError when it is none."""
    return files.content(path, MOST_BYTES)


def read(folder: Path, study: str | None = None) -> list[Result]:
    """Return all results of a folder, of one study or of all, by study, variant and seed."""
    found = [path for path, label in labels(folder) if study in (None, label.study)]
    results = [decode(content(path)) for path in found]
    return sorted(results, key=lambda r: (r.label.study, r.label.order, r.label.variant, r.label.body, r.label.seed))


def _plain(value: Any) -> Any:
    """Return what Parquet takes of a row's value: pairs of a mapping, films as bytes, all else as it is."""
    if isinstance(value, Mapping):
        return list(value.items())
    if isinstance(value, tuple):
        return [msgspec.msgpack.encode(part) if isinstance(part, Film) else part for part in value]
    return value


def _schema(label: Label) -> pa.Schema:
    import pyarrow as pa

    kinds = {
        "int": pa.int32(),
        "float": pa.float64(),
        "str": pa.string(),
        "str | None": pa.string(),
        "Marks": pa.list_(pa.int8()),
        "Curve": pa.list_(pa.float32()),
        "Counts": pa.list_(pa.int32()),
        "tuple[Curve, ...]": pa.list_(pa.list_(pa.float32())),
        "Mapping[str, Curve]": pa.map_(pa.string(), pa.list_(pa.float32())),
        "tuple[Film, ...]": pa.list_(pa.binary()),
    }
    columns = [("study", pa.string()), ("variant", pa.string())]
    columns += [(field.name, kinds[str(field.type)]) for field in fields(PhaseRow)]
    columns = [(name, pa.uint64() if name == "seed" else kind) for name, kind in columns]
    return pa.schema(columns, metadata={METADATA: json.dumps(asdict(label)).encode()})


def _label(schema: pa.Schema) -> Label:
    content = json.loads((schema.metadata or {})[METADATA])
    return Label(**(content | {"overrides": tuple(content["overrides"])}))


def _result(table: pa.Table) -> Result:
    there = [name for name in CURVES if name in table.schema.names]
    types = {name: np.dtype(_numpy_name(table.schema.field(name).type)) for name in there}
    return Result(_label(table.schema), tuple(_rows(table.to_pylist(), types)))


def _numpy_name(kind: pa.ListType) -> str:
    return "float32" if str(kind.value_type) == "float" else str(kind.value_type)


def _rows(content: Iterable[dict[str, Any]], types: dict[str, Any]) -> Iterator[PhaseRow]:
    for row in content:
        for name in ("study", "variant"):
            del row[name]
        for name, kind in types.items():
            row[name] = np.array(row[name], dtype=kind)
        row["paths"] = tuple(np.array(path, dtype=np.float32) for path in row["paths"])
        row["errors"] = {name: np.array(errors, np.float32) for name, errors in row.get("errors", ())}
        row["films"] = tuple(msgspec.msgpack.decode(film, type=Film) for film in row.get("films", ()))
        yield PhaseRow(**row)
