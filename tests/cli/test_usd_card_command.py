"""`host usd` on the image of a card: its files, the logs on it, and how often it is walked."""

import sys
from pathlib import Path

import pytest

from host.cli import main
from host.usd.fat import Volume

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "usd"))

from logs import Writer, fill

pytest.importorskip("fatfs", reason="fatfs-ng is not installed: pip install 'spindeck[card]'")

from sim.card import Card


def test_commands(tmp_path, capsys):
    card = Card(128)
    log = fill(Writer(session=7), seed=1, rows=400)
    card.put("config.txt", b"1\n")
    closed = log.close()
    card.put("log00", closed)
    card.put("log01", bytes(log.data[:5000]))
    name = str(tmp_path / "card.img")
    card.save(name)
    assert main(["usd", "info", name]) == 0
    shown = capsys.readouterr().out
    assert "a card with FAT16, 3 files" in shown
    assert f"{len(closed)} bytes, a log" in shown
    assert f"host usd info {name}:/log00" in shown
    assert main(["usd", "info", "--json", name]) == 0
    assert '"path":"/log01"' in capsys.readouterr().out
    assert main(["usd", "info", f"{name}:/log00"]) == 0
    assert "400 fixedFrequency" in capsys.readouterr().out
    assert main(["usd", "check", f"{name}:/log00"]) == 0
    assert main(["usd", "check", name]) == 4
    assert f"{name}:/log01" in capsys.readouterr().out
    assert main(["usd", "decode", f"{name}:/LOG00", "-o", str(tmp_path / "flight.npz")]) == 0
    assert main(["usd", "repair", f"{name}:/log01", "-o", str(tmp_path / "repaired")]) == 0
    assert main(["usd", "repair", f"{name}:/log01", "-o", name, "--force"]) == 2
    assert "a log that is only read here" in capsys.readouterr().err
    assert main(["usd", "decode", name, "-o", str(tmp_path / "x.npz")]) == 2
    assert "name a log on it" in capsys.readouterr().err
    assert main(["usd", "info", f"{name}:/log07"]) == 2
    assert "no file /log07 on this card; there are /config.txt, /log00, /log01" in capsys.readouterr().err
    assert main(["usd", "info", f"{tmp_path}/nothing.img:/log07"]) == 2
    assert "nothing.img: No such file" in capsys.readouterr().err
    Card(16).save(str(tmp_path / "empty.img"))
    assert main(["usd", "check", str(tmp_path / "empty.img")]) == 2
    assert "no logs on this card" in capsys.readouterr().err
    (tmp_path / "other").write_bytes(b"other")
    assert main(["usd", "info", f"{tmp_path}/other:/log00"]) == 4
    assert "not the image of a FAT card" in capsys.readouterr().err


def test_a_command_walks_each_chain_once(tmp_path, capsys, monkeypatch):
    """Each file is held against all others: on a full card of 32 GB a walk of them all takes seconds."""
    card = Card(128)
    for number in range(5):
        card.put(f"log{number:02}", fill(Writer(session=7), seed=number, rows=400).close())
    name = str(tmp_path / "card.img")
    card.save(name)
    walked = []
    chain = Volume.chain
    monkeypatch.setattr(Volume, "chain", lambda self, first: walked.append(first) or chain(self, first))
    assert main(["usd", "check", name]) == 0
    assert capsys.readouterr().out.count("good") == 5
    assert len(walked) == len(set(walked)) == 5


def test_another_image_of_the_same_name_is_read_anew(tmp_path, capsys):
    name = str(tmp_path / "card.img")
    for number in range(2):
        card = Card(16)
        card.put(f"log{number:02}", fill(Writer(session=7), seed=number, rows=400).close())
        Path(name).unlink(missing_ok=True)
        card.save(name)
        assert main(["usd", "check", name]) == 0
        assert f"{name}:/log{number:02}: good" in capsys.readouterr().out
