"""How long `host --help` takes, beside a bare interpreter, in one run: medians of alternating starts."""

import statistics
import subprocess
import sys
import time

ROUNDS = 15


def seconds(*words: str) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, *words], stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - start


def main() -> None:
    bare, helped = [], []
    for _ in range(ROUNDS):
        bare.append(seconds("-c", "pass"))
        helped.append(seconds("-m", "host", "--help"))
    ratio = statistics.median(helped) / statistics.median(bare)
    print(
        f"host --help {statistics.median(helped) * 1e3:.0f} ms, interpreter {statistics.median(bare) * 1e3:.0f} ms: "
        f"{ratio:.1f} times (bar: at most 15), medians of {ROUNDS}"
    )


if __name__ == "__main__":
    main()
