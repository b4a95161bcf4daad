"""The protocol's page stays true: its duties and its example are those of the code, its links lead somewhere."""

import re
from pathlib import Path

from mdb_protocol import keys
from mdb_protocol.codec import VERSION, encoding_of
from mdb_protocol.duties import DUTIES, SHOWN_AGAIN_S, table
from mdb_protocol.messages import VALUE_BOUND, Perception

ROOM = Path(__file__).parents[2] / "protocol"
PAGE = (ROOM / "README.md").read_text()


def test_the_duties_are_the_ones_of_the_code() -> None:
    assert table() in PAGE, "print them with `mdb keys duties` between the marks"
    assert [*DUTIES] == list(range(1, len(DUTIES) + 1))


def test_the_duties_name_what_the_code_holds() -> None:
    assert f"every {SHOWN_AGAIN_S:g} s" in DUTIES[4].text
    assert encoding_of(Perception).replace("Perception", "NAME") in DUTIES[2].text
    assert f"±{VALUE_BOUND:.0e}".replace("+0", "") in DUTIES[2].text
    assert f"`mdb={VERSION}`" in PAGE


def test_the_example_is_the_file_beside_it_and_needs_zenoh_and_msgpack_alone() -> None:
    example = (ROOM / "example_robot.py").read_text()
    assert f"```python\n{example}```" in PAGE
    imported = set(re.findall(r"^import (\w+)", example, re.MULTILINE))
    assert imported - {"json", "math", "queue", "random", "sys", "time", "uuid"} == {"zenoh", "msgpack"}
    assert "from " not in example


def test_the_keys_of_a_robot_are_rows_of_the_table() -> None:
    named = re.findall(r"^\| `([\w/]+)` \| (?:reads|writes|liveliness token) \|", PAGE, re.MULTILINE)
    assert len(named) == 5
    assert all(keys.find("pioneer", f"mdb/pioneer/{path}") for path in named)


def test_linked_files_are_there() -> None:
    for target in re.findall(r"\]\(([^)#:]+)(?:#\w+)?\)", PAGE):
        assert (ROOM / target).exists(), target
