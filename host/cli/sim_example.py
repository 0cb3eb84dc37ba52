"""`host sim example`: files as real robots bring them, to try `host sync` without one; and the truth of them."""

from __future__ import annotations

import argparse
import dataclasses
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..protocol.errors import LocalError
from ..protocol.typed import integer
from .new_file import new_folder

EXAMPLES = """\
WHAT:
  board   logs of two robots that were rocked and struck on one board, for host sync gyro
  mocap   a log of a robot that turned under motion capture, for host sync mocap
  camera  a recording and a log of a robot that was turned to and fro, for host sync camera

The same seed makes the same files. What is printed is what these commands should find.

examples:
  host sim example board board1
  host sim example mocap flight1 --seed 7
  host sim example camera turned1 --json
"""
CAMERA_S, CAMERA_FPS = 12.0, 10.0


@dataclass(frozen=True, slots=True)
class Made:
    """What was made of it."""

    files: dict[str, bytes]
    """By name; with what is in the folder already."""
    truth: dict[str, float]
    told: str
    """The truth for people."""
    command: str
    """That should find it, without the folder."""


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares the command and its options."""
    this = commands.add_parser(
        "example",
        help="logs and recordings as real robots bring them, to try host sync",
        description="Make logs and recordings as real robots bring them, to try host sync; and say what is true.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    this.add_argument("what", metavar="WHAT", choices=sorted(MAKERS), help=", ".join(sorted(MAKERS)))
    this.add_argument("folder", metavar="DIR", help="where to: new or empty")
    this.add_argument("--seed", type=integer, default=1, metavar="N", help="of everything random (default 1)")
    this.add_argument("--json", action="store_true", help="one JSON object on stdout")
    this.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Makes the files, then says what they are."""
    if arguments.seed < 0:
        raise LocalError(f"--seed {arguments.seed}: a whole number from 0 on")
    folder = new_folder(arguments.folder)
    made = MAKERS[arguments.what](arguments.seed, folder)
    try:
        for name, content in made.files.items():
            with (folder / name).open("xb") as file:
                file.write(content)
    except OSError as error:
        raise LocalError(f"{folder}: {error.strerror}") from error
    files = sorted(str(path) for path in folder.iterdir())
    words = [str(folder / word) if (folder / word).exists() else word for word in made.command.split()]
    command = shlex.join(words)
    if arguments.json:
        from .as_json import line

        record: dict[str, Any] = {"event": "example", "what": arguments.what, "seed": arguments.seed, "files": files}
        print(line({**record, "truth": made.truth, "command": command}))
        return 0
    print(f"made      {', '.join(files)}")
    print(f"truth     {made.told}")
    print(f"next      {command}")
    return 0


def board(seed: int, folder: Path) -> Made:
    from sim.teeterboard import Board, teeter

    made = teeter(Board(seed=seed))
    middle_us = float(made.stamp_us[len(made.stamp_us) // 2])
    shift_us = float(made.shift_us(middle_us))
    return Made(
        {"cf1_00": made.logs[0], "cf2_00": made.logs[1]},
        {"shift_us": round(shift_us, 3), "at_us": round(middle_us, 1), "slope_ppm": made.board.skew_ppm},
        f"the second clock is {shift_us:.1f} us ahead when the first says {middle_us:.0f} us, and"
        f" {made.board.skew_ppm:+.1f} ppm faster: {shift_us - made.board.skew_ppm * 1e-6 * middle_us:+.1f} us at 0",
        "host sync gyro cf1_00 cf2_00",
    )


def mocap(seed: int, folder: Path) -> Made:
    from sim.pose_log import Flight, pose_log

    flight = Flight(seed=seed)
    lag_us = flight.mocap_lag_us + flight.mocap_jitter_us / 2
    return Made(
        {"log00": pose_log(flight)},
        {"mocap_lag_us": lag_us, "estimate_lag_us": flight.estimate_lag_us},
        f"motion capture's poses come {lag_us / 1000:.2f} ms behind the motion, give or take"
        f" {flight.mocap_jitter_us / 2000:.2f} ms; the estimator's {flight.estimate_lag_us / 1000:.2f} ms",
        "host sync mocap log00",
    )


def camera(seed: int, folder: Path) -> Made:
    """A world's pictures have to be there before it runs, and when they are taken is known afterwards: so it runs
    twice. Equal seeds take raw pictures at equal times, whatever is on them."""
    import tempfile

    import numpy as np
    from PIL import Image

    from sim.panorama import HALF, panorama
    from sim.row_log import FIXED, Block, row_log
    from sim.turned_camera import flight

    lines = round(HALF.exposure_s / HALF.line_s)
    optics = dataclasses.replace(HALF, exposure_s=lines * HALF.line_s)
    url = (
        f"sim://hover?pace=max&seed={seed}&camera_fps={CAMERA_FPS:g}&camera_exposure_lines={lines}"
        f"&camera_line_time_ns={round(optics.line_s * 1e9)}&camera_jitter_us=0"
    )
    truth = streamed(f"{url}&camera_width={optics.width}&camera_height={optics.height}", None, None)
    world = panorama(seed, 3 * optics.height // 2)
    made = flight(seed, "teeter", seconds=CAMERA_S + 1, optics=optics, world=world)
    made = dataclasses.replace(made, stamp_s=truth["true_ns"] * 1e-9, offset_s=0.0)
    with tempfile.TemporaryDirectory(prefix="spindeck-") as pictures:
        for index in range(len(truth)):
            Image.fromarray(made.frame(index)).save(Path(pictures) / f"{index:05}.pgm")
        streamed(url, pictures, str(folder / "turned.mcap"))
    stm32_us = np.polyfit(truth["true_ns"] * 1e-9, truth["stm32_stamp_ns"] * 1e-3, 1)
    stamp_us = np.round(np.polyval(stm32_us, made.gyro_time_s)).astype(np.int64)
    after = stamp_us > 0
    columns = {f"gyro.{axis}": made.gyro_deg_s[after, place] for place, axis in enumerate("xyz")}
    return Made(
        {"log00": row_log([Block(FIXED, stamp_us[after], columns)])},
        {"offset_us": 0.0, "focal_px": optics.focal_px, "gyro_lag_us": round(made.gyro.lag_s * 1e6, 1)},
        f"frames' times are the gyro's: 0 us from them. The lens has {optics.focal_px:g} px",
        "host sync camera turned.mcap log00",
    )


def streamed(url: str, pictures: str | None, record: str | None) -> Any:
    """Runs the world as long as the example lasts, and returns when its frames were really taken."""
    from ..link.recording import Recorder
    from ..link.stream import open_stream

    with open_stream(url, camera=pictures) as stream:
        recorder = Recorder(record) if record else None
        try:
            if recorder:
                stream.tap = recorder.track(0, stream.port, "auto")
            last_ns = (CAMERA_S if record else CAMERA_S + 0.5) * 1e9
            for frame in stream:
                if frame.arrival_host_ns > last_ns:
                    break
        finally:
            if recorder:
                recorder.close()
        return stream.port.world.truth


MAKERS: dict[str, Callable[[int, Path], Made]] = {"board": board, "mocap": mocap, "camera": camera}
