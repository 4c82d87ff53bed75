import json
import shutil

import pytest
from mcap.reader import make_reader

from embodichain.cli import main
from embodichain.recording import inspect, verify
from embodichain.recording.format.options import RecordOptions
from embodichain.recording.read.chunks import LogReader
from embodichain.recording.read.recover import recover
from embodichain.utils.errors import ConfigError


@pytest.fixture
def broken(record, tmp_path):
    """A log that lacks its last third, and the whole one."""
    whole = record(steps=60, options=RecordOptions(compression="none"), num_envs=300)
    path = tmp_path / "broken.mcap"
    data = whole.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    return path, whole


def messages(path):
    with LogReader(path) as reader:
        return [(topic, time_ns, bytes(data)) for topic, time_ns, data in reader.messages()]


def test_all_that_can_be_read_is_in_a_clean_file(broken, tmp_path):
    path, whole = broken
    before = path.read_bytes()
    saved = recover(path, tmp_path / "clean.mcap")
    assert path.read_bytes() == before
    assert messages(saved.path) == messages(path)
    assert messages(saved.path) == messages(whole)[: saved.messages]
    assert 10 < saved.steps < 60
    assert saved.damage == "the file ends early: it was not closed, or cut"
    assert 0 < saved.lost_bytes < len(before)
    with LogReader(saved.path) as reader, LogReader(whole) as original:
        assert len(list(reader.messages())) == saved.messages
        assert reader.complete
        assert reader.damage == ""
        assert reader.attachments == original.attachments
        for name in reader.attachments:
            assert reader.attachment(name) == original.attachment(name)
        assert reader.header == original.header
    with saved.path.open("rb") as stream:  # for readers that insist on an index
        assert make_reader(stream).get_summary().statistics.message_count == saved.messages
    summary = inspect(saved.path)
    assert not summary.complete
    assert summary.warnings == [
        f"recovered from a broken file; it ends after step {saved.steps - 1}: {saved.damage}"
    ]


def test_a_recovered_log_verifies_and_says_where_it_ends(broken, tmp_path, capsys):
    path, _ = broken
    clean = tmp_path / "clean.mcap"
    assert main(["replay", str(path)]) == 0
    assert capsys.readouterr().err.startswith(f"warning: {path}: incomplete: ")
    assert main(["replay", str(path), "--verify"]) == 1
    capsys.readouterr()
    assert main(["recover", str(path), str(clean), "--json"]) == 0
    saved = json.loads(capsys.readouterr().out)
    report = verify(clean)
    assert report.ok, str(report)
    assert report.steps == saved["steps"] == verify(path).steps
    assert main(["replay", str(clean), "--verify"]) == 0
    end = f"the log ends after step {saved['steps'] - 1}: {saved['damage']}"
    assert capsys.readouterr().out.endswith(f"{end}\n")


def test_recover_copies_a_complete_log(record, tmp_path, capsys):
    path = record()
    assert main(["recover", str(path), str(tmp_path / "copy.mcap")]) == 0
    assert "is complete; copied" in capsys.readouterr().out
    assert messages(tmp_path / "copy.mcap") == messages(path)
    assert inspect(tmp_path / "copy.mcap").complete
    assert verify(tmp_path / "copy.mcap").notes == []


def test_recovering_twice_keeps_the_reason(broken, tmp_path):
    first = recover(broken[0], tmp_path / "first.mcap")
    again = recover(first.path, tmp_path / "again.mcap")
    assert again.damage == ""
    assert inspect(again.path).warnings == inspect(first.path).warnings


def test_nothing_is_overwritten_and_nothing_is_left(broken, tmp_path, capsys):
    path, whole = broken
    names = sorted(p.name for p in tmp_path.iterdir())
    for target in (path, whole, tmp_path):
        kept = target.read_bytes() if target.is_file() else b""
        assert main(["recover", str(path), str(target)]) == 2
        assert f"{target} exists" in capsys.readouterr().err
        assert not kept or target.read_bytes() == kept
    with pytest.raises(ConfigError, match="does not exist"):
        recover(path, tmp_path / "nowhere" / "clean.mcap")
    noise = tmp_path / "noise.mcap"
    shutil.copy(path, noise)
    noise.write_bytes(noise.read_bytes()[:40])
    with pytest.raises(ConfigError, match="no metadata record"):
        recover(noise, tmp_path / "clean.mcap")
    noise.unlink()
    assert sorted(p.name for p in tmp_path.iterdir()) == names
