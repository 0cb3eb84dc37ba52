"""Resets by their traces in logs, and when each robot took one."""

import pytest

from host.clock.resets import Reset, Taken, bound_us, late, missed, resets, taken

BOOT = (5_000, 61_000_000)


def test_what_is_a_reset() -> None:
    assert resets([]) == resets([BOOT]) == []
    assert resets([BOOT, (900, 40_000_000), (12_000, 7)]) == [Reset(1, 61_000_000), Reset(2, 40_000_000)]
    # A clock that went back, but not to 0, was not reset by anybody.
    assert resets([BOOT, (30_000_000, 50_000_000), (0, 1)]) == [Reset(2, 50_000_000)]


def test_who_has_missed_one() -> None:
    both = [Reset(1, 61_000_000), Reset(2, 40_000_000)]
    other_boot = [Reset(1, 3_000_000), Reset(2, 40_015_000)]
    assert missed([both, other_boot]) is None
    assert missed([[], []]) is None
    assert missed([both, both[:1], other_boot]) == 1
    assert missed([[], both]) == 0
    # As many, but not the same: 101 s between them is not 40 s.
    assert missed([both, other_boot, [Reset(1, 61_000_000), Reset(2, 101_000_000)]]) == 2
    assert late([9_800, 11_000, 400_000]) is None
    assert late([9_800, 83_000_000, 11_000]) == 1


@pytest.mark.parametrize(
    ("every_us", "repeats"), [(None, [None, None, None]), (1000.0, [3, 0, None]), (5000.0, [None, 0, None])]
)
def test_when_each_took_it(every_us: float | None, repeats: list[int | None]) -> None:
    made = taken([7_000.0, 4_050.0, 5_560.0], [30.0, 40.0, 30.0], every_us)
    assert [each.after_us for each in made] == pytest.approx([2950, 0, 1510])
    assert [each.bound_us for each in made] == pytest.approx([50, 0, 50])
    assert [each.repeat for each in made] == repeats
    assert [each.is_other for each in made] == [True, False, True]
    assert not Taken(1440, 50, None).is_other


def test_the_bound_grows() -> None:
    assert (bound_us(0), bound_us(10)) == (1400, 6400)
