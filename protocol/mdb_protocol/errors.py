"""The errors of the project: each says what was wrong, what was expected, and how to mend it."""


class MdbError(Exception):
    """Base of every error that a user can meet; its text is one readable sentence or two."""


class ConfigError(MdbError):
    """An experiment file, an override or an option that cannot be used."""


class DecodeError(MdbError):
    """Bytes on a key that are not the message this key carries."""


class DamageError(MdbError):
    """A file that is not, or no longer, what it should be."""


class BusError(MdbError):
    """The bus cannot do what was asked: no router, a port in use, a closed session."""


class TakenError(BusError):
    """A service of a brain's name that lives already."""


UNHEARD = 75
"""Exit status of a service ended by UnheardError (EX_TEMPFAIL of sysexits.h); the runner replaces the router."""


class UnheardError(BusError):
    """The router is connected, and gives us nothing any more; it is to be replaced."""


class QueryError(MdbError):
    """A query that got no usable answer within its time."""
