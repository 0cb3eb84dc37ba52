"""A robot's card by its settings: what lies on it before the flight, and the image that is kept afterwards."""

from __future__ import annotations

from pathlib import Path

from host.protocol.errors import LocalError

from .card import Card
from .settings import CONFIGS, Usd

CONFIG_NAME = "config.txt"
CONFIG_BYTES_MAX = 1 << 20

STATE = [f"stateEstimate.{name}" for name in ("x", "y", "z", "vx", "vy", "vz", "qx", "qy", "qz", "qw")]
POSE = ["on:estPose", *(f"locSrv.{name}" for name in ("x", "y", "z", "qx", "qy", "qz", "qw"))]
BEACONS = ["on:beacon"]
FULL = [
    *STATE,
    *(f"stateEstimate.{name}" for name in ("roll", "pitch", "yaw")),
    *(f"{group}.{axis}" for group in ("gyro", "acc") for axis in "xyz"),
    "pm.vbat",
]
BUILT_IN = {
    "state": ["1", "16384", "log", "1", "on:fixedFrequency", "250", "1", *STATE, *POSE, *BEACONS],
    "full": ["1", "65535", "log", "1", "on:fixedFrequency", "1000", "1", *FULL, *POSE, *BEACONS],
}
"""Their names are in settings.CONFIGS, for the documentation."""
assert list(BUILT_IN) == list(CONFIGS)


def config_text(config: str) -> bytes:
    """Of a built-in name, or of a path."""
    if config in BUILT_IN:
        return "".join(f"{line}\n" for line in BUILT_IN[config]).encode()
    try:
        with Path(config).open("rb") as file:
            text = file.read(CONFIG_BYTES_MAX + 1)
    except OSError as error:
        raise LocalError(f"usd_config={config}: {error.strerror}; built in are {', '.join(BUILT_IN)}") from error
    if len(text) > CONFIG_BYTES_MAX:
        raise LocalError(f"usd_config={config}: this is no config.txt, it has more than {CONFIG_BYTES_MAX} bytes")
    return text


def card_of(usd: Usd, seed: int) -> Card:
    """A new card with config.txt on it."""
    text = config_text(usd.config)
    card = Card(
        usd.size_mb,
        seed=seed,
        free_mb=usd.free_mb or None,
        stall_ms=usd.stall_ms,
        stall_p99_ms=usd.stall_p99_ms,
        stall_max_ms=usd.stall_max_ms,
        bad=usd.bad,
        removed_ns=round(usd.remove_s * 1e9) if usd.remove_s else None,
    )
    card.put(CONFIG_NAME, text)
    return card


def image_path(usd: Usd, index: int, robots: int) -> Path | None:
    """Where the card's image is kept, if it is: each of several robots has its own. LocalError if it exists."""
    if not usd.image:
        return None
    path = Path(usd.image)
    if robots > 1:
        path = path.with_name(f"{path.stem}.{index}{path.suffix}")
    if path.exists():
        raise LocalError(f"usd_image: {path} exists and is not overwritten: name another file, or remove it")
    if not path.absolute().parent.is_dir():
        raise LocalError(f"usd_image: there is no folder {path.absolute().parent}")
    return path
