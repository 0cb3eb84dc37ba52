"""Two kinds of blame, one exception each; anything else that comes out of a parser is a bug of ours."""


class SpindeckError(Exception):
    """Base of both: `except SpindeckError` catches whatever a user can be told about."""


class LocalError(SpindeckError):
    """You: a wrong argument, an unknown scenario key, a port that cannot be opened. Says what to do."""


class NotThereError(LocalError):
    """A port that nobody answers at, or a device that is not plugged in: it may come to be there later."""


class PeerError(SpindeckError):
    """The other side: bytes that do not mean what they should, a robot that does not answer."""


class PeerSilentError(PeerError):
    """It, or a part of it, said nothing for so long that waiting on makes no sense."""


class ConnectionLostError(PeerError):
    """The connection ended before what was wanted had come."""
