"""A run log as tables: pairs, iterations, models, contexts, scenes. Pure: from messages to columns.

A column has one value for each row, None where there is none. What is by name within a message becomes a column for
each name (`before.distance`), a vector one for each number (`before.sonar.0`). Of messages that came twice the first
counts, but feedback that came late is with its pair and its iteration. Networks are not in the tables: they are in
`RunRecord.models`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from mdb_protocol.errors import DamageError
from mdb_protocol.messages import ContextEvent, CurrentModel, Message, Pair
from mdb_services.recorder import Recorded
from mdb_sim.runs.record import RunRecord

Columns = dict[str, list[Any]]
Row = dict[str, Any]
SPARSE, SMALL = 20, 1_000_000
"""A table of more cells than `SPARSE` times its values and `SMALL` is not made: it is far larger than its log."""
TABLES = ("iterations", "pairs", "models", "contexts", "scenes")


def tables_of(record: RunRecord, log: Iterable[Recorded]) -> dict[str, Columns]:
    """Return the tables of `TABLES` of a run, by name; `log` are its messages, in order."""
    pairs: dict[int, Pair] = {}
    models: list[Row] = []
    contexts: list[Row] = []
    for recorded in log:
        match recorded.message:
            case Pair() as pair:
                known = pairs.get(pair.iteration)
                if known is None or (known.feedback is None and pair.feedback is not None):
                    pairs[pair.iteration] = pair
            case CurrentModel() as model:
                models.append(_model(model, recorded.time_s))
            case ContextEvent() as event:
                contexts.append(_row(event))
    return {
        "iterations": columns(_iterations(record)),
        "pairs": columns(_row(pairs[i]) for i in sorted(pairs)),
        "models": columns(models),
        "contexts": columns(contexts, ContextEvent.__struct_fields__),
        "scenes": columns(_row(record.scenes[i]) for i in sorted(record.scenes)),
    }


def columns(rows: Iterable[Row], first: Iterable[str] = ()) -> Columns:
    """Return rows as columns: those named first, then in the order in which names come; what a row lacks is None."""
    listed = list(rows)
    names = dict.fromkeys(first)
    for row in listed:
        names |= dict.fromkeys(row)
    values = sum(map(len, listed))
    if len(names) * len(listed) > SPARSE * values + SMALL:
        raise DamageError(
            f"a table of {len(names)} columns and {len(listed)} rows for {values} values: each message of this log "
            "has other names, so it is damaged, or of no run"
        )
    split = {name[:at] for name in names for at, letter in enumerate(name) if letter == "."}
    return {name: [row.get(name) for row in listed] for name in names if name not in split}


def _iterations(record: RunRecord) -> Iterator[Row]:
    for i, report in sorted(record.reports.items()):
        timing, span = record.timings.get(i), record.span_at(i)
        yield {
            **_row(report),
            "phase": span.name if span is not None else None,
            "successes": int(record.successes[i + 1]),
            "perception_to_action_s": timing.perception_to_action_s if timing is not None else None,
            "cycle_s": timing.cycle_s if timing is not None else None,
        }


def _model(model: CurrentModel, time_s: float) -> Row:
    return {
        "time_s": time_s,
        "model": model.model,
        "version": model.version,
        "generation": model.generation,
        "layers": "-".join(map(str, model.layers)),
        "error": model.error,
        "pairs": None if model.support is None else len(model.support),
    }


def _row(message: Message) -> Row:
    return dict(_flat((name, getattr(message, name)) for name in message.__struct_fields__))


def _flat(items: Iterable[tuple[str, Any]]) -> Iterator[tuple[str, Any]]:
    for name, value in items:
        if isinstance(value, Mapping):
            yield from _flat((f"{name}.{key}", part) for key, part in value.items())
        elif isinstance(value, list) and all(isinstance(part, str) for part in value):
            yield name, " ".join(value) or None
        elif isinstance(value, list):
            yield from ((f"{name}.{place}", part) for place, part in enumerate(value))
        else:
            yield name, value
