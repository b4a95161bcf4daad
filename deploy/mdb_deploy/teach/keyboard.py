"""Which key says what."""

NOTE_KEYS = "zxcvbnmasdfg"
"""The key of each note: the lower row as on a piano, then the middle row."""
DIGITS = "0123456789"
FULL = {"+": 1.0, "=": 1.0, "-": -1.0}
"""Full reward and punishment; = is + without shift."""
HELP = (
    ("0-9+-", "judge"), ("space", "silent"), ("w", "wait"), ("p", "pause"), ("l", "notes"), ("h", "hint"),
    ("u", "rotate"), ("q", "leave"),
)  # fmt: skip


def graded(digit: int) -> float:
    """Return the feedback that a digit stands for: 0 is -1, 9 is +1, each step 2/9."""
    return 2 * digit / 9 - 1
