import subprocess
import sys

import numpy as np
import pytest

from mdb_services.mechanism.networks import streams


def test_same_arguments_give_the_same_numbers() -> None:
    first = streams.generator(7, "optimizer", 12).random(5)
    assert np.array_equal(first, streams.generator(7, "optimizer", 12).random(5))


@pytest.mark.parametrize("other", [(8, "optimizer", 12), (7, "teacher", 12), (7, "optimizer", 13)])
def test_any_other_argument_gives_other_numbers(other: tuple[int, str, int]) -> None:
    first = streams.generator(7, "optimizer", 12).random(5)
    assert not np.isin(streams.generator(*other).random(5), first).any()


def test_key_is_the_same_in_another_process() -> None:
    code = "from mdb_services.mechanism.networks.streams import key; print(key(3, 'x'))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert int(said) == streams.key(3, "x")
    assert 0 <= int(said) < 2**64


def test_negative_counter_is_refused() -> None:
    with pytest.raises(ValueError, match="count steps from zero"):
        streams.generator(1, "x", -1)


@pytest.mark.parametrize("key", [(0, 0), (2**64 - 5, 77)])
def test_a_generator_is_numpys_of_that_key_and_counter(key: tuple[int, int]) -> None:
    counter = np.array([0, 3, 9, 2**63], np.uint64)
    numpys = np.random.Generator(np.random.Philox(key=key[0] + (key[1] << 64), counter=counter))
    assert np.array_equal(streams.philox(key, (0, 3, 9, 2**63)).random(9), numpys.random(9))
