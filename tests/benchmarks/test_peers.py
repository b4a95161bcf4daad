"""Evolution here against public libraries: one run, on one core and on two, tables and a plot in runs/benchmarks.

Needs the `bench` extra (`pip install -e '.[bench]'`); a library that is missing is left out and named.
Run by name: `mdb test -m slow tests/benchmarks/test_peers.py -s`
"""

import json
import os
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from mdb_services.mechanism.evolution.layout import TANH_ERROR
from tests.benchmarks.peers import match
from tests.benchmarks.peers.contestant import ENTRIES
from tests.benchmarks.peers.match import Match
from tests.benchmarks.peers.problem import HIDDEN, first_population, oracle, recorded

FOLDER = match.ROOT / "runs" / "benchmarks"


@pytest.fixture(scope="module")
def contest() -> Iterator[Match]:
    contest = Match([max(os.sched_getaffinity(0))])
    yield contest
    contest.close()


@pytest.mark.slow
@pytest.mark.parametrize("network", HIDDEN)
@pytest.mark.parametrize("name", ENTRIES)
def test_every_contestant_measures_the_same_error(contest: Match, name: str, network: str) -> None:
    if name not in contest.names:
        pytest.skip(f"{ENTRIES[name].library} is not installed: pip install -e '.[bench]'")
    genomes = 73  # no multiple of any chunk
    expected = oracle(recorded(network), first_population(recorded(network), genomes, 0))
    found = contest.ask(name, "errors", network=network, genomes=genomes)
    np.testing.assert_allclose(np.sqrt(found), np.sqrt(expected), atol=2 * TANH_ERROR)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_contestants_side_by_side(contest: Match, capsys: pytest.CaptureFixture[str]) -> None:
    from tests.benchmarks.peers.plot import draw
    from tests.benchmarks.peers.report import markdown

    results = contest.measure()
    with closing(Match(sorted(os.sched_getaffinity(0))[-2:])) as wider:
        results["wider"] = wider.generations()
    text = markdown(results)
    FOLDER.mkdir(parents=True, exist_ok=True)
    (FOLDER / "peers.json").write_text(json.dumps(results))
    (FOLDER / "peers.md").write_text(text)
    draw(results, FOLDER / "peers.png")
    with capsys.disabled():
        os.write(1, f"\n{text}\n{FOLDER}/peers.md, peers.png, peers.json\n".encode())
    assert all(entry.label in text for entry in ENTRIES.values())
    assert (FOLDER / "peers.png").stat().st_size > 10_000
