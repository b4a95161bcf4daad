"""What models read of an action-perception pair."""

from mdb_protocol import messages
from mdb_services.mechanism.feedback.praise import worth
from mdb_services.mechanism.networks.encoding import Facts, gather


def facts_of(pair: messages.Pair) -> Facts:
    """Return the facts of a pair, each of shape (1,); praise is measured by the best of late."""
    feedback = pair.feedback
    if feedback is not None and pair.best is not None:
        feedback = worth(feedback, pair.best)
    return gather(
        before=pair.before,
        after=pair.after,
        note=pair.note,
        action=pair.action,
        choice=pair.choice,
        feedback=feedback,
    )
