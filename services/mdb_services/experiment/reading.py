"""How an experiment file is read: TOML, then overrides (`--set evolution.population=400`), then checked.

Owns the words in which a mistake is told. Knows no section.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from msgspec import inspect

from mdb_protocol import converting, files
from mdb_protocol.errors import ConfigError, DamageError
from mdb_protocol.words import close_to

T = TypeVar("T")
UNLISTED = re.compile(r"Invalid enum value '(.*)' - at `\$(.*)`", re.DOTALL)
"""What msgspec says of a word that is none of a list: the word, and where."""
UNKNOWN = re.compile(r"Object contains unknown field `(.*?)`(?: - at `\$(.*)`)?", re.DOTALL)
"""What msgspec says of a name that is none of a section's: the name, and where."""

MOST_BYTES = 2**20
"""Of an experiment file; those that are shipped have 3 to 9 kB."""
MOST_NAMES = 100
"""In one key, as in a.b.c."""


def read_file(path: Path, overrides: Iterable[str] = ()) -> dict[str, Any]:
    """Return the plain content of an experiment file with `NAME.NAME=VALUE` overrides applied.

    A model's, mode's or phase's name picks it from its list: `model.object.evolution.population=400`.
    Raises ConfigError when the file cannot be read or an override cannot be applied.
    """
    try:
        content = _parsed(files.content(path, MOST_BYTES).decode("utf-8-sig"))
    except OSError as error:
        raise ConfigError(f"cannot read the experiment file {path}: {error.strerror}") from error
    except DamageError as error:
        raise ConfigError(f"{error}: an experiment in TOML") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path} is not text in UTF-8 ({error}); save it as UTF-8") from error
    except (ValueError, RecursionError) as error:  # also numbers and nests that Python has no room for
        raise ConfigError(f"{path} is not valid TOML: {error}") from error
    for override in overrides:
        _override(content, override)
    return content


def _parsed(text: str) -> dict[str, Any]:
    """Return what TOML holds; ValueError when it is none, or has a key that takes the parser minutes (n² names)."""
    for piece in text.split("="):
        key = re.split(r"[,{\n]", piece)[-1]
        heads = (line for line in piece.splitlines() if line.lstrip().startswith("["))
        if max(part.count(".") for part in (key, *heads)) > MOST_NAMES:
            raise ValueError(f"a key of more than {MOST_NAMES} names")
    if "\0" in text:
        raise ValueError("it has bytes 0, as text in UTF-16 has; save it as UTF-8")
    return tomllib.loads(text)


def convert(section: Mapping[str, Any], cls: type[T], source: object) -> T:
    """Return the checked section; ConfigError names the source and the path of what is wrong."""
    try:
        return converting.convert(section, cls)
    except (msgspec.ValidationError, ValueError) as error:
        raise ConfigError(f"{source}: {error}{_choices(cls, str(error))}") from error


def make(cls: type[T], fields: Mapping[str, Any], what: str) -> T:
    """Return a dataclass of the mechanism from plain fields; ConfigError on unknown names or bad values."""
    known = cls.__dataclass_fields__  # type: ignore[attr-defined]
    for name in fields:
        if name not in known:
            raise ConfigError(f"{what}: unknown setting {name!r}{nearest(name, known)}")
    try:
        return converting.convert(dict(fields), cls)
    except (msgspec.ValidationError, ValueError) as error:
        raise ConfigError(f"{what}: {error}") from error


def _override(content: dict[str, Any], override: str) -> None:
    path, equals, text = override.partition("=")
    names = path.strip().split(".")
    if not equals or not all(names):
        raise ConfigError(f"--set {override!r}: expected SECTION.NAME=VALUE, as in evolution.population=400")
    try:
        value = _parsed(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        value = text.strip()
    place: Any = content
    for i, name in enumerate(names[:-1]):
        place = place.setdefault(name, {}) if isinstance(place, dict) else _by_name(place, name, override)
        here = ".".join(names[: i + 1])
        if not isinstance(place, dict | list):
            raise ConfigError(f"--set {override!r}: {here} is a value, not a section")
        if isinstance(place, list) and not all(isinstance(entry, dict) for entry in place):
            raise ConfigError(f"--set {override!r}: {here} is a list of values, not of named entries; give it whole")
    if not isinstance(place, dict):
        raise ConfigError(f"--set {override!r}: name the entry, as in model.object.hidden=[12]")
    place[names[-1]] = value


def _by_name(entries: list[Any], name: str, override: str) -> Any:
    for entry in entries:
        if entry.get("name") == name:
            return entry
    names = [str(entry.get("name")) for entry in entries]
    close = close_to(name, names)
    hint = f"; did you mean {close!r}?" if close else ""
    raise ConfigError(f"--set {override!r}: no entry named {name!r}; there are {', '.join(names)}{hint}")


def _choices(cls: type[Any], said: str) -> str:
    """Return what to add to msgspec's word that a value or a name is none of those that there are."""
    found = UNLISTED.fullmatch(said) or UNKNOWN.fullmatch(said)
    if found is None:
        return ""
    kinds = [inspect.type_info(cls)]
    for name in re.findall(r"[^\W\d]\w*|\[", found[2] or ""):  # as in `.model[1].hidden`, `.feature[...]`
        kinds = [inner for kind in kinds for inner in _within(kind, name)]
    parts = [part for kind in kinds for part in _parts(kind)]
    if found.re is UNKNOWN:
        values = [field.encode_name for part in parts for field in getattr(part, "fields", ())]
    else:
        values = [str(value) for part in parts for value in getattr(part, "values", ())]
    return nearest(found[1], values) if values else ""


def _parts(kind: inspect.Type) -> tuple[inspect.Type, ...]:
    return kind.types if isinstance(kind, inspect.UnionType) else (kind,)


def _within(kind: inspect.Type, name: str) -> list[inspect.Type]:
    """Return of what kinds a field is, or an element (`name` is then a bracket)."""
    found: list[inspect.Type] = []
    for part in _parts(kind):
        if isinstance(part, inspect.StructType):
            found += [field.type for field in part.fields if field.encode_name == name]
        elif isinstance(part, inspect.DictType):
            found.append(part.value_type)
        elif isinstance(part, inspect.VarTupleType | inspect.ListType) and name == "[":
            found.append(part.item_type)
    return found


def nearest(name: str, known: Iterable[str]) -> str:
    """Return what to add to an error about a name that is not known: the nearest one, or all that there are."""
    names = sorted(known)
    close = close_to(name, names)
    return f"; did you mean {close!r}?" if close else f"; there are {', '.join(names)}"
