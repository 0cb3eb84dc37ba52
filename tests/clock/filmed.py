"""A recording of what a simulated robot saw while it was turned, and its gyro's log: files for `host sync camera`.

A world's pictures have to be there before it runs, and when they are taken is known afterwards: so it runs twice. Equal
seeds take pictures at equal times, whatever is on them, as long as they are raw.
"""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

import host
from host.cli import main
from sim.panorama import HALF, Optics, panorama
from sim.row_log import FIXED, Block, row_log
from sim.turned_camera import Flight, Gyro, Motion, flight


@dataclass(frozen=True)
class Filmed:
    recording: str
    log: str
    flight: Flight
    """In true time: its stamps are when frames really ended."""


def filmed(folder: Path, seed: int, motion: Motion, *, seconds: float = 6.0, fps: float = 12.0,
           optics: Optics = HALF, scenario: str = "hover", keys: str = "", gyro: Gyro | None = None,
           own_world: bool = False) -> Filmed:  # fmt: skip
    """`keys`: of the scenario. `own_world`: made from the seed; else all see the same."""
    lines = round(optics.exposure_s / optics.line_s)
    optics = dataclasses.replace(optics, exposure_s=lines * optics.line_s)
    url = (
        f"sim://{scenario}?pace=max&seed={seed}&camera_fps={fps:g}&camera_exposure_lines={lines}"
        f"&camera_line_time_ns={round(optics.line_s * 1e9)}&camera_jitter_us=0{keys}"
    )
    with host.open(f"{url}&camera_width={optics.width}&camera_height={optics.height}") as stream:
        for frame in stream:
            if frame.arrival_host_ns > (seconds + 0.5) * 1e9:
                break
        truth = stream.port.world.truth
    made = flight(seed, motion, seconds=seconds + 1, optics=optics, gyro=gyro,
                  world=None if own_world else panorama(1, 3 * optics.height // 2))  # fmt: skip
    made = dataclasses.replace(made, stamp_s=truth["true_ns"] * 1e-9, offset_s=0.0)
    pictures = folder / "pictures"
    pictures.mkdir()
    for index in range(len(truth)):
        Image.fromarray(made.frame(index)).save(pictures / f"{index:05}.pgm")
    recording = str(folder / "turned.mcap")
    words = ["--camera", str(pictures), "--duration", f"{seconds:g}", "--record", recording, "--json"]
    assert main(["stream", "--port", url, *words]) == 0
    line = np.polyfit(truth["true_ns"] * 1e-9, truth["stm32_stamp_ns"] * 1e-3, 1)
    log = folder / "log00"
    log.write_bytes(log_of(made, np.polyval(line, made.gyro_time_s)))
    return Filmed(recording, str(log), made)


def log_of(made: Flight, stamp_us: np.ndarray) -> bytes:
    """Rows before the clock began are left out."""
    after = stamp_us > 0
    columns = {f"gyro.{axis}": made.gyro_deg_s[after, place] for place, axis in enumerate("xyz")}
    return row_log([Block(FIXED, np.round(stamp_us[after]).astype(np.int64), columns)])
