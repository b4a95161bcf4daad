"""`mdb ltm`: the long-term memory of a run on paper and on its way to another run.

A source is a run folder (its `memory.sqlite`) or a file that `export` wrote. Owns the file's form: a line with
the encoding, then the payload of a `messages.LongTermFile`. Models are named MODEL, all of a name, or MODEL/ID.
"""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec
import structlog

from mdb_protocol import codec, files
from mdb_protocol.errors import ConfigError, DamageError, DecodeError, MdbError
from mdb_protocol.messages import LongTermFile, LongTermModel
from mdb_protocol.words import shown
from mdb_services.experiment.run_folder import BEGINNING_FILE, EXPERIMENT_FILE, MEMORY_FILE
from mdb_services.mechanism.networks.network import Network
from mdb_services.memory.file import MemoryFile
from mdb_services.memory.model_memory import ModelMemory
from mdb_services.memory.reading import opened
from mdb_services.memory.rescue import survey
from mdb_sim.runs.experiment import Experiment

log = structlog.get_logger()

MOST_MODELS = 10_000
MOST_BYTES = codec.MAX_BYTES
"""Of a long-term memory that is read; the largest experiment keeps some hundred models."""
MOST_CELL = 200
"""Characters of a cell of a table."""
MOST_HEAD = 1024
"""Bytes of the line before the payload, and its end."""
SHOWN_PAIRS = 10
"""Pairs of a model's sample that `show` prints."""


def read(source: Path, names: Sequence[str] = ()) -> list[LongTermModel]:
    """Return the models of a source, those with the given names if any; MdbError when there are none."""
    models = _read_run(source) if source.is_dir() else _read_file(source)
    for model in models:
        try:
            Network.from_arrays(model.layers, model.weights)
        except ValueError as error:
            raise DamageError(f"model {model.model}/{model.id} of {source} is no network: {error}") from error
    if not names:
        return models
    for name in names:
        if not any(_is(model, name) for model in models):
            there = ", ".join(f"{model.model}/{model.id}" for model in models) or "none"
            raise MdbError(f"no model {name!r} in the long-term memory of {source}; there are {there}")
    return [model for model in models if any(_is(model, name) for name in names)]


def _is(model: LongTermModel, name: str) -> bool:
    return name in (model.model, f"{model.model}/{model.id}")


def _read_run(run: Path) -> list[LongTermModel]:
    path = run / MEMORY_FILE
    if not path.exists():
        raise MdbError(f"no {MEMORY_FILE} in {run}; give the folder that 'mdb up' named at its end")
    try:
        return _long_term(path)
    except DamageError as error:
        models = survey(path, Experiment.read(run / EXPERIMENT_FILE).brain).long_term
        if not models:
            raise
        log.warning("the memory file is damaged; these are the models that can be read", reason=str(error))
        return models


def _long_term(path: Path) -> list[LongTermModel]:
    encoding = codec.encoding_of(LongTermModel)
    try:
        with opened(path) as file:
            rows = file.rows("SELECT payload FROM long_term ORDER BY model, id LIMIT ?", MOST_MODELS + 1)
            found, left = list[LongTermModel](), MOST_BYTES
            for (payload,) in rows:
                left -= len(_bytes(payload))
                if left < 0 or len(found) == MOST_MODELS:
                    raise MdbError(
                        f"{path} has more models than are read: {MOST_MODELS}, {files.size(MOST_BYTES)} at the most"
                    )
                found.append(codec.decode(LongTermModel, payload, encoding))
            return found
    except (sqlite3.Error, DecodeError) as error:
        raise DamageError(f"{path} is not a memory of a brain, or is damaged: {error}") from error


def _bytes(payload: object) -> bytes:
    if not isinstance(payload, bytes):
        raise DecodeError(f"a model is {type(payload).__name__}; expected bytes")
    return payload


def _read_file(path: Path) -> list[LongTermModel]:
    try:
        encoding, _, payload = files.content(path, codec.MAX_BYTES + MOST_HEAD).partition(b"\n")
        return codec.decode(LongTermFile, payload, encoding.decode("ascii", "replace")).models
    except OSError as error:
        raise MdbError(
            f"cannot read {path}: {error.strerror}; give a run folder or a file of 'mdb ltm export'"
        ) from error
    except DecodeError as error:
        raise MdbError(f"{path} is not a file of 'mdb ltm export': {error}") from error


def export(source: Path, names: Sequence[str], out: Path) -> int:
    """Write models of a source to a file; return how many."""
    models = read(source, names)
    if not models:
        raise MdbError(f"the long-term memory of {source} is empty: nothing to export")
    payload = codec.encode(LongTermFile(models=models))
    if len(payload) > codec.MAX_BYTES:
        raise MdbError(
            f"{len(models)} models are too much for one file; name some: mdb ltm export {source} MODEL ..."
        )
    out.write_bytes(codec.encoding_of(LongTermFile).encode() + b"\n" + payload)
    return len(models)


def bring(source: Path, names: Sequence[str], run: Path) -> int:
    """Put models of a source into the long-term memory of a run that is not going on; return how many.

    Of a run that has not begun yet the memory is kept as it is then, so that it can be replayed.
    MdbError when the run's experiment has no such model, or one whose numbers mean something else.
    """
    models = read(source, names)
    try:
        experiment = Experiment.read(run / EXPERIMENT_FILE)
    except ConfigError as error:
        raise MdbError(f"{run} is not a run folder ('mdb prepare --run {run}' makes one): {error}") from error
    for model in models:
        _check_fits(model, experiment)
    with MemoryFile(run / MEMORY_FILE) as file:
        try:
            used = [(model.model, model.id) for model in file.long_term()]
        except (sqlite3.Error, DecodeError, TypeError) as error:
            raise file.unusable(error) from error
        brought = []
        for model in models:
            free = 1 + max((id for name, id in used if name == model.model), default=0)
            used.append((model.model, free))
            origin = f"{source.resolve()}: {model.model}/{model.id}"[-4096:]
            brought.append(msgspec.structs.replace(model, id=free, origin=origin, touched=0))
        file.keep_long_term(brought)
        begun = file.count() > 0
    if not begun:
        shutil.copyfile(run / MEMORY_FILE, run / BEGINNING_FILE)
    return len(models)


def _check_fits(model: LongTermModel, experiment: Experiment) -> None:
    _check_room(model, experiment)
    if not ModelMemory(experiment.brain, experiment.brain.model_named(model.model)).knows(model):
        raise MdbError(
            f"model {model.model}/{model.id} does not fit this experiment: its network of {model.layers} or its "
            f"{len(model.pairs)} pairs are not of what it reads"
        )


def _check_room(model: LongTermModel, experiment: Experiment) -> None:
    section = experiment.brain.model_named(model.model)
    own = experiment.brain.reads(section)
    differ = [
        f"{name} is {model.reads.get(name, 'absent')} there, {own.get(name, 'absent')} here"
        for name in sorted(own.keys() | model.reads.keys())
        if model.reads.get(name) != own.get(name)
    ]
    if differ or list(own) != list(model.reads):
        what = "; ".join(differ) or f"it reads {', '.join(model.reads)} in this order"
        raise MdbError(f"model {model.model}/{model.id} does not fit this experiment: {what}")
    hidden, whole = model.layers[1:-1], experiment.brain.reported_hidden(section)
    if hidden == whole:
        return
    if len(hidden) != len(section.hidden) or any(a > b for a, b in zip(hidden, section.hidden, strict=True)):
        committee = f", or as its {section.members} members together {whole}" if section.members > 1 else ""
        raise MdbError(
            f"model {model.model}/{model.id} has {hidden} hidden units; this experiment has room for "
            f"{list(section.hidden)}{committee}: --set model.{model.model}.hidden={hidden}, or what "
            f"'hidden' and 'members' were in {model.experiment}"
        )


def listing(models: Iterable[LongTermModel]) -> str:
    """Return a line for each model."""
    rows = [("model", "error", "uses", "pairs", "network", "stored at", "experiment", "origin")]
    for model in models:
        rows.append((
            f"{model.model}/{model.id}", f"{model.error:.4f}", f"{model.uses}", f"{len(model.pairs)}",
            "-".join(map(str, model.layers)), f"{model.iteration}",
            f"{shown(model.experiment, MOST_CELL)} seed {model.seed}", shown(model.origin or "this run", MOST_CELL),
        ))  # fmt: skip
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join("  ".join(f"{cell:<{w}}" for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)


def show(model: LongTermModel) -> str:
    """Return all that is known of a model: where it comes from, what it reads, a part of its sample."""
    lines = [listing([model]), "", "reads"]
    lines += [f"  {shown(name)}: {shown(meaning)}" for name, meaning in model.reads.items()]
    lines += ["", f"pairs of its context ({min(len(model.pairs), SHOWN_PAIRS)} of {len(model.pairs)})"]
    for pair in model.pairs[:SHOWN_PAIRS]:
        before = ", ".join(f"{name} {value:.3g}" for name, value in pair.before.items())
        after = ", ".join(f"{name} {value:.3g}" for name, value in pair.after.items())
        lines.append(
            f"  iteration {pair.iteration}: {before}; note {pair.note}; action {pair.action}; {after}; "
            f"feedback {pair.feedback}"
        )
    return "\n".join(lines)
