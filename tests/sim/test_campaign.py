"""Random faults, and then none: the stream must be back, and every frame accounted for (campaign.py).

A few hundred schedules here; SPINDECK_CAMPAIGN=10000 runs so many. One again, with what was done to the robot:
python tests/sim/test_campaign.py SEED
"""

import os
import sys

import pytest
from campaign import Campaign

COUNT = int(os.environ.get("SPINDECK_CAMPAIGN", "300"))
BATCH = 50


def failure(seed):
    """What did not hold, or None."""
    campaign = Campaign(seed)
    try:
        campaign.run()
    except AssertionError as error:
        return f"seed {seed}: {error}\n  {campaign.settings}\n  again: python tests/sim/test_campaign.py {seed}"
    return None


@pytest.mark.parametrize("first", range(0, COUNT, BATCH))
def test_campaign(first):
    failures = [failure(seed) for seed in range(first, min(first + BATCH, COUNT))]
    assert not any(failures), "\n" + "\n".join(text for text in failures if text)


def show(seed):
    """Runs one and prints it."""
    campaign = Campaign(seed)
    print(campaign.settings, campaign.dialect)
    try:
        campaign.run()
    finally:
        print(*campaign.done, sep="\n")
        print({cause: count for cause, count in campaign.host.lost.items() if count}, "in connections that have ended")


if __name__ == "__main__":
    for seed in sys.argv[1:]:
        show(int(seed))
