"""The compiled C: `ffi`, `lib`, and `check`, which says what to do when it is not built.

Nothing else of the host imports the compiled module directly.
"""

try:
    from ._native import ffi, lib
except ImportError as error:  # pragma: no cover - only in a broken installation
    raise ImportError(
        "spindeck's compiled module is missing or was built for another Python. "
        "In a checkout: run 'make'. Installed: 'pip install --force-reinstall spindeck'."
    ) from error

from ..protocol.errors import PeerError

ERROR_TEXT = {
    lib.ERR_SHORT: "too short",
    lib.ERR_START: "does not start as this message does",
    lib.ERR_LENGTH: "length out of range",
    lib.ERR_CHECK: "checksum does not match",
    lib.ERR_VALUE: "a field is out of range",
}


def check(result: int, what: str) -> int:
    """`result` of a decoder, or PeerError with what was wrong if it is negative."""
    if result < 0:
        raise PeerError(f"{what}: {ERROR_TEXT.get(result, f'error {result}')}")
    return result


__all__ = ["check", "ffi", "lib"]
